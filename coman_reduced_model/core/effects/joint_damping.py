# SPDX-License-Identifier: BSD-3-Clause
"""Dampers that are weaker or stronger than the data sheet says."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect
from .scaled import scaled_joints
from .unknown import About, Unknown

if TYPE_CHECKING:
    from .hooks import LegSprings


class JointDamping(Effect):
    """Scales the damping of a joint, of a leg's joints or of all."""

    name: ClassVar[str] = "joint_damping"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", "float", 1.0, "1", "real damping over that of the configuration", 0.0, 20.0),
    )
    sentence: ClassVar[str] = "the damping of {at} is {scale} of nominal"
    experiment: ClassVar[str] = (
        "small pushes while only this joint gives way, as in the decay of coman identify: how fast its swing dies away"
    )
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque rate")

    def springs(self, leg: LegSprings) -> None:
        for i in self.leg_joints.get(leg.foot, ()):
            leg.D_q[i, i] *= self.values["scale"]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        return scaled_joints(cls, about, "damping")
