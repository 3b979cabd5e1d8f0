# SPDX-License-Identifier: BSD-3-Clause
"""Velocities from positions and stamps, where a driver does not give them."""

from __future__ import annotations

import numpy as np

from .types import Array


class Differentiator:
    """Causal derivative: slope of the least-squares line through the last `window` seconds of positions.

    On a straight line it is exact; else it is the velocity half a window ago (a delay of window / 2), with the
    quantisation of an encoder of step s and n samples in the window reduced to about s sqrt(n) / window / n * 3.5.
    Stamps, not a nominal period, are what it divides by, so that jitter and dropped messages do not show.
    The cost of one update does not depend on how long it has run.
    """

    def __init__(self, window_s: float, gap_s: float, size: int) -> None:
        """For positions of `size` joints; a gap longer than `gap_s`, or stamps that go back, start afresh."""
        self._window = round(window_s * 1e9)
        self._gap = round(gap_s * 1e9)
        self._t = np.zeros(64, dtype=np.int64)
        self._q = np.zeros((64, size))
        self._start = self._end = 0

    def update(self, stamp_ns: int, q: Array) -> Array | None:
        """Velocity at a new position (n,) [rad]; None until there are two."""
        if self._end and not 0 < stamp_ns - self._t[self._end - 1] <= self._gap:
            self._start = self._end = 0
        if self._end == len(self._t):
            self._make_room()
        self._t[self._end] = stamp_ns
        self._q[self._end] = q
        self._end += 1
        # Two points always remain: at a rate so low that the window holds one, the last difference is the best one.
        while self._end - self._start > 2 and stamp_ns - self._t[self._start] > self._window:
            self._start += 1
        count = self._end - self._start
        if count < 2:
            return None
        t = (self._t[self._start : self._end] - stamp_ns) * 1e-9
        t -= t.sum() / count
        positions = self._q[self._start : self._end]
        # t sums to zero, so that any constant may be taken off; the last position keeps the products small.
        velocity: Array = t @ (positions - q) / (t @ t)
        return velocity

    def _make_room(self) -> None:
        """Move the window to the front; double the room if it fills more than half of it."""
        count = self._end - self._start
        size = len(self._t) * (2 if 2 * count > len(self._t) else 1)
        t, q = np.zeros(size, dtype=np.int64), np.zeros((size, self._q.shape[1]))
        t[:count], q[:count] = self._t[self._start : self._end], self._q[self._start : self._end]
        self._t, self._q, self._start, self._end = t, q, 0, count
