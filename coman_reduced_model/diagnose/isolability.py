# SPDX-License-Identifier: BSD-3-Clause
"""`coman isolability`: which effects recordings can show, which they cannot distinguish, and what others would add."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.base.nominal import load_nominal, of_another_robot
from ..core.config.schema import Config
from ..core.effects.catalogue import CATALOGUE
from ..progress import Progress, between
from ..topics import TopicNames
from .data.reading import read_bags, refuse_repeated
from .inference.another import LENGTH, Another, best_first, examined, length_of, like
from .inference.at_size import at_share
from .inference.case import Case, evidence_of, prepare
from .inference.case_cache import CaseCache
from .inference.check import check_recordings, limitations
from .inference.effects import with_structure
from .inference.isolability import SIZE, Isolability
from .inference.isolability import isolability as of_evidence
from .physics.hypotheses import candidates

READ = 0.5  # of the work


def isolability(
    bags: Sequence[str | Path],
    config: Config,
    *,
    others: Sequence[str | Path] = (),
    size: float = SIZE,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    baseline: str | Path = "",
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> tuple[Isolability, list[Another]]:
    """What recordings of one robot can distinguish, and what further ones would add.

    Args:
        bags: recordings.
        others: further ones, which are taken to last LENGTH. They say how the robot moves in them, and how much noise
            its sensors have then; what is usual for the robot is of `bags` alone.
        config: nominal robot and model.
        size: of the effects, as a share of the reach of their parameters.
        urdf, names: the robot, if not as configured or recorded; the topics.
        baseline: file of nominal variability (`coman baseline`); default: the shipped population.
        progress: called with the fraction done and the current work.
        notice: called with each sentence on what the recordings cannot show, and what looks wrong in them.

    Returns:
        Of the bags; of each of the others and, if there are any, of more like each of the bags, the best first.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used.
    """
    nominal = load_nominal(baseline)
    refuse_repeated(bags)
    refuse_repeated(others)
    report = progress or (lambda fraction, what: None)
    config = with_structure(config)
    readings = read_bags([*bags, *others], config, urdf, names, between(report, 0.0, READ))
    n = len(bags)
    checked = check_recordings(readings[:n], n, config, [], whole=True, nominal=nominal)
    for line in (*checked.not_checked, *of_another_robot(nominal, checked.train[0][1].robot.mass)):
        if notice:
            notice(line)
    further = [prepare(reading.recording, reading.robot, config, nominal) for reading in readings[n:]]
    for path, each in zip(others, further, strict=True):
        for line in limitations([each]):
            if notice:
                notice(line if line.startswith(each[0].name) else f"{Path(path).name}: {line}")
    report(READ, "looking at what each effect would change")
    cache = CaseCache(checked.train, nominal=nominal)
    known, cases = cache.known, at_share(cache.at(np.zeros(len(cache.known)), "train"), size)
    evidence, options = evidence_of(cases), candidates(known)

    def another(path: str | Path, case: Case, again: bool) -> Another:
        found = of_evidence(evidence, options, size, like([case], known))
        return Another(str(path), again, length_of([case]), found)

    found = of_evidence(evidence, options, size)
    new = at_share([examined(each, checked.train[0], known, nominal) for each in further], size)
    added = [another(path, case, False) for path, case in zip(others, new, strict=True)]
    if others:
        added += [another(path, case, True) for path, case in zip(bags, cases, strict=True)]
    return found, best_first(added, found.pairs)


def as_result(found: Isolability, others: Sequence[Another] = ()) -> dict[str, Any]:
    """As `coman isolability --json` prints it; `others` as `isolability` returns them."""
    names = [option.name for option in found.options]
    result: dict[str, Any] = {
        "effects": [
            {"name": option.effect, "where": option.where, "size": size, "units": units, "evidence": float(shown)}
            for option, size, units, shown in zip(found.options, found.sizes, found.units, found.shown, strict=True)
        ],
        "factors": found.factors.tolist(),
        "groups": [[names[i] for i in group] for group in found.groups],
        "hidden": [names[i] for i in found.hidden],
    }
    if others:
        result["seconds"] = LENGTH
        result["candidates"] = [
            {
                "bag": each.name, "again": each.again, "lasts": each.lasts,
                "distinguished": each.distinguished(found.pairs), "hidden": [names[i] for i in each.found.hidden],
            }
            for each in others
        ]  # fmt: skip
        result["pairs"] = [
            {
                "effects": [names[i] for i in pair], "alone": found.apart(pair),
                "with": [each.found.apart(pair) for each in others],
            }
            for pair in found.pairs
        ]  # fmt: skip
    return result


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
