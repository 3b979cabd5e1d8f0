# SPDX-License-Identifier: BSD-3-Clause
"""What an engine does."""

from __future__ import annotations

from typing import Protocol

import mujoco

from ..physics import Body, Drive, Sampled


class Engine(Protocol):
    """Moves the robot whose state is in MuJoCo's data."""

    def reset(self, data: mujoco.MjData) -> None:
        """Begin with the state in `data`."""

    def steps(self, first: int, last: int, t: float, body: Body, drive: Drive, sampled: Sampled, forced: bool) -> None:
        """Steps first to last - 1 of a period whose step 0 is at time t [s].

        Before each: physics.begin_step; forced as there. After one that it samples: physics.end_step, with poses and
        forces of the state before the step in MuJoCo's data, and `ground` and `about` filled. Afterwards qpos and qvel
        are those after the step, and poses those before it.
        """
