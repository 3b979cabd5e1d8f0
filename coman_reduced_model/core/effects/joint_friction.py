# SPDX-License-Identifier: BSD-3-Clause
"""Coulomb friction in the bearings of the joints, on the link side."""

from __future__ import annotations

from math import tanh
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Unknown, world_elements, world_plus

if TYPE_CHECKING:
    from .hooks import LegSprings

CREEP = 0.03  # [rad/s] unless configured
_SLOWEST = 0.005  # [rad/s] below which nothing creeps


class JointFriction(Effect):
    """A torque coulomb * tanh(speed / creep) against the motion of the link.

    Written as the damper with that torque at the present speed: for any step stable, as friction is.
    """

    name: ClassVar[str] = "joint_friction"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("coulomb", "float", 0.0, "Nm", "friction torque against the motion of the link", 0.0, 200.0),
        Parameter("creep", "float", CREEP, "rad/s", "speed below which it creeps instead of sticking", 0.001, 10.0),
    )
    sentence: ClassVar[str] = "{at} has {coulomb} of friction"
    further: ClassVar[str] = " and creeps below {creep}"
    experiment: ClassVar[str] = (
        "the joint moved slowly both ways: its torque changes sign with the motion, and does not grow with the speed"
    )
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("torque", "speed")

    def springs(self, leg: LegSprings) -> None:
        for i in self.leg_joints.get(leg.foot, ()):
            speed = leg.motor_rate[i] + leg.rate[i]
            coulomb, creep = self.values["coulomb"], self.values["creep"]
            ratio = speed / creep
            damping = coulomb / creep * (tanh(ratio) / ratio if abs(ratio) > 1e-6 else 1.0)
            leg.D_q[i, i] += damping
            leg.torque[i] += damping * leg.motor_rate[i]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        one = about.widths("joint_friction.coulomb", "spread", "reach", times=about.edge)
        together = "joint_friction.together.spread"
        many = about.widths("joint_friction.coulomb", "reach", spread=together, times=about.edge)
        creep = about.widths("joint_friction.creep", "spread", "reach")
        out = []
        for where, j in about.joints_and_legs.items() if about.efforts or about.motors else ():
            slower = world_elements("creep", j, lambda speed, x: np.maximum(speed + x, _SLOWEST))
            coulomb = one if where in about.joints else many
            out.append(cls.unknown("coulomb", world_plus("friction", j), where, low=0.0, **coulomb))
            if where in about.joints:
                out.append(cls.unknown("creep", slower, where, low=_SLOWEST - CREEP, shape=True, **creep))
        return out
