# SPDX-License-Identifier: BSD-3-Clause
"""The link side comes late: its stamps tell a time that is past."""

from __future__ import annotations

from typing import ClassVar

from ..base.parameter import Parameter
from ..base.stream_names import JOINTS
from .base import Effect


class EncoderDelay(Effect):
    """The stamps of the joint states are true time + delay.

    The stamps are put right before the streams are joined, so that motor side, wrenches and plan are taken at the true
    time: exact, causal, and what comes out is stamped with the true time.
    """

    name: ClassVar[str] = "encoder_delay"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", "float", 0.0, "s", "joint states are stamped this much too late", -0.2, 0.2),
    )

    def late(self, stream: str) -> float:
        return self.values["delay"] if stream == JOINTS else 0.0
