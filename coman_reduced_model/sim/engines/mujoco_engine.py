# SPDX-License-Identifier: BSD-3-Clause
"""MuJoCo: soft convex constraints."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ..physics import Body, Drive, Sampled, mujoco_steps


class MujocoEngine:
    """See Engine."""

    def __init__(self, feet: Sequence[Sequence[int]]) -> None:
        """See make_engine."""
        self._feet = np.full((2, max(map(len, feet))), -1)
        for row, bodies in zip(self._feet, feet, strict=True):
            row[: len(bodies)] = bodies

    def reset(self, data: mujoco.MjData) -> None:
        """See Engine."""

    def steps(self, first: int, last: int, t: float, body: Body, drive: Drive, sampled: Sampled, forced: bool) -> None:
        """See Engine."""
        mujoco_steps(first, last, t, body, drive, sampled, self._feet, forced)
