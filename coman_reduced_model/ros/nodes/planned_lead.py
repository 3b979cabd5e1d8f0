# SPDX-License-Identifier: BSD-3-Clause
"""A lead of the motors that is taken from com/planned_deflection, as a controller would use it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from ...core.base.types import Array, JointMessage
from ...core.streams.stream import Refused

_FADE_S = 0.5  # [s] in which the motors go over from their own lead, and back
_MOST = 0.7  # [rad]


class PlannedLead:
    """Deflections by stamp, and motor positions that lead by them.

    They may come as early as they like; each is kept until its stamp.

    Attributes:
        share: of that lead in the motor positions now, 0 to 1.
        asked, in_time: motor positions since the first whose deflection was known, and those for which it was.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        """`joints` are the names of the robot's joints, in its order."""
        self._index = {name: i for i, name in enumerate(joints)}
        self._known: deque[tuple[int, Array]] = deque(maxlen=1024)
        self._lead = np.zeros(len(joints))
        self.share = 0.0
        self.asked = self.in_time = 0

    def restart(self) -> None:
        """The robot is put somewhere and leads by its own lead: go over to this one as in the beginning."""
        self.share = 0.0

    def add(self, message: JointMessage) -> None:
        """Take what the predictor says; joints that the robot lacks are left out.

        Raises:
            Refused: names and positions do not fit together, or a position is no deflection.
        """
        if len(message.names) != len(message.position):
            raise Refused("length", f"{len(message.names)} names, {len(message.position)} deflections")
        if not np.abs(message.position).max(initial=0.0) < _MOST:
            raise Refused("limit", f"a deflection is not below {_MOST:g} rad")
        if self._known and message.stamp_ns <= self._known[-1][0]:
            self._known.clear()  # a plan that began again
        deflection = np.zeros(len(self._index))
        for name, value in zip(message.names, message.position, strict=True):
            if name in self._index:
                deflection[self._index[name]] = value
        self._known.append((message.stamp_ns, deflection))

    def motors(self, stamp_ns: int, dt: float, links: Array, own: Array) -> Array:
        """Motor positions (nj,) [rad].

        Args:
            stamp_ns: when they act.
            dt: [s] since the last ones.
            links: (nj,) planned joints.
            own: (nj,) the robot's own motor positions for them, where no deflection is known.
        """
        deflection = self._at(stamp_ns)
        if deflection is not None:
            self.in_time += 1
            self._lead = links - deflection - own
        self.asked += self.in_time > 0
        change = dt / _FADE_S if deflection is not None else -dt / _FADE_S
        self.share = min(1.0, max(0.0, self.share + change))
        return own + self.share * self._lead

    def _at(self, stamp_ns: int) -> Array | None:
        known = self._known
        while len(known) > 2 and known[1][0] <= stamp_ns:
            known.popleft()
        if len(known) < 2 or not known[0][0] <= stamp_ns <= known[1][0]:
            return None
        (t0, d0), (t1, d1) = known[0], known[1]
        return d0 + (stamp_ns - t0) / (t1 - t0) * (d1 - d0)
