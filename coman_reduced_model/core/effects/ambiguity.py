# SPDX-License-Identifier: BSD-3-Clause
"""Classes of effects that walking alone hardly distinguishes: one of a class is enough."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Ambiguity:
    """A class by its name in results, and the experiment that would decide between its members."""

    name: str
    experiment: str


DRIVE_DELAY = Ambiguity(
    "drive_delay",
    "references with quick parts (a chirp up to some Hz on one joint, standing): a delay shifts all of them alike, a "
    "lag also makes the quick ones smaller",
)
CONSTANT_FORCE = Ambiguity(
    "constant_force",
    "standing with and without a known mass on the trunk: a slope's force grows with the weight, a pull does not; or "
    "an IMU that was levelled on this floor",
)
LOST_MOTION = Ambiguity(
    "lost_motion",
    "the joint loaded slowly through zero torque, both ways, to small and to large torques: play is crossed at zero "
    "torque, what friction holds only where the torque exceeds it",
)
