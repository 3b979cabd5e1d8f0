# SPDX-License-Identifier: BSD-3-Clause
"""A plane floor that is not level."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .base import Effect

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

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        roll, pitch = self.values["roll"], self.values["pitch"]
        down = np.array([sin(pitch), -cos(pitch) * sin(roll), -cos(pitch) * cos(roll)])
        self._force = robot.mass * robot.config.gravity * (down - [0.0, 0.0, -1.0])

    def push(self, push: Push, now: Now) -> None:
        push.force += push.R_odom_sole.T @ self._force
