# SPDX-License-Identifier: BSD-3-Clause
"""How far the measured COM is from its plan, both in the support sole."""

from __future__ import annotations

from collections import deque

import numpy as np

from ...core.base.types import Array, Prediction, Reference
from ...core.model.reference import planned_com
from ..nodes.stream_motion import at_rest


class Tracking:
    """Pairs predictions with the points of the plan at their stamps, and keeps the errors."""

    def __init__(self) -> None:
        self._plan: deque[Reference] = deque(maxlen=400)
        self._squares: deque[Array] = deque(maxlen=200_000)

    def add_plan(self, reference: Reference) -> None:
        """The next point of the plan, which comes before the robot is there."""
        self._plan.append(reference)

    def add(self, prediction: Prediction) -> None:
        """Take a prediction in, if the plan at its stamp is known and moves."""
        plan, stamp = self._plan, prediction.stamp_ns
        while len(plan) > 2 and plan[1].stamp_ns <= stamp:
            plan.popleft()
        if len(plan) < 2 or not plan[0].stamp_ns <= stamp <= plan[1].stamp_ns or at_rest(plan[0]):
            return
        share = (stamp - plan[0].stamp_ns) / (plan[1].stamp_ns - plan[0].stamp_ns)
        foot = prediction.support.support_foot
        before, after = (planned_com(each, foot)[0] for each in (plan[0], plan[1]))
        square = np.square(prediction.measured_com - (1.0 - share) * before - share * after)
        if np.isfinite(square).all():
            self._squares.append(square)

    def rms_mm(self) -> Array:
        """RMS (3,) while the plan has moved [mm]; NaN: not known."""
        if not self._squares:
            return np.full(3, np.nan)
        return np.asarray(1e3 * np.sqrt(np.mean(np.array(self._squares), axis=0)))
