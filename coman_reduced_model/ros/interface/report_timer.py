# SPDX-License-Identifier: BSD-3-Clause
"""The timer of reports such as /diagnostics, whose rate may change while the node runs."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


class ReportTimer:
    """Calls a function at a rate, in steady time: also while a simulation or a bag is paused."""

    def __init__(self, node: Node, report: Callable[[], None]) -> None:
        """Nothing is called before `set_rate`."""
        self._node, self._report = node, report
        self._timer: Timer | None = None
        self._rate = 0.0

    def set_rate(self, rate: float) -> None:
        """Call it at this rate from now on [Hz]."""
        if rate == self._rate:
            return
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._rate = rate
        self._timer = self._node.create_timer(1.0 / rate, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))
