# SPDX-License-Identifier: BSD-3-Clause
"""Slow adaptation (`prediction.adapt`): free run and predictions ahead, with and without it.

    python bench/adaptation.py [BAG...] [--config FILE] [--worlds SEED...] [--made DIR]

RMS errors from 8 s on, x, y, z [mm], with the constants of the data sheet: the free run, and what is published 0.2 s
ahead. Most of all: the joint whose stiffness, and that whose zero, was changed most by the end, and the trunk's COM.
What the adaptation assumes was chosen on worlds 7000 to 7099. Worlds without motor states, and in which the robot
falls, are left out.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from free_run import AHEAD, SETTLED_NS, mm, recorded, since
from rich.console import Console
from rich.table import Table

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.sim.worlds import world_of


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="*", metavar="BAG")
    parser.add_argument("--config", metavar="FILE")
    parser.add_argument("--worlds", nargs="*", default=[], metavar="SEED")
    parser.add_argument("--made", metavar="DIR", type=Path, help="where recordings of worlds are, or are put")
    arguments = parser.parse_args()
    table = Table("recording", "free run", "adapted", "ratio", "published", "adapted", "most of all")
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        bags = [(Path(bag).name, Path(bag), coman.load_config(arguments.config)) for bag in arguments.bags]
        for title, bag, config in (*bags, *worlds(arguments.worlds, arguments.made or Path(folder))):
            plain, _ = errors(bag, config)
            adapted, learnt = errors(bag, config.replaced({"prediction.adapt": True}))
            ratio = adapted[0] / plain[0]
            ratios.append(ratio)
            shown = ", ".join(f"{each:.2f}" for each in ratio)
            table.add_row(title, mm(plain[0]), mm(adapted[0]), shown, mm(plain[1]), mm(adapted[1]), learnt)
    Console(width=190, markup=False).print(table)
    mean, worst = np.exp(np.mean(np.log(ratios), axis=0)), np.max(ratios, axis=0)
    print(f"Free run, adapted over plain, x, y, z: geometric mean {spelt(mean)}; the worst recording {spelt(worst)}.")


def spelt(values: Array) -> str:
    return ", ".join(f"{each:.2f}" for each in values)


def worlds(seeds: list[str], made: Path) -> Iterator[tuple[str, Path, Config]]:
    """Title, bag and data sheet, recorded in `made` if they are not there."""
    for seed in seeds:
        has_motors = world_of(seed).kinds["streams"] != "no_motors"
        if has_motors and (walk := recorded(seed, made)) is not None:
            yield walk


def errors(bag: Path, config: Config) -> tuple[tuple[Array, Array], str]:
    """RMS (3,) [m] of the free run and of what is published ahead, once it has settled; what was learnt, in words."""
    residuals, first_ns, early = [], 0, None
    with coman.Session(bag, config) as session:
        predictor = session.pipeline.predictor
        for sample in session.samples():  # one by one: errors are those until this prediction
            prediction = session.pipeline.predict([sample])[0]
            first_ns = first_ns or prediction.stamp_ns
            if prediction.stamp_ns - first_ns <= SETTLED_NS:
                continue
            early = early or (predictor.judge.rmse(), predictor.judge.judged)
            if not prediction.flags.diverged:
                residuals.append(prediction.residual)
    assert early is not None, f"{bag}: shorter than {SETTLED_NS * 1e-9:.0f} s"
    ahead = since(early, (predictor.judge.rmse(), predictor.judge.judged))[AHEAD]["published"]
    return (np.sqrt(np.nanmean(np.square(residuals), axis=0)), ahead), in_words(predictor)


def in_words(predictor: coman.Predictor) -> str:
    if predictor.adaptation is None:
        return ""
    known = predictor.adaptation.known()
    spring = max(known, key=lambda name: abs(known[name].stiffness - 1.0))
    zero = max(known, key=lambda name: abs(known[name].zero))
    x, y = 1e3 * predictor.adaptation.shift
    of_joints = f"{spring} x {known[spring].stiffness:.2f}, {zero} {1e3 * known[zero].zero:+.1f} mrad"
    return f"{of_joints}, trunk {x:+.1f}, {y:+.1f} mm"


if __name__ == "__main__":
    main()
