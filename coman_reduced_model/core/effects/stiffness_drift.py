# SPDX-License-Identifier: BSD-3-Clause
"""Springs whose stiffness changes while the robot walks, as they warm up."""

from __future__ import annotations

from collections.abc import Mapping
from math import expm1
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Unknown, world_elements, world_plus

if TYPE_CHECKING:
    from ..base.types import SupportState
    from .hooks import LegSprings

TIME = 10.0  # [s] unless configured
_SHORTEST, _LEAST = 0.1, -0.95  # [s]; of the change


class StiffnessDrift(Effect):
    """A stiffness k (1 + change (1 - exp(-t / time))), t since the first sample; a gap does not cool a spring."""

    name: ClassVar[str] = "stiffness_drift"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("change", "float", 0.0, "1", "of the stiffness in the end, relative", _LEAST, 5.0),
        Parameter("time", "float", TIME, "s", "constant of the change", _SHORTEST, 1e4),
    )
    sentence: ClassVar[str] = "the spring of {at} grows stiffer by {change_size} while the robot walks"
    opposite: ClassVar[str] = "the spring of {at} grows softer by {change_size} while the robot walks"
    further: ClassVar[str] = " with a time constant of {time}"
    experiment: ClassVar[str] = (
        "the joint loaded to a known torque when all is cold, and again after some minutes of walking"
    )
    exact: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = ("spring", "torque")

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self._first_ns: int | None = None
        self._factor = 1.0

    def begin(self, stamp_ns: int, support: SupportState) -> None:
        if self._first_ns is None or stamp_ns < self._first_ns:
            self._first_ns = stamp_ns
        gone = 1e-9 * (stamp_ns - self._first_ns)
        self._factor = 1.0 - self.values["change"] * expm1(-gone / self.values["time"])

    def springs(self, leg: LegSprings) -> None:
        for i in self.leg_joints.get(leg.foot, ()):
            leg.K_q[i, i] *= self._factor

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        one = about.widths("stiffness_drift.change", "spread", "reach")
        many = about.widths("stiffness_drift.change", "reach", spread="stiffness_drift.together.spread")
        time = about.widths("stiffness_drift.time", "reach")
        low = float(np.log(_SHORTEST / TIME))
        out = []
        for where, j in about.joints_and_legs.items() if about.motors else ():
            prior = one if where in about.joints else many
            later = world_elements("warming", j, lambda constant, x: constant * np.exp(x))
            out.append(cls.unknown("change", world_plus("drift", j), where, low=_LEAST, **prior))
            out.append(cls.unknown("time", later, where, low=low, logarithmic=True, shape=True, **time))
        return out
