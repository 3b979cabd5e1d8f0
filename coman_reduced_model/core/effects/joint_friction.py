# SPDX-License-Identifier: BSD-3-Clause
"""Coulomb friction in the bearings of the joints, on the link side."""

from __future__ import annotations

from math import tanh
from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect

if TYPE_CHECKING:
    from .hooks import LegSprings

CREEP = 0.03  # [rad/s] unless told


class JointFriction(Effect):
    """A torque coulomb * tanh(speed / creep) against the motion of the link.

    Told as the damper with that torque at the present speed: for any step stable, as friction is.
    """

    name: ClassVar[str] = "joint_friction"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("coulomb", "float", 0.0, "Nm", "friction torque against the motion of the link", 0.0, 200.0),
        Parameter("creep", "float", CREEP, "rad/s", "speed below which it creeps instead of sticking", 0.001, 10.0),
    )

    def springs(self, leg: LegSprings) -> None:
        for i in self.leg_joints.get(leg.foot, ()):
            speed = leg.motor_rate[i] + leg.rate[i]
            coulomb, creep = self.values["coulomb"], self.values["creep"]
            ratio = speed / creep
            damping = coulomb / creep * (tanh(ratio) / ratio if abs(ratio) > 1e-6 else 1.0)
            leg.D_q[i, i] += damping
            leg.torque[i] += damping * leg.motor_rate[i]
