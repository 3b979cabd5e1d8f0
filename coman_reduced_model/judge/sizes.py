# SPDX-License-Identifier: BSD-3-Clause
"""How large an effect is beside what recordings leave open of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ComanError
from ..sim.worlds import World
from .families import LEVELS, MULTIPLES
from .hidden import NOMINAL, as_fitted
from .rank import evidence_with, ranking
from .variability import true_deviations

ROUNDS, ENOUGH = 6, 1.02  # of growing, as factors are not in proportion to their logarithms; and the last growth
Draw = Callable[[Sequence[float]], tuple[Sequence[Mapping[str, Any]], Sequence[str]]]


def shown(effect: Mapping[str, Any], ranked: Any) -> float | None:
    """Size of an effect, in standard deviations that recordings leave where all else varies.

    By the oracle's posterior; of several parameters, the one that shows most.

    Args:
        effect: name, where and parameters, of an answer.
        ranked: of `rank.ranking`.

    Returns:
        None: there is no ranking, or the diagnosis does not know the effect at this place.
    """
    if not isinstance(ranked, list):
        return None
    values, sizes = as_fitted(effect), []
    for row in ranked:
        if (row["name"], row["where"] or "") == (effect["name"], effect["where"] or ""):
            for name, found in row["parameters"].items():
                value = values.get(name)
                if isinstance(value, float) and found["deviation"] > 0.0:
                    # Rankings of earlier versions do not say which are logarithms.
                    logarithm = found.get("logarithmic", name == "scale") and value > 0.0
                    distance = np.log(value) if logarithm else value - NOMINAL.get(name, 0.0)
                    sizes.append(abs(float(distance)) / float(found["deviation"]))
    return max(sizes, default=None)


def times_to_show(folder: Path, world: World, draw: Draw) -> tuple[float, ...]:
    """By how much effects must grow to be as many deviations of what a clean recording leaves open as of clean robots.

    Args:
        folder: with `train`, a recording of the robot in which nothing is hidden, and robot.yaml.
        world: of the robot.
        draw: by how much larger each is (none: as large as by what clean robots vary by), the effects and their levels.

    Returns:
        At least 1 each; 1 where the diagnosis knows no such effect, or cannot use the recording.
    """
    effects, levels = draw(())
    times = (1.0,) * len(effects)
    try:
        ranked = ranking(evidence_with(folder, true_deviations(world)))
    except ComanError:
        return times
    for _ in range(ROUNDS):
        sizes = [shown(effect, ranked) for effect in effects]
        least = [MULTIPLES[LEVELS.index(level)][0] for level in levels]
        grown = [max(1.0, low / size) if size else 1.0 for low, size in zip(least, sizes, strict=True)]
        times = tuple(known * more for known, more in zip(times, grown, strict=True))
        if max(grown) <= ENOUGH:
            break
        before = effects, levels
        effects, levels = draw(times)
        if (effects, levels) == before:  # as large as they can be
            break
    return times
