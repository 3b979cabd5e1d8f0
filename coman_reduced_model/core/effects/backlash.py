# SPDX-License-Identifier: BSD-3-Clause
"""Play between motor and link: the spring transmits nothing until it is taken up."""

from __future__ import annotations

from math import exp, log1p
from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .ambiguity import LOST_MOTION, Ambiguity
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from .hooks import LegSprings

_SMOOTH = 0.1  # of half the play: how gradually it ends
_LEFT = 0.01  # share of the stiffness that is left inside: without any the leg would have no equilibrium


class Backlash(Effect):
    """A dead zone in series with a joint's spring and damper, as the tangent of its law at the deflection."""

    name: ClassVar[str] = "backlash"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("width", "float", 0.0, "rad", "full play in series with the spring", 0.0, 0.5),
    )
    sentence: ClassVar[str] = "{at} has {width} of backlash"
    experiment: ClassVar[str] = LOST_MOTION.experiment
    ambiguity: ClassVar[Ambiguity | None] = LOST_MOTION
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque")

    def springs(self, leg: LegSprings) -> None:
        half = 0.5 * self.values["width"]
        if not half > 0.0:
            return
        for i in self.leg_joints.get(leg.foot, ()):
            d, k = leg.deflection[i], leg.K_q[i, i]
            taken, slope = dead_zone(d, half)
            # What the law so far gives for what is left of the deflection, given by the tangent in the whole of it.
            leg.torque[i] += k * (taken - slope * d)
            leg.K_q[i, i] = k * slope
            leg.D_q[i, i] *= slope

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        one = about.widths("backlash.width", "spread", "reach")
        many = about.widths("backlash.width", "reach", spread="backlash.together.spread")
        return [
            cls.unknown("width", world_plus("play", j), where, low=0.0, **(one if where in about.joints else many))
            for where, j in (about.joints_and_legs if about.motors else {}).items()
        ]


def dead_zone(d: float, half: float) -> tuple[float, float]:
    """What a dead zone of +-half [rad] leaves of a deflection d [rad], and the slope of that."""
    s = _SMOOTH * half
    above, below = (d - half) / s, (-d - half) / s
    left = s * (_softplus(above) - _softplus(below))
    slope = _logistic(above) + _logistic(below)
    return _LEFT * d + (1.0 - _LEFT) * left, _LEFT + (1.0 - _LEFT) * slope


def _softplus(x: float) -> float:
    return max(x, 0.0) + log1p(exp(-abs(x)))


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + exp(-x)) if x >= 0.0 else exp(x) / (1.0 + exp(x))
