# SPDX-License-Identifier: BSD-3-Clause
"""The trunk's centre of mass is not where the URDF has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .base import Effect

if TYPE_CHECKING:
    from ..robot.robot import Robot


class ComOffset(Effect):
    """Shifts the COM of the trunk (the base link with all that is fixed to it), its inertia about the COM unchanged."""

    name: ClassVar[str] = "com_offset"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("x", "float", 0.0, "m", "shift of the trunk's COM along x of robot.base_frame", -0.5, 0.5),
        Parameter("y", "float", 0.0, "m", "the same, along its y", -0.5, 0.5),
        Parameter("z", "float", 0.0, "m", "the same, along its z", -0.5, 0.5),
    )

    def load(self, robot: Robot) -> None:
        trunk = robot.model.frames[robot.base_id]
        shift = trunk.placement.rotation @ np.array([self.values[axis] for axis in "xyz"])
        robot.model.inertias[trunk.parentJoint].lever += shift
