# SPDX-License-Identifier: BSD-3-Clause
"""Which topics of a bag are the input streams of a robot, by type, then by joints, frames and names."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..core.base.types import Foot
from ..core.robot.robot import Robot
from ..errors import RobotError
from ..messages import INPUT_TYPES
from ..topics import INPUT_TOPICS, TopicNames
from .reader import Bag


@dataclass
class FoundTopics:
    """Topic of each stream that the bag has, frame of its first message, and what is missing or not clear."""

    topics: dict[str, str] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    efforts: bool = False  # whether the joint states hold torques

    @property
    def remaps(self) -> tuple[str, ...]:
        """What --remap needs, for topics that have other names than the nominal ones."""
        named = {INPUT_TOPICS[stream]: topic for stream, topic in self.topics.items()}
        return tuple(f"{nominal}:={topic}" for nominal, topic in named.items() if topic != f"/{nominal}")


def find_topics(bag: Bag, robot: Robot, names: TopicNames | None = None) -> FoundTopics:
    """The input topics of a bag. Nominal names count before others; what is not clear is noted and left out.

    Args:
        names: the nominal names with a namespace and remappings.

    Raises:
        BagError: a message cannot be decoded.
    """
    found = FoundTopics()
    kinds = set(INPUT_TYPES.values())
    first: dict[str, Any] = {t: bag.first(t) for t, kind in bag.topics.items() if kind in kinds and bag.counts.get(t)}
    for stream, kind in INPUT_TYPES.items():
        taken = set(found.topics.values())
        fitting = {
            t: m for t, m in first.items() if bag.topics[t] == kind and t not in taken and _fits(robot, stream, m)
        }
        nominal, named = (names or TopicNames())(INPUT_TOPICS[stream]), list(fitting)
        if stream in (JOINTS, MOTORS):
            named = [t for t in fitting if ("motor" in t) == (stream == MOTORS)]
        if nominal in fitting or len(named) == 1:
            topic = nominal if nominal in fitting else named[0]
            found.topics[stream], message = topic, fitting[topic]
            found.frames[stream] = message.header.frame_id
            if stream == JOINTS:
                found.efforts = bool(len(message.effort))
                found.notes += _unlisted(robot, topic, message)
        elif named:
            found.notes.append(f"{INPUT_TOPICS[stream]}: not clear which topic: {', '.join(named)} (--remap)")
        elif stream not in (MOTORS, REFERENCE, IMU, CONTACTS):
            without = " (without foot sensors: streams.wrench_source)" if stream in WRENCHES.values() else ""
            found.notes.append(f"{INPUT_TOPICS[stream]}: no topic of type {kind} fits{without}")
    return found


def _fits(robot: Robot, stream: str, message: Any) -> bool:
    """Whether a message is of the legs, the foot or the trunk of the robot."""
    if stream in (JOINTS, MOTORS):
        return bool({*robot.config.leg_joints} & {*message.name})
    for foot in (Foot.LEFT, Foot.RIGHT):
        if stream == WRENCHES[foot]:
            try:
                robot.wrench_to_sole(foot, message.header.frame_id, np.zeros(3), np.zeros(3))
            except RobotError:
                return False
    return True


def _unlisted(robot: Robot, topic: str, message: Any) -> list[str]:
    missing = [name for name in robot.config.leg_joints if name not in message.name]
    return [f"{topic}: lacks the leg joints {', '.join(missing)}"] if missing else []
