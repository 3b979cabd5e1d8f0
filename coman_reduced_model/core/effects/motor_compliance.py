# SPDX-License-Identifier: BSD-3-Clause
"""The position loops of the motors yield under load."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect
from .unknown import PLAN, About, Unknown, world_plus

if TYPE_CHECKING:
    from .hooks import LegSprings


class MotorCompliance(Effect):
    """motor = reference - compliance * spring torque: a compliance in series with every joint, 1 / k + compliance.

    For motor states that echo the command, and for `reference: topic`. Where they are measured the yielding is in them
    already.
    """

    name: ClassVar[str] = "motor_compliance"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("compliance", "float", 0.0, "rad/Nm", "of the position loop of each motor", 0.0, 0.1),
    )
    sentence: ClassVar[str] = "the motors yield under load by {compliance}"
    experiment: ClassVar[str] = "standing under two known loads, with motor states that are measured"
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque")

    def springs(self, leg: LegSprings) -> None:
        for i in range(len(leg.joints)):
            share = 1.0 / (1.0 + self.values["compliance"] * leg.K_q[i, i])  # of the deflection, in the spring
            leg.K_q[i, i] *= share
            leg.torque[i] *= share
            leg.D_q[i, i] *= share * share

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        name = "motor_compliance.compliance"
        out = []
        if about.motors:
            prior = about.widths(name, "spread", "reach", per=about.edge)
            out.append(cls.unknown("compliance", world_plus("yielding"), low=0.0, **prior))
        if about.motors and about.plan:
            prior = about.widths(name, "reach", spread="motor_compliance.plan.spread", per=about.edge)
            out.append(cls.unknown("compliance", world_plus("yielded"), PLAN, low=0.0, **prior))
        return out
