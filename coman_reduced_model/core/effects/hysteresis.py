# SPDX-License-Identifier: BSD-3-Clause
"""Lost motion in a gear that friction holds: a joint rests elsewhere, depending on how it was loaded before."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .ambiguity import LOST_MOTION, Ambiguity
from .base import Effect
from .unknown import About, Unknown, world_elements, world_plus

if TYPE_CHECKING:
    from ..base.types import Array, Foot
    from .hooks import LegSprings

FRICTION = 0.5  # [Nm] unless configured
_LEAST, _MOST = 0.02, 100.0  # [Nm]
_STEP = 0.005  # [rad] of the difference quotient: about as wide as a lost motion that shows, as slipping takes time


class Hysteresis(Effect):
    """A slip within +-width/2 in series with a joint's spring, held by friction: it moves under larger torques only.

    Unlike play it stays where it is when the load goes, until the load comes from the other side.
    """

    name: ClassVar[str] = "hysteresis"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("width", "float", 0.0, "rad", "lost motion, full, in series with the spring", 0.0, 0.5),
        Parameter("friction", "float", FRICTION, "Nm", "torque below which it stays where it is", _LEAST, _MOST),
    )
    sentence: ClassVar[str] = "{at} has {width} of lost motion that depends on how it was loaded before"
    further: ClassVar[str] = " and is held by {friction}"
    experiment: ClassVar[str] = LOST_MOTION.experiment
    ambiguity: ClassVar[Ambiguity | None] = LOST_MOTION
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque")

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self.reset()

    def reset(self) -> None:
        self._slips: dict[Foot, Array] = {}

    def springs(self, leg: LegSprings) -> None:
        half, friction = 0.5 * self.values["width"], self.values["friction"]
        if not half > 0.0:
            return
        slips = self._slips.setdefault(leg.foot, np.zeros(len(leg.joints)))
        for i in self.leg_joints.get(leg.foot, ()):
            k = leg.K_q[i, i]
            stretch = leg.deflection[i] - slips[i]
            beyond = stretch - min(max(stretch, -friction / k), friction / k)
            slips[i] = min(max(slips[i] + beyond, -half), half)
            leg.torque[i] -= k * slips[i]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        one = about.widths("hysteresis.width", "spread", "reach")
        many = about.widths("hysteresis.width", "reach", spread="hysteresis.together.spread")
        friction = about.widths("hysteresis.friction", "reach")
        low = float(np.log(_LEAST / FRICTION))
        out = []
        for where, j in about.joints_and_legs.items() if about.motors else ():
            alone = where in about.joints
            out.append(
                cls.unknown("width", world_plus("lost", j), where, step=_STEP, low=0.0, **(one if alone else many))
            )
            if alone:
                held = world_elements("slips_at", j, lambda torque, x: torque * np.exp(x))
                out.append(cls.unknown("friction", held, where, low=low, logarithmic=True, shape=True, **friction))
        return out
