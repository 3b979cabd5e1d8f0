# SPDX-License-Identifier: BSD-3-Clause
"""A load on the trunk that the URDF lacks."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pinocchio as pin

from ..base.parameter import Parameter
from .base import Effect

if TYPE_CHECKING:
    from ..robot.robot import Robot


class Payload(Effect):
    """A point mass fixed to the trunk, its place in `robot.base_frame`.

    It moves the measured COM, too, and counts in all shares of the weight.
    """

    name: ClassVar[str] = "payload"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("mass", "float", 0.0, "kg", "that the URDF lacks (negative: has too much)", -20.0, 50.0),
        Parameter("x", "float", 0.0, "m", "where it is in the trunk's frame, robot.base_frame", -2.0, 2.0),
        Parameter("y", "float", 0.0, "m", "the same, along its y", -2.0, 2.0),
        Parameter("z", "float", 0.0, "m", "the same, along its z", -2.0, 2.0),
    )

    def load(self, robot: Robot) -> None:
        if self.values["mass"] != 0.0:
            trunk = robot.model.frames[robot.base_id]
            point = trunk.placement.act(np.array([self.values[axis] for axis in "xyz"]))
            robot.model.inertias[trunk.parentJoint] += pin.Inertia(self.values["mass"], point, np.zeros((3, 3)))
