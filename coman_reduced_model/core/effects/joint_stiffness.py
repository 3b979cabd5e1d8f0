# SPDX-License-Identifier: BSD-3-Clause
"""Springs that are softer or stiffer than the data sheet says."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect
from .scaled import scaled_joints
from .unknown import About, Unknown

if TYPE_CHECKING:
    from .hooks import LegSprings


class JointStiffness(Effect):
    """Scales the stiffness of a joint, of a leg's joints or of all; the dampers stay."""

    name: ClassVar[str] = "joint_stiffness"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", "float", 1.0, "1", "real stiffness over that of the configuration", 0.05, 20.0),
    )
    sentence: ClassVar[str] = "the stiffness of {at} is {scale} of nominal"
    experiment: ClassVar[str] = "the joint loaded slowly to a known torque, or a heavier load on the same gait"
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque")

    def springs(self, leg: LegSprings) -> None:
        for i in self.leg_joints.get(leg.foot, ()):
            leg.K_q[i, i] *= self.values["scale"]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        return scaled_joints(cls, about, "stiffness")
