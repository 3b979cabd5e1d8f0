# SPDX-License-Identifier: BSD-3-Clause
"""MuJoCo: soft convex constraints."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ...core.base.types import Array
from ..sensors import cross


class MujocoEngine:
    """See Engine."""

    def __init__(self, model: mujoco.MjModel, feet: Sequence[Sequence[int]], soles: Sequence[int]) -> None:
        """See make_engine."""
        self._model, self._feet, self._soles = model, [list(bodies) for bodies in feet], soles
        self._root = model.body("base_link").id

    def reset(self, data: mujoco.MjData) -> None:
        """See Engine."""

    def step(self, data: mujoco.MjData) -> None:
        """See Engine."""
        mujoco.mj_step(self._model, data)

    def sampled_step(self, data: mujoco.MjData) -> None:
        """See Engine."""
        mujoco.mj_step(self._model, data)
        # Poses, velocities and forces in `data` are still those of the state before the step.
        mujoco.mj_rnePostConstraint(self._model, data)

    def ground_wrench(self, data: mujoco.MjData, foot: int) -> Array:
        """See Engine."""
        sole = self._soles[foot]
        wrench = data.cfrc_ext[self._feet[foot]].sum(axis=0)  # moment about the COM of the robot, then force
        lever = data.subtree_com[self._root] - data.site_xpos[sole]
        moment = wrench[:3] + cross(lever, wrench[3:])
        R = data.site_xmat[sole].reshape(3, 3)
        return np.concatenate([wrench[3:] @ R, moment @ R])
