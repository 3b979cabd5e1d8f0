# SPDX-License-Identifier: BSD-3-Clause
"""Velocities from positions and stamps, where a driver does not give them."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..base.types import Array


class Differentiator:
    """Causal derivative: slope of the least-squares line through the last `window` seconds of positions.

    On a straight line it is exact; else it is the velocity half a window ago (a delay of window / 2). White noise of
    standard deviation s on n positions in the window comes out as s sqrt(12 / n) / window.
    Stamps, not a nominal period, are what it divides by, so that jitter and dropped messages do not show.
    The cost of one update does not depend on how long it has run.
    """

    def __init__(self, window_s: float, gap_s: float, size: int) -> None:
        """For positions of `size` joints; a gap longer than `gap_s`, or stamps that go back, start afresh."""
        self._window = round(window_s * 1e9)
        self._gap = round(gap_s * 1e9)
        self._stamps: deque[int] = deque()  # of the window [ns]
        self._t = np.zeros(64)  # [s] since the first stamp; the window ends at _end
        self._q = np.zeros((64, size))
        self._end = 0
        self._origin = 0

    def update(self, stamp_ns: int, q: Array) -> Array | None:
        """Velocity at a new position (n,) [rad]; None until there are two."""
        stamps = self._stamps
        if stamps and not 0 < stamp_ns - stamps[-1] <= self._gap:
            stamps.clear()
        if not stamps:
            self._end, self._origin = 0, stamp_ns
        elif self._end == len(self._t):
            self._make_room()
        stamps.append(stamp_ns)
        end = self._end = self._end + 1
        self._t[end - 1] = (stamp_ns - self._origin) * 1e-9
        self._q[end - 1] = q
        # Two points always remain: at a rate so low that the window holds one, the last difference is the best one.
        while len(stamps) > 2 and stamp_ns - stamps[0] > self._window:
            stamps.popleft()
        count = len(stamps)
        if count < 2:
            return None
        t = self._t[end - count : end] - self._t[end - 1]
        t -= np.add.reduce(t) / count
        velocity: Array = t.dot(self._q[end - count : end]) / t.dot(t)
        return velocity

    def _make_room(self) -> None:
        """Move the window to the front; double the room if it fills more than half of it."""
        count = len(self._stamps)
        size = len(self._t) * (2 if 2 * count > len(self._t) else 1)
        t, q = np.zeros(size), np.zeros((size, self._q.shape[1]))
        t[:count], q[:count] = self._t[self._end - count : self._end], self._q[self._end - count : self._end]
        self._t, self._q, self._end = t, q, count
