# SPDX-License-Identifier: BSD-3-Clause
"""The pitch of the trunk ahead of time, by the deflections of the joints that a prediction holds for its horizons.

A horizon says where the COM will be and how far the joints will be deflected, not how the trunk will stand. The pitch
of the trunk less that of a rigid robot on the same motors follows from the deflections of the support leg: J d, with
the angular row of the leg's Jacobian. It is judged against measured less rigid pitch, by the leg that bears the robot
then.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from coman_reduced_model.core.base.types import Array, Foot, Prediction
from coman_reduced_model.core.robot.robot import Posture, Robot

PITCH = 4  # row of a leg's Jacobian


class PitchAhead:
    """RMS errors of the pitch at a horizon: as predicted, as now, and of a rigid robot."""

    def __init__(self, robot: Robot, horizon: float) -> None:
        self._legs = [len(robot.legs[foot]) for foot in (Foot.LEFT, Foot.RIGHT)]
        self._horizon = horizon
        self._pending: deque[tuple[int, dict[Foot, tuple[float, float]]]] = deque()
        self._off: list[tuple[float, float, float]] = []

    def add(self, prediction: Prediction, link: Posture, rigid: float) -> None:
        """Judge what is due, and take in what is predicted.

        Args:
            prediction: the next one.
            link: the measured posture.
            rigid: pitch of the trunk of a rigid robot now [rad].
        """
        foot, found = prediction.support.support_foot, {each.h: each for each in prediction.deflections}
        if foot == Foot.NONE or self._horizon not in found:
            self._pending.clear()
            return
        now = prediction.measured_tilt[1] - rigid
        while self._pending and self._pending[0][0] <= prediction.stamp_ns:
            ahead, before = self._pending.popleft()[1][foot]
            self._off.append((now - ahead, now - before, now))
        due = prediction.stamp_ns + round(self._horizon * 1e9)
        ahead_by, now_by = (self._pitches(found[h].joints, link) for h in (self._horizon, 0.0))
        self._pending.append((due, {each: (ahead_by[each], now_by[each]) for each in now_by}))

    def rms(self) -> Array:
        """(3,) [rad] as predicted, as now, rigid; NaN where nothing was judged."""
        known = [off for off in self._off if np.isfinite(off).all()]
        found: Array = np.sqrt(np.mean(np.square(known), axis=0)) if known else np.full(3, np.nan)
        return found

    def _pitches(self, joints: Array, link: Posture) -> dict[Foot, float]:
        left, right = np.split(joints, self._legs[:1])
        return {
            foot: float(link.leg_jacobian(foot)[PITCH] @ part)
            for foot, part in ((Foot.LEFT, left), (Foot.RIGHT, right))
        }
