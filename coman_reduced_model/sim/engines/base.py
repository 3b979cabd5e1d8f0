# SPDX-License-Identifier: BSD-3-Clause
"""What an engine does."""

from __future__ import annotations

from typing import Protocol

import mujoco

from ...core.base.types import Array


class Engine(Protocol):
    """Moves the robot whose state is in MuJoCo's data."""

    def reset(self, data: mujoco.MjData) -> None:
        """Begin with the state in `data`."""

    def step(self, data: mujoco.MjData) -> None:
        """One physics step with `data.ctrl`, `qfrc_applied` and `xfrc_applied`.

        Afterwards qpos and qvel are those after the step, and poses those before it.
        """

    def sampled_step(self, data: mujoco.MjData) -> None:
        """The same, with all that sensors read.

        Poses, velocities and accelerations of bodies and `actuator_force` are those of the state before the step.
        """

    def ground_wrench(self, data: mujoco.MjData, foot: int) -> Array:
        """After `sampled_step`: force and moment (6,) of the ground on a foot (0 left, 1 right), at its sole frame."""
