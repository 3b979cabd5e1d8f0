# SPDX-License-Identifier: BSD-3-Clause
"""The link side comes late: its stamps are later than its values."""

from __future__ import annotations

from typing import ClassVar

from ..base.delays import shifted
from ..base.parameter import Parameter
from ..base.stream_names import JOINTS
from .base import Effect
from .unknown import LINKS, About, Unknown, arrays_changed


class EncoderDelay(Effect):
    """The stamps of the joint states are true time + delay.

    The stamps are put right before the streams are joined, so that motor side, wrenches and plan are taken at the true
    time: exact, causal, and what comes out is stamped with the true time.
    """

    name: ClassVar[str] = "encoder_delay"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", "float", 0.0, "s", "joint states are stamped this much too late", -0.2, 0.2),
    )
    sentence: ClassVar[str] = "the joint states are {delay} late"
    experiment: ClassVar[str] = "a tap on the leg while standing: joints, IMU and wrench must show it at the same time"
    exact: ClassVar[bool] = True
    clock: ClassVar[bool] = True

    def late(self, stream: str) -> float:
        return self.values["delay"] if stream == JOINTS else 0.0

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("encoder_delay.delay", "spread", "reach")
        ways = {"": ("q",), LINKS: ("q", "tau")} if about.efforts else {"": ("q",)}
        return [
            cls.unknown("delay", arrays_changed(arrays, shifted), way, step=0.005, low=0.0, **prior)
            for way, arrays in ways.items()
        ]
