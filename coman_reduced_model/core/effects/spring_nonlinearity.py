# SPDX-License-Identifier: BSD-3-Clause
"""Springs that harden or soften as they are deflected."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Unknown, world_plus

if TYPE_CHECKING:
    from .hooks import LegSprings

_BENDS = 2.0  # counts of an encoder that a spring must stretch by: the errors of an encoder come again with every step
_SOFTEST = 0.2  # a softening spring goes on straight where its tangent has fallen to this share: it stays a spring


class SpringNonlinearity(Effect):
    """Torque k d (1 + cubic d^2), as its tangent at the deflection d that the free run has."""

    name: ClassVar[str] = "spring_nonlinearity"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("cubic", "float", 0.0, "1/rad^2", "hardening (> 0) or softening (< 0) of the spring", -1e6, 1e6),
    )
    sentence: ClassVar[str] = "the spring of {at} hardens ({listed})"
    opposite: ClassVar[str] = "the spring of {at} softens ({listed})"
    experiment: ClassVar[str] = "the joint loaded slowly to its largest torque, both ways"
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque")

    def springs(self, leg: LegSprings) -> None:
        cubic = self.values["cubic"]
        straight_from = ((1.0 - _SOFTEST) / (-3.0 * cubic)) ** 0.5 if cubic < 0.0 else 1.0  # [rad]
        for i in self.leg_joints.get(leg.foot, ()):
            k = leg.K_q[i, i]
            d = min(straight_from, max(-straight_from, leg.deflection[i]))
            leg.K_q[i, i] = k * (1.0 + 3.0 * cubic * d * d)
            leg.torque[i] -= 2.0 * k * cubic * d**3

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        out = []
        for where, j in about.joints_and_legs.items() if about.motors else ():
            stretch = float(about.stretch[j].max())
            offered = bool((about.stretch[j] > _BENDS * about.count[j]).any())
            spread = f"spring_nonlinearity.{'cubic' if where in about.joints else 'together'}.spread"
            prior = about.widths("spring_nonlinearity.cubic", "reach", per=stretch**2, spread=spread)
            out.append(cls.unknown("cubic", world_plus("cubic", j), where, offered=offered, **prior))
        return out
