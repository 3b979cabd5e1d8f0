# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor whose wrenches are late, or early, against the joints."""

from __future__ import annotations

from typing import ClassVar

from ..base.delays import shifted
from ..base.parameter import Parameter
from ..base.stream_names import WRENCHES
from .base import Effect
from .unknown import FEET, About, Unknown, wrenches_changed


class WrenchDelay(Effect):
    """The stamps of the wrenches are true time + delay; put right before the streams are joined.

    A joint state then waits that much longer for its wrench.
    """

    name: ClassVar[str] = "wrench_delay"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", "float", 0.0, "s", "wrenches are stamped this much too late", -0.2, 0.2),
    )
    sentence: ClassVar[str] = "the wrench of {at} is {delay} late"
    experiment: ClassVar[str] = "a tap on the foot while standing: joints, IMU and wrench must show it at the same time"
    exact: ClassVar[bool] = True
    clock: ClassVar[bool] = True

    def late(self, stream: str) -> float:
        return self.values["delay"] if any(stream == WRENCHES[foot] for foot in self.feet) else 0.0

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        both = about.widths("wrench_delay.delay", "reach", spread="wrench_delay.together.spread")
        one = about.widths("wrench_delay.delay", "spread", "reach")
        out = []
        for where, feet in FEET.items():
            out.append(
                cls.unknown("delay", wrenches_changed(feet, shifted), where, step=0.005, **(one if where else both))
            )
        return out
