# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor that repeats a value under load, while joints and the other sensor move on: a driver that hangs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..base.input_warning import InputWarning, WarningKind
from ..base.stream_names import WRENCHES
from ..base.types import Array, Foot

_HELD_S = 0.06  # [s] from which a value is held
_MOVES = 0.001  # [rad] of a joint meanwhile: coarse sensors of a robot that stands still read the same
_TIMES = 3  # from which it is reported
_LONG_S = 0.5  # [s] from which once is enough


class HeldValues:
    """How long each foot sensor gives the same six values."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.times = dict.fromkeys(WRENCHES, 0)
        self.longest = dict.fromkeys(WRENCHES, 0.0)  # [s]
        # By foot since when: stamp [ns], its wrench and that of the other foot, joints [rad].
        self._since: dict[Foot, tuple[int, Array, Array, Array]] = {}
        self._counted = dict.fromkeys(WRENCHES, False)  # the value that is held now

    def update(self, stamp_ns: int, q: Array, wrenches: Mapping[Foot, Array], loaded: Mapping[Foot, bool]) -> None:
        """Take a look: joints (nj,) [rad], wrenches (6,) as they were read, and which feet bear load for certain."""
        for foot, wrench in wrenches.items():
            if not loaded[foot]:
                self._since.pop(foot, None)
                continue
            other = wrenches[foot.other]
            if foot not in self._since or not np.array_equal(self._since[foot][1], wrench):
                self._since[foot] = stamp_ns, wrench.copy(), other.copy(), q.copy()
                self._counted[foot] = False
                continue
            since, _, before, joints = self._since[foot]
            seconds = (stamp_ns - since) * 1e-9
            if seconds < _HELD_S or np.abs(q - joints).max() < _MOVES or np.array_equal(other, before):
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
