# SPDX-License-Identifier: BSD-3-Clause
"""A plane floor that is not level."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .ambiguity import CONSTANT_FORCE, Ambiguity
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from ..robot.robot import Robot
    from .hooks import Now, Push


class GroundSlope(Effect):
    """The floor is level ground turned by Ry(pitch) Rx(roll), so that gravity pulls aslant in the frame of the sole.

    Downhill along x for pitch > 0, along -y for roll > 0, of `odom`: of the first support sole.
    """

    name: ClassVar[str] = "ground_slope"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("roll", "float", 0.0, "rad", "of the floor about x of odom", -0.5, 0.5),
        Parameter("pitch", "float", 0.0, "rad", "of the floor about y of odom", -0.5, 0.5),
    )
    ambiguity: ClassVar[Ambiguity | None] = CONSTANT_FORCE
    sentence: ClassVar[str] = "the floor is not level, about the axes of odom ({listed})"
    experiment: ClassVar[str] = CONSTANT_FORCE.experiment
    exact: ClassVar[bool] = True

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        roll, pitch = self.values["roll"], self.values["pitch"]
        down = np.array([sin(pitch), -cos(pitch) * sin(roll), -cos(pitch) * cos(roll)])
        self._force = robot.mass * robot.config.gravity * (down - [0.0, 0.0, -1.0])

    def push(self, push: Push, now: Now) -> None:
        push.force += push.R_odom_sole.T @ self._force

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("ground_slope", "spread", "reach")
        return [cls.unknown(key, world_plus("slope", k), **prior) for k, key in enumerate(("roll", "pitch"))]
