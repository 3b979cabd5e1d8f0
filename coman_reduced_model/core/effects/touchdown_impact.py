# SPDX-License-Identifier: BSD-3-Clause
"""A foot that lands hard: the ground gives the robot a blow."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, sin
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from ..base.types import Foot, Phase
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from ..base.types import SupportState
    from ..robot.robot import Robot
    from .hooks import Now, Push

_DURATION = 0.02  # [s] of the blow, or four samples if those take longer


class TouchdownImpact(Effect):
    """An impulse of the ground on the foot that lands, which its leg passes on to the trunk at the hip.

    It begins at the sample that shows the landing: there the free run starts again, from a velocity that knows nothing
    of the blow yet.
    """

    name: ClassVar[str] = "touchdown_impact"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("impulse", "float", 0.0, "Ns", "of the ground on a landing foot, along its leg", 0.0, 50.0),
    )
    sentence: ClassVar[str] = "each touchdown is a blow of {impulse}"
    experiment: ClassVar[str] = "the same walk on a soft mat, which takes the blow"
    absent: ClassVar[bool] = True
    exact: ClassVar[bool] = False

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self.reset()

    def reset(self) -> None:
        self._phase = Phase.FLIGHT
        self._landed = Foot.NONE
        self._stamp_ns = 0
        self._since = 0.0  # [s] time since the landing
        self._duration = _DURATION

    def bind(self, robot: Robot) -> None:
        super().bind(robot)
        first = {foot: robot.joint_names[legs[0]] for foot, legs in robot.legs.items()}
        self._hips = {foot: robot.model.getJointId(name) for foot, name in first.items()}

    def begin(self, stamp_ns: int, support: SupportState) -> None:
        dt = (stamp_ns - self._stamp_ns) * 1e-9 if self._stamp_ns else 0.0
        before, self._phase, self._stamp_ns = self._phase, support.phase, stamp_ns
        self._since += dt
        if before in (Phase.LEFT, Phase.RIGHT) and self._phase == Phase.DOUBLE:
            self._landed = Foot.RIGHT if before == Phase.LEFT else Foot.LEFT
            self._since, self._duration = 0.0, max(_DURATION, 4.0 * dt)

    def push(self, push: Push, now: Now) -> None:
        if self._landed == Foot.NONE or not self._since < self._duration:
            return
        hip = push.posture.data.oMi[self._hips[self._landed]].translation
        leg = hip - push.posture.p[self._landed]
        size = 2.0 * self.values["impulse"] / self._duration * sin(pi * self._since / self._duration) ** 2
        force = size / np.linalg.norm(leg) * leg
        push.trunk[:3] += force
        push.trunk[3:] += np.cross(hip, force)

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        blow = about.widths("touchdown_impact.impulse", "spread", "reach", times=about.robot.mass)
        return [cls.unknown("impulse", world_plus("impulse"), low=0.0, **blow)]
