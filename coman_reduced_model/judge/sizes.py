# SPDX-License-Identifier: BSD-3-Clause
"""How large an effect is beside what recordings leave open of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ComanError
from ..sim.worlds import World
from .calibration import as_fitted
from .families import LEVELS, MULTIPLES
from .rank import evidence_with, ranking
from .variability import true_deviations

_TURNED = {"x": "roll", "y": "pitch", "z": "yaw"}  # of a sensor, in the diagnosis


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
    if "angle" in values:
        values[_TURNED[values["axis"]]] = values["angle"]
    for row in ranked:
        if (row["name"], row["where"] or "") == (effect["name"], effect["where"] or ""):
            for name, found in row["parameters"].items():
                value = values.get(name)
                if isinstance(value, float) and found["deviation"] > 0.0:
                    distance = np.log(value) if name == "scale" and value > 0.0 else value
                    sizes.append(abs(float(distance)) / float(found["deviation"]))
    return max(sizes, default=None)


def times_to_show(
    folder: Path, world: World, effects: Sequence[Mapping[str, Any]], levels: Sequence[str]
) -> tuple[float, ...]:
    """By how much effects must grow to be as many deviations of what a clean recording leaves open as of clean robots.

    Args:
        folder: with `train`, a recording of the robot in which nothing is hidden, and robot.yaml.
        world: of the robot.
        effects: as they are by what clean robots vary by.
        levels: theirs.

    Returns:
        At least 1 each; 1 where the diagnosis knows no such effect, or cannot use the recording.
    """
    try:
        ranked = ranking(evidence_with(folder, true_deviations(world)))
    except ComanError:
        return (1.0,) * len(effects)
    sizes = [shown(effect, ranked) for effect in effects]
    least = [MULTIPLES[LEVELS.index(level)][0] for level in levels]
    return tuple(max(1.0, low / size) if size else 1.0 for low, size in zip(least, sizes, strict=True))
