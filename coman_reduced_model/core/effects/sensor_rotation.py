# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor whose axes are turned against those that the URDF gives it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pinocchio as pin

from ..base.parameter import Parameter
from ..base.types import Foot
from .base import Effect
from .unknown import FEET, About, Change, Measured, Unknown, World

if TYPE_CHECKING:
    from ..base.types import Array, Sample
    from ..robot.robot import Robot

_AXES = ("roll", "pitch", "yaw")


class SensorRotation(Effect):
    """The sensor's axes are those of the sole turned by roll, pitch and yaw, which is taken back, about the sensor.

    The sensor is at the origin of the frame of its wrenches; where that is the sole, as the URDF names a force sensor.
    """

    name: ClassVar[str] = "sensor_rotation"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(axis, "float", 0.0, "rad", f"{axis} of the sensor's axes against those of the sole", -1.0, 1.0)
        for axis in _AXES
    )
    sentence: ClassVar[str] = "the axes of the force sensor of {at} are turned against its sole ({listed})"
    experiment: ClassVar[str] = "standing still on each foot: nothing pulls, so the force must be vertical"
    exact: ClassVar[bool] = True

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self._R = turned(np.array([values[axis] for axis in _AXES]))

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        self._robot = robot

    def correct(self, sample: Sample) -> None:
        for foot in self.feet:
            wrench = sample.left_wrench if foot == Foot.LEFT else sample.right_wrench
            if wrench is not None:
                wrench[:] = turned_wrenches(self._R, self._robot.sensor_position(foot), wrench)

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        one = about.widths("sensor_rotation.angle", "spread", "reach")
        both = about.widths("sensor_rotation.angle", "reach", spread="sensor_rotation.together.spread")
        return [
            cls.unknown(axis, _turn(about.robot, where, k), where, step=0.01, **(one if where else both))
            for where in FEET
            for k, axis in enumerate(_AXES)
        ]


def turned(angles: Array) -> Array:
    """(3, 3) rotation by a rotation vector (3,) [rad]; one axis after the other is the same for small angles."""
    return np.asarray(pin.exp3(angles))


def turned_wrenches(R: Array, sensor: Array, wrench: Array) -> Array:
    """Wrenches (..., 6) about a sole, turned by R (3, 3) about the sensor at (3,) [m]."""
    force = wrench[..., :3] @ R.T
    moment = (wrench[..., 3:] - np.cross(sensor, wrench[..., :3])) @ R.T + np.cross(sensor, force)
    return np.concatenate([force, moment], axis=-1)


def _turn(robot: Robot, where: str, k: int) -> Change:
    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        R = turned(x * np.eye(3)[k])
        changed = {f: turned_wrenches(R, robot.sensor_position(f), r.wrench[f]) for f in FEET[where]}
        return r.changed(wrench={**r.wrench, **changed}), w

    return apply
