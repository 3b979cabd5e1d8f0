# SPDX-License-Identifier: BSD-3-Clause
"""MuJoCo: soft convex constraints."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ...errors import EngineError
from ..physics import Body, Drive, Sampled, mujoco_steps

_BAD = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class MujocoEngine:
    """See Engine."""

    def __init__(self, data: mujoco.MjData, feet: Sequence[Sequence[int]]) -> None:
        """See make_engine."""
        self._warnings = [data.warning[each] for each in _BAD]
        self._feet = np.full((2, max(map(len, feet))), -1)
        for row, bodies in zip(self._feet, feet, strict=True):
            row[: len(bodies)] = bodies

    def reset(self, data: mujoco.MjData) -> None:
        """See Engine."""

    def steps(self, first: int, last: int, t: float, body: Body, drive: Drive, sampled: Sampled, forced: bool) -> None:
        """See Engine.

        Raises:
            EngineError: the simulation diverged; MuJoCo would go on from where the robot began.
        """
        mujoco_steps(first, last, t, body, drive, sampled, self._feet, forced)
        if any(each.number for each in self._warnings):
            raise EngineError(f"engine: mujoco cannot go on: the simulation diverged at {t:.2f} s")
