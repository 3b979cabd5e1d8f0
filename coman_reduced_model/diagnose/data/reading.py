# SPDX-License-Identifier: BSD-3-Clause
"""Step 1, read: the bags as recordings of one robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.config.schema import Config
from ...core.robot.robot import Robot
from ...errors import BagError
from ...progress import Progress, between
from ...topics import TopicNames
from .recording import MENDED_FIRST, Recording, load


@dataclass(frozen=True)
class Reading:
    """A bag, its recording, and its robot with the loads that are configured."""

    path: str | Path
    recording: Recording
    robot: Robot


def refuse_repeated(paths: Sequence[str | Path]) -> None:
    """Raises BagError if a bag is given twice: it cannot confirm what was found in it."""
    for i, path in enumerate(paths):
        if any(_same(Path(path).resolve(), Path(other).resolve()) for other in paths[:i]):
            raise BagError(f"{path}: given twice: a bag cannot confirm what was found in it")


def _same(path: Path, other: Path) -> bool:
    """Whether two paths are one bag, or a bag and a file in it."""
    return other in (path, path.parent) or other.parent == path


def read_bags(
    paths: Sequence[str | Path],
    config: Config,
    urdf: str | Path | None,
    names: TopicNames | None,
    progress: Progress,
) -> list[Reading]:
    """Recordings of all bags.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used, the bags are of different robots, or most of
            them show a foot sensor that is turned.
    """
    readings: list[Reading] = []
    for i, path in enumerate(paths):
        part = between(progress, i / len(paths), (i + 1) / len(paths))
        reading = Reading(path, *load(path, config, urdf, names, part))
        if readings:
            _refuse_another_robot(reading, readings[0])
        readings.append(reading)
    _refuse_turned([reading.recording for reading in readings])
    return readings


def _refuse_turned(recordings: Sequence[Recording]) -> None:
    """Foot sensors that are turned are turned in every recording, as most of them show: in one it may be chance."""
    found = [each for each in recordings if each.turned]
    if 2 * len(found) > len(recordings):
        raise BagError(f"{found[0].name}: {found[0].turned}; {MENDED_FIRST}")


def _refuse_another_robot(reading: Reading, first: Reading) -> None:
    robot, expected = reading.robot, first.robot
    another = f"{reading.path}: of another robot than {first.path}:"
    if robot.joint_names != expected.joint_names:
        raise BagError(f"{another} its joints are {', '.join(robot.joint_names)}")
    if not np.isclose(robot.mass, expected.mass, rtol=1e-3):
        raise BagError(f"{another} {robot.mass:.4g} kg by its URDF, not {expected.mass:.4g}")
