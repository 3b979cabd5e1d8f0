# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor whose wrenches are late, or early, against the joints."""

from __future__ import annotations

from typing import ClassVar

from ..base.parameter import Parameter
from ..base.stream_names import WRENCHES
from .base import Effect


class WrenchDelay(Effect):
    """The stamps of the wrenches are true time + delay; put right before the streams are joined.

    A joint state then waits that much longer for its wrench.
    """

    name: ClassVar[str] = "wrench_delay"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", "float", 0.0, "s", "wrenches are stamped this much too late", -0.2, 0.2),
    )

    def late(self, stream: str) -> float:
        return self.values["delay"] if any(stream == WRENCHES[foot] for foot in self.feet) else 0.0
