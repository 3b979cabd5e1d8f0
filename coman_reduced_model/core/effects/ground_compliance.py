# SPDX-License-Identifier: BSD-3-Clause
"""Floor or sole gives way under a loaded foot: it sinks in and tilts."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from ..base.types import Foot
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from ..base.types import Array, Sample
    from ..robot.robot import Robot
    from .hooks import LegSprings

_DAMPED = 1e-6  # of the inverse of the leg's Jacobian, where the knee is straight


class GroundCompliance(Effect):
    """Springs in z and about x and y between each sole and level ground, in series with the leg.

    No encoder sees what gives way there, but the foot's wrench shows it. Both are given as angles of the leg's
    joints: what they would have to do on hard ground to move the trunk as much is added to what they are measured to
    do, and the compliance of the ground to that of their springs. So the measured COM stands above level ground, and
    the springs between it and the motors are all there are. Velocities stay as measured: those of what gives way, some
    mm/s, are left out.
    """

    name: ClassVar[str] = "ground_compliance"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("vertical", "float", 0.0, "m/N", "of the ground under one foot", 0.0, 1e-3),
        Parameter("rotational", "float", 0.0, "rad/Nm", "the same, about x and y of the sole", 0.0, 0.1),
    )
    sentence: ClassVar[str] = "the ground or the soles give way more than usual ({listed})"
    experiment: ClassVar[str] = "the same walk on a hard floor"
    absent: ClassVar[bool] = True
    exact: ClassVar[bool] = False

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        self._legs = {foot: robot.legs[foot] for foot in self.feet}
        self._posture = robot.posture()
        vertical, rotational = self.values["vertical"], self.values["rotational"]
        self._compliance = np.array([vertical, rotational, rotational])

    def correct(self, sample: Sample) -> None:
        if not self._compliance.any():
            return
        self._posture.update(sample.q, sample.qd)
        wrenches = {Foot.LEFT: sample.left_wrench, Foot.RIGHT: sample.right_wrench}
        for foot, leg in self._legs.items():
            wrench = wrenches[foot]
            if wrench is not None:
                sample.q[leg] -= self._measured_as_joints(foot) @ (self._compliance * wrench[2:5])

    def springs(self, leg: LegSprings) -> None:
        if leg.foot not in self._legs or not self._compliance.any():
            return
        A, n = as_joints(leg.J, leg.com), len(leg.joints)
        # Share of the deflection that is in the joints: 1 / (1 + G K) with G the ground's compliance.
        share = np.linalg.inv(np.eye(n) + A * self._compliance @ A.T @ leg.K_q)
        leg.K_q[:] = leg.K_q @ share
        leg.D_q[:] = share.T @ leg.D_q @ share
        leg.torque[:] = share.T @ leg.torque

    def _measured_as_joints(self, foot: Foot) -> Array:
        posture = self._posture
        J, com = posture.leg_jacobian(foot), posture.com_in_sole(foot)[0]
        # Of the COM of all links, of which those of the leg move less than the trunk.
        J[:3] += posture.R[foot].T @ posture.J_com[:, posture.robot.leg_columns[foot]]
        return as_joints(J, com)

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        out = []
        for key, load, field in (("rotational", about.edge, "tilting"), ("vertical", about.weight, "sinking")):
            usual = ("usual",) if key == "vertical" else ()  # soles turn otherwise: `soles` of diagnose/physics
            prior = about.widths(f"ground_compliance.{key}", *usual, "spread", "reach", per=load)
            out.append(cls.unknown(key, world_plus(field), low=0.0, **prior))
        return out


def as_joints(J: Array, com: Array) -> Array:
    """Joint motion (n, 3) that moves COM and trunk as the sole's sinking [m] and turning about x and y [rad] do.

    Args:
        J: (6, n) velocity of the COM and angular velocity of the trunk by the joints, in sole axes.
        com: (3,) COM in the sole frame [m].
    """
    ground = np.zeros((6, 3))
    ground[2, 0] = ground[3, 1] = ground[4, 2] = 1.0
    ground[:3, 1], ground[:3, 2] = (0.0, -com[2], com[1]), (com[2], 0.0, -com[0])  # axis x COM
    return J.T @ np.linalg.solve(J @ J.T + _DAMPED * np.eye(6), ground)
