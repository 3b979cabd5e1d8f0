# SPDX-License-Identifier: BSD-3-Clause
"""A load on the trunk that the URDF lacks."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pinocchio as pin

from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Change, Measured, Unknown, World

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
    sentence: ClassVar[str] = "the trunk carries {mass} that the URDF lacks"
    further: ClassVar[str] = " (in robot.base_frame at {rest})"
    experiment: ClassVar[str] = "the robot on a scale, then leaning forward and back while it stands"
    exact: ClassVar[bool] = True
    together: ClassVar[tuple[tuple[str, ...], ...]] = (("mass", "x", "y", "z"), ("mass",), ("mass", "x"))

    def load(self, robot: Robot) -> None:
        if self.values["mass"] != 0.0:
            trunk = robot.model.frames[robot.base_id]
            point = trunk.placement.act(np.array([self.values[axis] for axis in "xyz"]))
            robot.model.inertias[trunk.parentJoint] += pin.Inertia(self.values["mass"], point, np.zeros((3, 3)))

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        robot = about.robot
        trunk = robot.model.inertias[robot.model.frames[robot.base_id].parentJoint].mass
        mass = about.widths("payload.mass", "reach", times=robot.mass)
        out = [cls.unknown("mass", _heavier, step=0.1, low=-0.8 * trunk, **mass)]
        for k, key in enumerate("xyz"):
            moment = about.widths(f"payload.moment_{key}", "reach", times=robot.mass * about.leg)
            out.append(cls.unknown(key, _moved(k), unit="kg m", step=0.1, **moment))
        return out


def _heavier(r: Measured, w: World, x: float) -> tuple[Measured, World]:
    return r, w.add_mass(x, np.zeros(3), w.robot.base_id)


def _moved(k: int) -> Change:
    """A first moment [kg m] along an axis: two masses that cancel, 0.1 m away each way."""
    at = 0.1 * np.eye(3)[k]

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        return r, w.add_mass(x / 0.2, at, w.robot.base_id).add_mass(-x / 0.2, -at, w.robot.base_id)

    return apply
