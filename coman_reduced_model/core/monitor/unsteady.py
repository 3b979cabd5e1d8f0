# SPDX-License-Identifier: BSD-3-Clause
"""Tells of pushes that come and go: the force that core/monitor/forces.py finds missing scatters more than it did.

Looked at are the differences from one window to the next, by their median: a pull that begins or a foot that
knocks against something is one difference, a push that comes and goes is in all of them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ..base.types import Array
from .forces import WINDOW_NS, about_vertical

EVERY_NS = 200_000_000  # from one window to the next
_NOW, _BEFORE, _USUAL = 10, 15, 100  # differences that are held against those before, against the last of these
_FEWEST = 10  # differences that tell what is usual
_LEAST = 0.003  # of the weight: median difference that is usual at least
_WILD, _BACK = 1.1, 0.75  # of the threshold: beyond that, a scatter is told of; below that, it is over


@dataclass(frozen=True)
class Scatter:
    """Forces along an axis that come and go.

    Attributes:
        axis: 0 or 1, x or y.
        size: standard deviation [N].
        sigma: how many times as much as before.
        since: [s].
    """

    axis: int
    size: float
    sigma: float
    since: float


class Unsteady:
    """Watches one robot of a weight [N].

    Attributes:
        told: what there is to tell.
        seen: when it was seen last [s].
    """

    def __init__(self, weight: float, threshold: float) -> None:
        self._least, self._threshold = _LEAST * weight, threshold
        self.reset()

    def reset(self) -> None:
        """The robot stands: what was tells nothing of what will be."""
        self._last: tuple[Array, float] | None = None
        self._now: deque[tuple[float, Array, Array]] = deque()  # when [s], force and difference (2,) [N]
        self._before: deque[Array] = deque(maxlen=_USUAL)
        self.told: list[Scatter] = []
        self.seen = 0.0

    def take(self, when: float, force: Array, heading: float = 0.0) -> None:
        """The force (3,) [N] over a window that ends now [s], in axes that are turned by -heading [rad]."""
        last, self._last = self._last, (force, heading)
        if last is None or np.isnan(force + last[0]).any():
            return
        self.seen = when
        difference = force - about_vertical(last[0], heading - last[1])
        self._now.append((when, force[:2], np.abs(difference[:2])))
        if len(self._now) <= _NOW:
            return
        *_, oldest = self._now.popleft()
        if not self.told:
            self._before.append(oldest)
        if len(self._before) < _FEWEST:
            return
        before, now = np.array(self._before), np.array([each for *_, each in self._now])
        usual = np.maximum(np.median(before, axis=0), np.median(before[-_BEFORE:], axis=0)).clip(self._least)
        median, known = np.median(now, axis=0), {each.axis: each for each in self.told}
        size = np.std([force for _, force, _ in self._now], axis=0)
        self.told = []
        for axis in range(2):
            sigma = float(median[axis] / usual[axis])
            if sigma > self._threshold * (_BACK if axis in known else _WILD):
                first = next(at for at, _, each in self._now if each[axis] > 0.5 * median[axis])
                since = known[axis].since if axis in known else first - 1e-9 * WINDOW_NS
                self.told.append(Scatter(axis, float(size[axis]), sigma, float(since)))
