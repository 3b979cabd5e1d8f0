# SPDX-License-Identifier: BSD-3-Clause
"""Some hundred messages of a stream as arrays, one row a message."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.types import Array, Booleans, Integers


class Irregular(Exception):
    """Messages that need a look at each one: nothing of their block has been taken."""


@dataclass(slots=True)
class Block:
    """Messages of one stream, in the order of their arrival.

    Attributes:
        arrival: (n,) place of each message among those of all streams; increases.
        stamp_ns: (n,) stamps as they came.
    """

    arrival: Integers
    stamp_ns: Integers

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass(slots=True)
class JointBlock(Block):
    """Joint states, link or motor side, that list the same joints; fields as in `JointMessage`."""

    names: tuple[str, ...]
    position: Array  # (n, m) [rad]
    velocity: Array | None  # (n, m) [rad/s]
    effort: Array | None  # (n, m) [Nm]


@dataclass(slots=True)
class WrenchBlock(Block):
    """Wrenches in one frame."""

    frame_id: str
    wrench: Array  # (n, 6) force [N], torque [Nm]


@dataclass(slots=True)
class ImuBlock(Block):
    """Orientations and rates in one frame; fields as in `ImuMessage`."""

    frame_id: str
    orientation: Array  # (n, 4) quaternion x y z w
    oriented: Booleans  # (n,) whether the orientation is known
    angular_velocity: Array  # (n, 3) [rad/s]
    linear_acceleration: Array  # (n, 3) [m/s^2]


@dataclass(slots=True)
class ReferenceBlock(Block):
    """Points of a plan whose previews are alike; fields as in `Reference`."""

    points: Array  # (n, 4, 3) COM, its velocity and acceleration, ZMP
    soles: list[tuple[Array, Array]]  # n times T_odom_left, T_odom_right
    phase: list[int]
    step: list[int]
    preview_dt: float  # [s]
    previews: Array  # (n, 2, k, 3) positions, velocities
    steps: tuple[Array, Integers] | None  # (n, k, 14) soles and (n, k) phases, where the plan says them
