# SPDX-License-Identifier: BSD-3-Clause
"""Simpler methods for comparison, on the same bag, residuals and features as the diagnosis.

    python -m coman_reduced_model.judge.baselines BAG --config ROBOT.yaml

prints {"white_bic": verdict, "pysindy": verdict}, in the form of diagnosis.json as far as the scorer reads it:

- white_bic: least squares for each effect alone, with white noise; the smallest Bayesian information criterion wins
  (no effect is one of the candidates).
- pysindy: sparse regression (STLSQ at its default threshold) of the residuals on all features, scaled so that
  1 is a large effect; the term that explains most is named. Left out if pysindy is not installed
  (`pip install -r bench/requirements.txt`).

Neither has a prior for the variability of clean robots.
"""

from __future__ import annotations

import importlib.util
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.base.types import Array
from ..resources import config_path


@dataclass(frozen=True)
class Term:
    """One effect at one place: the columns of its unknowns."""

    name: str
    where: str
    parameters: tuple[str, ...]
    columns: Array  # (k,) indices


@dataclass(frozen=True)
class Features:
    """Residuals y (n,), each channel in units of its standard deviation, and their derivatives A (n, P) by unknowns."""

    y: Array
    A: Array
    reach: Array  # (P,) how large each unknown may well be
    terms: tuple[Term, ...]


def features(bag: Path, config: Path | None) -> Features:
    """Of a recording, as the workflow computes them.

    Raises:
        ComanError: the bag or the configuration cannot be used.
    """
    from ..core.config.files import load_config
    from ..diagnose.data.masks import masks
    from ..diagnose.data.recording import load
    from ..diagnose.data.world import World
    from ..diagnose.inference.evidence import assemble
    from ..diagnose.inference.reference import reference
    from ..diagnose.physics.hypotheses import candidates, unknowns

    settings = load_config(config or config_path())
    recording, robot = load(bag, settings)
    world = World.nominal(robot, settings)
    where = masks(recording, world)
    known = unknowns(recording, world)
    nothing = np.zeros(len(known))
    problem = assemble(reference(recording, world, where, known, nothing), where, known, nothing)
    scale = {key: max(float(np.std(row)), 1e-12) for key, row in problem.rows.items()}
    y = np.concatenate([row / scale[key] for key, row in problem.rows.items()])
    A = np.concatenate([problem.columns[key] / scale[key] for key in problem.rows])
    terms = tuple(
        Term(c.effect, c.where, tuple(known[i].key for i in c.unknowns), np.array(c.unknowns))
        for c in candidates(known)
    )
    return Features(y, A, np.array([unknown.reach for unknown in known]), terms)


def white_bic(f: Features) -> dict[str, Any]:
    """The verdict of the least n log(RSS / n) + k log(n)."""
    n, energy = len(f.y), float(f.y @ f.y)
    best, winner = n * np.log(energy / n), None
    values: Array = np.empty(0)
    for term in f.terms:
        A = f.A[:, term.columns]
        x, *_ = np.linalg.lstsq(A, f.y, rcond=None)
        left = f.y - A @ x
        bic = n * np.log(float(left @ left) / n) + len(x) * np.log(n)
        if bic < best:
            best, winner, values = bic, term, np.asarray(x, dtype=float)
    return _verdict(winner, values)


def pysindy(f: Features) -> dict[str, Any]:
    """The verdict of sparse regression on all features at once."""
    import pysindy as ps

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns when it drops every term
        model = ps.SINDy(optimizer=ps.STLSQ(), feature_library=ps.IdentityLibrary())
        model.fit(f.A * f.reach, t=1.0, x_dot=f.y[:, None])
    x = model.coefficients()[0] * f.reach
    explained = [float(np.sum((f.A[:, term.columns] @ x[term.columns]) ** 2)) for term in f.terms]
    k = int(np.argmax(explained))
    return _verdict(f.terms[k] if explained[k] > 0.0 else None, x[f.terms[k].columns])


def _verdict(term: Term | None, values: Array) -> dict[str, Any]:
    if term is None:
        return {"verdict": "none", "effects": []}
    parameters = {name: {"value": float(value)} for name, value in zip(term.parameters, values, strict=True)}
    return {"verdict": "effect", "effects": [{"name": term.name, "where": term.where, "parameters": parameters}]}


def main(arguments: Sequence[str]) -> None:
    """Print the verdicts of a bag as JSON."""
    from ..output import to_json

    found = features(Path(arguments[0]), Path(arguments[2]) if len(arguments) == 3 else None)
    verdicts = {"white_bic": white_bic(found)}
    if importlib.util.find_spec("pysindy"):
        verdicts["pysindy"] = pysindy(found)
    print(to_json(verdicts))


if __name__ == "__main__":
    main(sys.argv[1:])
