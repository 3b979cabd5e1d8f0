# SPDX-License-Identifier: BSD-3-Clause
"""The trunk's centre of mass is not where the URDF has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pinocchio as pin

from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Change, Measured, Unknown, World

if TYPE_CHECKING:
    from ..base.types import Array
    from ..robot.robot import Robot


class ComOffset(Effect):
    """Shifts the COM of the trunk (the base link with all that is fixed to it), its inertia about the COM unchanged."""

    name: ClassVar[str] = "com_offset"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("x", "float", 0.0, "m", "shift of the trunk's COM along x of robot.base_frame", -0.5, 0.5),
        Parameter("y", "float", 0.0, "m", "the same, along its y", -0.5, 0.5),
        Parameter("z", "float", 0.0, "m", "the same, along its z", -0.5, 0.5),
    )
    sentence: ClassVar[str] = (
        "the trunk's COM is not where the URDF says, along the axes of robot.base_frame ({listed})"
    )
    experiment: ClassVar[str] = "standing still, leaning forward, back and to both sides"
    exact: ClassVar[bool] = True

    def load(self, robot: Robot) -> None:
        trunk = robot.model.frames[robot.base_id]
        shift = trunk.placement.rotation @ np.array([self.values[axis] for axis in "xyz"])
        robot.model.inertias[trunk.parentJoint].lever += shift

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        trunk = about.robot.model.frames[about.robot.base_id]
        out = []
        for key, axis in zip("xyz", trunk.placement.rotation.T, strict=True):
            # Walking hardly shows the height of a COM: nominal robots' scatter of it, and no more.
            prior = about.widths(f"com_offset.{'height' if key == 'z' else 'shift'}", "reach", times=about.leg)
            out.append(cls.unknown(key, lever_plus(trunk.parentJoint, axis.copy()), step=0.005, **prior))
        return out


def lever_plus(body: int, axis: Array) -> Change:
    """Shifts the COM of a body along an axis (3,) in the frame of its joint."""

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        model = w.model.copy()
        old = model.inertias[body]
        new = pin.Inertia(old)
        new.lever = old.lever + x * axis
        model.inertias[body] = new
        return r, w.changed(model=model)

    return apply
