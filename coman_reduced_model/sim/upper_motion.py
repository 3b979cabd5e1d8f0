# SPDX-License-Identifier: BSD-3-Clause
"""How the upper body moves while the robot walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.base.types import Array
from ..core.gait.gait import WalkPlan
from ..core.gait.parameters import GaitParameters
from ..errors import ConfigError
from .robot_table import RobotTable

_LARGEST = 1.0  # [rad]
RISE_S = 1.5  # [s] in which the swing rises and falls


def stride_s(gait: GaitParameters) -> float:
    """Time of a stride, two steps [s]."""
    return 2.0 * (gait.single_support_s + gait.double_support_s)


@dataclass(frozen=True)
class UpperMotion:
    """Swings once in a stride (two steps), waist pitch once in a step; at rest arms hang with bent elbows.

    Raises:
        ConfigError: an amplitude is too large.
    """

    arms: float = 0.0  # [rad] amplitude of the shoulders
    together: bool = False  # both arms swing the same way, instead of against each other
    waist_yaw: float = 0.0  # [rad] amplitude
    waist_pitch: float = 0.0  # [rad] amplitude
    elbows: float = -0.5  # [rad] at rest

    def __post_init__(self) -> None:
        for name in ("arms", "waist_yaw", "waist_pitch"):
            if not 0.0 <= getattr(self, name) <= _LARGEST:
                raise ConfigError(f"upper: {name} = {getattr(self, name)!r}: allowed: 0 to {_LARGEST:g} rad")

    def angles(self, table: RobotTable, plan: WalkPlan, t: Array) -> Array:
        """Joints of the upper body (n, nu) [rad] at times t (n,) [s] of a plan; still while it stands at its ends."""
        p = plan.parameters
        ends = np.clip(np.minimum(t - 0.5, plan.duration_s - 0.5 - t) / RISE_S, 0.0, 1.0)
        return self.at(table, 2.0 * np.pi * (t - p.stand_before_s) / stride_s(p), ends)

    def at(self, table: RobotTable, phase: Array, share: Array) -> Array:
        """Joints of the upper body (n, nu) [rad].

        Args:
            table: the robot.
            phase: of the stride (n,) [rad].
            share: how far the swing has risen (n,), 0 to 1.
        """
        out = np.zeros((len(phase), len(table.upper)))
        window = share**3 * (10.0 + share * (6.0 * share - 15.0))
        swing = window * np.sin(phase)
        opposite = 1.0 if self.together else -1.0
        moves = {
            "LShSag": self.arms * swing,
            "RShSag": opposite * self.arms * swing,
            "WaistYaw": self.waist_yaw * swing,
            "WaistSag": self.waist_pitch * window * np.sin(2.0 * phase),
            "LElbow": np.full(len(phase), self.elbows),
            "RElbow": np.full(len(phase), self.elbows),
        }
        for k, joint in enumerate(table.upper):
            if joint.name in moves:
                out[:, k] = moves[joint.name]
        return out
