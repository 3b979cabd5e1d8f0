# SPDX-License-Identifier: BSD-3-Clause
"""Motors of the virtual robot that lead by what com/planned_deflection says, as its node does; without ROS."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from coman_reduced_model import load_config
from coman_reduced_model.core.base.types import JointMessage
from coman_reduced_model.core.feedforward.feedforward import Feedforward
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.streams.stream import Refused
from coman_reduced_model.ros.nodes.planned_lead import PlannedLead
from coman_reduced_model.ros.nodes.stream_motion import DELAY_NS, StreamMotion
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.motion import LegKinematics
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import VirtualRobot


def test_a_lead_that_comes_late_or_not_at_all():
    lead = PlannedLead(("a", "b"))
    links, own = np.array([1.0, 2.0]), np.array([1.1, 2.1])
    assert (lead.motors(0, 0.02, links, own) == own).all() and lead.share == 0.0
    for k in range(3):  # deflections that grow in a line; of a joint that the robot lacks as well
        lead.add(JointMessage(k * 10_000_000, ("b", "c"), np.array([0.1 * k, 0.5]), None, None))
    for _ in range(60):
        motors = lead.motors(15_000_000, 0.02, links, own)
    assert lead.share == 1.0 and motors == pytest.approx([1.0, 2.0 - 0.15])
    motors = lead.motors(100_000_000, 0.1, links, own)
    assert lead.share == pytest.approx(0.8) and motors[1] == pytest.approx(2.1 - 0.8 * 0.25)  # fades
    assert (lead.asked, lead.in_time) == (61, 60)
    lead.restart()
    assert (lead.motors(110_000_000, 0.1, links, own) == own).all()
    for names, values in ((("a",), [1.0, 2.0]), (("a",), [np.nan]), (("a",), [3.0])):
        with pytest.raises(Refused):
            lead.add(JointMessage(1, names, np.array(values), None, None))


def off_plan(lead: float, compensate: bool) -> float:
    """RMS of true COM minus plan in x [mm], against the support sole, in the steps of a live walk of test 1.

    Deflections come 30 ms late: the robot waits with its motors until they have to move.
    """
    plan = plan_walk(robot_gait(COMAN, "test1", steps=4))
    t = np.arange(0.0, plan.duration_s, 0.005)
    points = plan.references(t, [10**9 + round(1e9 * each) for each in t])
    planned = PlannedLead(COMAN.joint_names) if compensate else None
    motion = StreamMotion(LegKinematics(COMAN), points[0], 10**9, sag=lead, planned=planned)
    robot = VirtualRobot(COMAN, SensorOptions.exact(rate_hz=200.0))
    robot.reset(motion, motion.start)
    config = load_config()
    model = Robot(urdf(COMAN), config.robot)
    feedforward = Feedforward(model, config)
    first = dict(zip(COMAN.joint_names, motion.start.q[0], strict=True))
    feedforward.start(np.array([first[name] for name in model.joint_names]))
    errors, on_the_way = [], deque()
    for point in points:
        if planned is not None and (found := feedforward.update(point)) is not None:
            on_the_way.append(JointMessage(found.stamp_ns, model.config.leg_joints, found.deflection, None, None))
            if len(on_the_way) > 3:
                planned.add(on_the_way.popleft())
        motion.add(point)
        if point.stamp_ns < 10**9 + DELAY_NS:
            continue
        robot.step()
        truth, now = robot.truth, plan.sample(robot.truth.t)
        if 1.0 < truth.t < plan.duration_s - 1.1:
            left = truth.left_wrench[2] >= truth.right_wrench[2]
            there, wanted = (truth.T_left, now.T_odom_left) if left else (truth.T_right, now.T_odom_right)
            errors.append(truth.com[0] - there[0, 3] - now.com[0] + wanted[0, 3])
    assert not robot.fallen
    return 1e3 * float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.slow
def test_the_virtual_robot_follows_its_plan_live():
    assert off_plan(0.5, True) < 0.5
    assert off_plan(0.8, False) > 1.0
