# SPDX-License-Identifier: BSD-3-Clause
"""The position loops of the motors yield under load."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect

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

    def springs(self, leg: LegSprings) -> None:
        for i in range(len(leg.joints)):
            share = 1.0 / (1.0 + self.values["compliance"] * leg.K_q[i, i])  # of the deflection, in the spring
            leg.K_q[i, i] *= share
            leg.torque[i] *= share
            leg.D_q[i, i] *= share * share
