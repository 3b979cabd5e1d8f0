# SPDX-License-Identifier: BSD-3-Clause
"""Fewer messages than samples, by their stamps."""

from __future__ import annotations


class Throttle:
    """Lets through the first sample of each interval of a fixed grid, so that jitter does not lower the rate."""

    def __init__(self, rate_hz: float) -> None:
        """At most `rate_hz` a second; 0: none."""
        self._period = round(1e9 / rate_hz) if rate_hz > 0.0 else 0
        self._interval = -1

    def due(self, stamp_ns: int) -> bool:
        """Whether the sample with this stamp passes."""
        if not self._period:
            return False
        interval = stamp_ns // self._period
        if interval == self._interval:
            return False
        self._interval = interval
        return True
