# SPDX-License-Identifier: BSD-3-Clause
"""Compile the physics of the virtual robot, once, at set-up: the first recording would wait for it."""

from __future__ import annotations

from ..core.gait.gait import plan_walk
from .motion import plan_motion
from .record import robot_gait
from .robot_table import COMAN
from .virtual_robot import VirtualRobot

if __name__ == "__main__":
    robot = VirtualRobot(COMAN)
    robot.reset(plan_motion(COMAN, plan_walk(robot_gait(COMAN, "stand", 2.0)), passes=0)[0], settle_s=0.01)
    robot.step()
