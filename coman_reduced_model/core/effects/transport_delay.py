# SPDX-License-Identifier: BSD-3-Clause
"""Command and motion lie apart in time: buses, controllers and drives pass the reference on late."""

from __future__ import annotations

from typing import ClassVar

from ..base.delays import shifted
from ..base.parameter import Parameter
from ..base.stream_names import MOTORS, REFERENCE
from ..base.types import Array
from .ambiguity import DRIVE_DELAY, Ambiguity
from .base import Effect
from .unknown import PLAN, About, Unknown, arrays_changed


class TransportDelay(Effect):
    """The motors do what motor states (that echo the command) and plan say a delay later.

    A reference stamped t counts at t + delay: the joiner pairs it with the joint state of that time. Of no use where
    the motor states are measured: those have moved already.
    """

    name: ClassVar[str] = "transport_delay"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", "float", 0.0, "s", "from the reference to the motion", 0.0, 0.2),
    )
    ambiguity: ClassVar[Ambiguity | None] = DRIVE_DELAY
    sentence: ClassVar[str] = "the motors move {delay} after their reference"
    experiment: ClassVar[str] = DRIVE_DELAY.experiment
    exact: ClassVar[bool] = False
    clock: ClassVar[bool] = True

    def late(self, stream: str) -> float:
        return -self.values["delay"] if stream in (MOTORS, REFERENCE) else 0.0

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        out = []
        if about.motors:
            prior = about.widths("transport_delay.delay", "spread", "reach")
            out.append(cls.unknown("delay", arrays_changed(["motor_q"], _later), step=0.005, low=0.0, **prior))
        if about.motors and about.plan:
            # Motor states that are measured show it against the plan, those that echo the command do not.
            prior = about.widths("transport_delay.plan", "spread", "reach")
            out.append(cls.unknown("delay", arrays_changed([PLAN], _later), PLAN, step=0.005, low=0.0, **prior))
        return out


def _later(values: Array, by: float, rate: float) -> Array:
    return shifted(values, -by, rate)
