# SPDX-License-Identifier: BSD-3-Clause
"""`coman isolability`: which effects recordings can show, and which they cannot distinguish."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.base.nominal import load_nominal
from ..core.config.schema import Config
from ..core.effects.catalogue import CATALOGUE
from ..progress import Progress, between
from ..topics import TopicNames
from .data.reading import read_bags, refuse_repeated
from .inference.case import evidence_of
from .inference.case_cache import CaseCache
from .inference.check import check_recordings
from .inference.effects import with_structure
from .inference.isolability import SIZE, Isolability
from .inference.isolability import isolability as of_evidence
from .physics.hypotheses import candidates

READ = 0.5  # of the work


def isolability(
    bags: Sequence[str | Path],
    config: Config,
    *,
    size: float = SIZE,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    baseline: str | Path = "",
    progress: Progress | None = None,
) -> Isolability:
    """What recordings of one robot can distinguish.

    Args:
        bags: recordings.
        config: nominal robot and model.
        size: of the effects, as a share of the reach of their parameters.
        urdf, names: the robot, if not as configured or recorded; the topics.
        baseline: file of nominal variability (`coman baseline`); default: the shipped population.
        progress: called with the fraction done and the current work.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used.
    """
    nominal = load_nominal(baseline)
    refuse_repeated(bags)
    report = progress or (lambda fraction, what: None)
    config = with_structure(config)
    readings = read_bags(bags, config, urdf, names, between(report, 0.0, READ))
    checked = check_recordings(readings, len(bags), config, [], whole=True)
    report(READ, "looking at what each effect would change")
    cache = CaseCache(checked.train, nominal=nominal)
    evidence = evidence_of(cache.at(np.zeros(len(cache.known)), "train"))
    return of_evidence(evidence, candidates(cache.known), size)


def as_result(found: Isolability) -> dict[str, Any]:
    """As `coman isolability --json` prints it."""
    names = [option.name for option in found.options]
    return {
        "effects": [
            {"name": option.effect, "where": option.where, "size": size, "evidence": float(shown)}
            for option, size, shown in zip(found.options, found.sizes, found.shown, strict=True)
        ],
        "factors": found.factors.tolist(),
        "groups": [[names[i] for i in group] for group in found.groups],
        "hidden": [names[i] for i in found.hidden],
    }


def by_effect(found: Isolability) -> tuple[list[int], np.ndarray]:
    """Of each effect the place where it shows best, and its least factor against any place of each other effect.

    Returns:
        Indices (m,) of options in the order of the catalogue; (m, m) factors. On the diagonal, against the effect's
        other places; NaN where it has none.
    """
    order = list(CATALOGUE)
    effects = sorted({option.effect for option in found.options}, key=order.index)
    places = [[i for i, option in enumerate(found.options) if option.effect == effect] for effect in effects]
    best = [max(indices, key=lambda i: found.shown[i]) for indices in places]
    out = np.full((len(best), len(best)), np.nan)
    for a, row in enumerate(best):
        for b, columns in enumerate(places):
            others = [found.factors[row, column] for column in columns if column != row]
            out[a, b] = min(others, default=np.nan)
    return best, out
