# SPDX-License-Identifier: BSD-3-Clause
"""Command and motion lie apart in time: buses, controllers and drives pass the reference on late."""

from __future__ import annotations

from typing import ClassVar

from ..base.parameter import Parameter
from ..base.stream_names import MOTORS, REFERENCE
from .base import Effect


class TransportDelay(Effect):
    """The motors do what motor states (that echo the command) and plan say a delay later.

    A reference stamped t counts at t + delay: the joiner pairs it with the joint state of that time. Of no use where
    the motor states are measured: those have moved already.
    """

    name: ClassVar[str] = "transport_delay"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", "float", 0.0, "s", "from the reference to the motion", 0.0, 0.2),
    )

    def late(self, stream: str) -> float:
        return -self.values["delay"] if stream in (MOTORS, REFERENCE) else 0.0
