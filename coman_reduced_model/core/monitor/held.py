# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor that repeats a value under load, while joints and the other sensor move on: a driver that hangs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..base.input_warning import InputWarning, WarningKind
from ..base.stream_names import WRENCHES
from ..base.types import Array, Foot

_HELD_S = 0.06  # [s] from which a value is held
_MOVES = 0.001  # [rad] of a joint meanwhile: coarse sensors of a robot that stands still read the same
_TIMES = 3  # from which it is reported
_LONG_S = 0.5  # [s] from which once is enough


class _First(NamedTuple):
    """The first look at the value that a foot sensor gives now."""

    stamp_ns: int
    wrench: Array
    other: Array  # wrench of the other foot
    q: Array  # [rad]


class HeldValues:
    """How long each foot sensor gives the same six values."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.times = dict.fromkeys(WRENCHES, 0)
        self.longest = dict.fromkeys(WRENCHES, 0.0)  # [s]
        self._first: dict[Foot, _First] = {}  # by foot that bears load
        self._counted = dict.fromkeys(WRENCHES, False)  # whether `times` counts that value

    def update(self, stamp_ns: int, q: Array, wrenches: Mapping[Foot, Array], loaded: Mapping[Foot, bool]) -> None:
        """Take a look: joints (nj,) [rad], wrenches (6,) as they were read, and which feet bear load for certain."""
        for foot, wrench in wrenches.items():
            if not loaded[foot]:
                self._first.pop(foot, None)
                continue
            first, other = self._first.get(foot), wrenches[foot.other]
            if first is None or not np.array_equal(wrench, first.wrench):
                self._first[foot] = _First(stamp_ns, wrench.copy(), other.copy(), q.copy())
                self._counted[foot] = False
                continue
            seconds = (stamp_ns - first.stamp_ns) * 1e-9
            if seconds < _HELD_S or np.abs(q - first.q).max() < _MOVES or np.array_equal(other, first.other):
                continue
            self.times[foot] += not self._counted[foot]
            self._counted[foot] = True
            self.longest[foot] = max(self.longest[foot], seconds)

    def warnings(self) -> list[InputWarning]:
        """Present warnings."""
        found = []
        for foot, name in WRENCHES.items():
            times, longest = self.times[foot], self.longest[foot]
            if times >= _TIMES or longest >= _LONG_S:
                text = (
                    f"{name}: gave the same value for up to {longest:.2f} s while the robot moved on, {times} "
                    f"time{'s' if times > 1 else ''}: does its driver hang?"
                )
                found.append(InputWarning(WarningKind.HELD, name, text))
        return found
