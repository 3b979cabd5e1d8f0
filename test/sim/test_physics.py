# SPDX-License-Identifier: BSD-3-Clause
"""Compiled physics steps: a whole period at once, or step by step as outside forces need it."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.motors import MotorOptions
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.virtual_robot import VirtualRobot


@pytest.mark.parametrize("motors", [None, MotorOptions()])
def test_single_steps_are_those_of_a_whole_period(walking, motors):
    rows = []
    for nothing in ((), ("external_force:x=0,y=0",)):
        hidden = [parse(text) for text in ("imperfections:seed=1", "hysteresis:width=0.01", *nothing)]
        robot = VirtualRobot(COMAN, disturbances=hidden, motors=motors, seed=3)
        robot.reset(walking, settle_s=0.5)
        readings = robot.advance(0.4)[-1]
        imu, wrench = readings.imu, readings.right_wrench
        rows.append([*robot.truth.q, *robot.truth.tau, *robot.truth.com_vel, *robot.truth.left_wrench, *wrench.force])
        rows[-1] += [*imu.orientation, *imu.linear_acceleration, *readings.joint_states.velocity]
    assert np.array_equal(*rows)
    assert np.ptp(rows[0]) > 1.0
