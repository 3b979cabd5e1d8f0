# SPDX-License-Identifier: BSD-3-Clause
"""Detects intermittent external forces: the residual force (monitor/forces.py) scatters more than before.

The scatter is the median magnitude of the differences between successive windows: a pull that begins, or a foot that
hits an obstacle, gives one large difference; an intermittent force enters all of them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np

from ..base.types import Array
from .forces import WINDOW_NS, about_vertical

INTERVAL_NS = 200_000_000  # from one window to the next
_RECENT, _EARLIER, _LONG = 10, 15, 100  # differences: tested, just before those, and long before
_MIN_DIFFERENCES = 10  # from which the earlier scatter is known
_ONSET, _RELEASE = 1.1, 0.75  # of the threshold: ratio at which a force is detected, and at which it is over


@dataclass(frozen=True)
class IntermittentForce:
    """An intermittent force along one axis.

    Attributes:
        axis: 0 or 1, x or y.
        size: standard deviation [N].
        ratio: scatter relative to the one before.
        onset: [s].
    """

    axis: int
    size: float
    ratio: float
    onset: float


class IntermittentForces:
    """Watches one robot.

    Attributes:
        least: (2,) lower bounds of the earlier scatter of x and y [N]: what such a residual usually scatters by.
        threshold: `monitor.threshold`; may be exchanged at any time.
        forces: present ones.
        last: time of the last window with a known difference [s].
    """

    def __init__(self, least: Array, threshold: float) -> None:
        self.least, self.threshold = least, threshold
        self.reset()

    def reset(self) -> None:
        """Forget the past, as when the robot stands: standing says nothing about walking."""
        self._previous: tuple[Array, float] | None = None  # force and heading
        self._recent: deque[tuple[float, Array, Array]] = deque()  # time [s], force and difference (2,) [N]
        self._earlier: deque[Array] = deque(maxlen=_LONG)
        self.forces: list[IntermittentForce] = []
        self.last = 0.0

    def update(self, time: float, force: Array, heading: float = 0.0) -> None:
        """Take the force (3,) [N] over a window that ends at a time [s], in axes that are turned by -heading [rad]."""
        previous, self._previous = self._previous, (force, heading)
        if previous is None or np.isnan(force + previous[0]).any():
            return
        self.last = time
        difference = force - about_vertical(previous[0], heading - previous[1])
        self._recent.append((time, force[:2], np.abs(difference[:2])))
        if len(self._recent) <= _RECENT:
            return
        *_, oldest = self._recent.popleft()
        if not self.forces:
            self._earlier.append(oldest)
        if len(self._earlier) >= _MIN_DIFFERENCES:
            self._test()

    def _test(self) -> None:
        """Compare the recent scatter with the earlier one."""
        size = np.std([force for _, force, _ in self._recent], axis=0)
        known = {each.axis: each for each in self.forces}
        self.forces = []
        for axis in range(2):
            earlier = [float(each[axis]) for each in self._earlier]
            scatter = median([float(each[axis]) for *_, each in self._recent])
            ratio = scatter / max(median(earlier), median(earlier[-_EARLIER:]), self.least[axis])
            if ratio <= self.threshold * (_RELEASE if axis in known else _ONSET):
                continue
            if axis in known:
                onset = known[axis].onset
            else:
                first = next(time for time, _, each in self._recent if each[axis] > 0.5 * scatter)
                onset = float(first - 1e-9 * WINDOW_NS)
            self.forces.append(IntermittentForce(axis, float(size[axis]), ratio, onset))
