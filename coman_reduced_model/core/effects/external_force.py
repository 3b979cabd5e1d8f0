# SPDX-License-Identifier: BSD-3-Clause
"""Something pulls at the trunk: a cable, wind, a hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .ambiguity import CONSTANT_FORCE, Ambiguity
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from ..robot.robot import Robot
    from .hooks import Now, Push


class ExternalForce(Effect):
    """A constant force at the COM of the trunk, along the axes of `odom`: those of the first support sole."""

    name: ClassVar[str] = "external_force"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("x", "float", 0.0, "N", "force along x of odom", -1e3, 1e3),
        Parameter("y", "float", 0.0, "N", "force along y of odom", -1e3, 1e3),
    )
    ambiguity: ClassVar[Ambiguity | None] = CONSTANT_FORCE
    sentence: ClassVar[str] = "something pulls at the trunk, along the axes of odom ({listed})"
    experiment: ClassVar[str] = CONSTANT_FORCE.experiment
    exact: ClassVar[bool] = True

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        self._force = np.array([self.values["x"], self.values["y"], 0.0])
        self._trunk = robot.model.frames[robot.base_id].parentJoint
        self._com = robot.model.inertias[self._trunk].lever.copy()

    def push(self, push: Push, now: Now) -> None:
        force = push.posture.R[now.foot] @ push.R_odom_sole.T @ self._force
        push.trunk[:3] += force
        push.trunk[3:] += np.cross(push.posture.data.oMi[self._trunk].act(self._com), force)

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("external_force", "spread", "reach", times=about.weight)
        return [cls.unknown(key, world_plus("pull", k), **prior) for k, key in enumerate("xy")]
