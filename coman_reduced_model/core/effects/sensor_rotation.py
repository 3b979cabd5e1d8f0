# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor whose axes are turned against those that the URDF gives it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pinocchio as pin

from ..base.parameter import Parameter
from .base import Effect
from .unknown import FEET, About, Change, Unknown, wrenches_changed

if TYPE_CHECKING:
    from ..base.types import Array, Sample

_AXES = ("roll", "pitch", "yaw")


class SensorRotation(Effect):
    """The sensor's axes are those of the sole turned by roll, pitch and yaw; its forces and moments are turned back."""

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

    def correct(self, sample: Sample) -> None:
        for wrench in self.wrenches(sample):
            wrench[:3], wrench[3:] = self._R @ wrench[:3], self._R @ wrench[3:]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("sensor_rotation.angle", "spread", "reach")
        return [
            cls.unknown(axis, _turn(where, k), where, step=0.01, **prior)
            for where in ("left", "right")
            for k, axis in enumerate(_AXES)
        ]


def turned(angles: Array) -> Array:
    """(3, 3) rotation by a rotation vector (3,) [rad]; one axis after the other is the same for small angles."""
    return np.asarray(pin.exp3(angles))


def _turn(where: str, k: int) -> Change:
    def apply(wrench: Array, x: float, _: float) -> Array:
        R = turned(x * np.eye(3)[k])
        return np.hstack([wrench[:, :3] @ R.T, wrench[:, 3:] @ R.T])

    return wrenches_changed(FEET[where], apply)
