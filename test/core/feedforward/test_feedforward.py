# SPDX-License-Identifier: BSD-3-Clause
"""Planned deflections: against the plan of the virtual robot, in the loop of its walk, and with plans that are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model import load_config
from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.feedforward.feedforward import Feedforward
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.motion import MotorMotion, plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import VirtualRobot

CONFIG = load_config()
ROBOT = Robot(urdf(COMAN), CONFIG.robot)
ORDER = [COMAN.joint_names.index(name) for name in ROBOT.config.leg_joints]
START_NS = 5_000_000_000


def feedforward(links: MotorMotion, changes=None) -> Feedforward:
    made = Feedforward(ROBOT, CONFIG.replaced(changes or {}))
    first = dict(zip(COMAN.joint_names, links(np.zeros(1))[0][0], strict=True))
    made.start(np.array([first[name] for name in ROBOT.joint_names]))
    return made


def planned(gait: str, steps: int, changes=None):
    """Times, deflections (n, 12) in the order of the table, the motion of the links, and its plan."""
    links, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, gait, steps=steps)), 0.0)
    t = np.arange(-0.02, plan.duration_s + 0.02, 0.01)
    made = feedforward(links, changes)
    points = plan.references(t, [START_NS + round(1e9 * each) for each in t])
    found = [each for point in points if (each := made.update(point)) is not None]
    deflection = np.zeros((len(found), 12))
    deflection[:, ORDER] = [each.deflection for each in found]
    return np.array([each.stamp_ns - START_NS for each in found]) * 1e-9, deflection, links, plan


def tracking(motion: MotorMotion, plan) -> np.ndarray:
    """RMS (3,) of true COM minus plan [mm], both against the support sole, while the plan walks."""
    robot = VirtualRobot(COMAN, SensorOptions.exact(rate_hz=200.0))
    robot.reset(motion)
    errors = []
    while robot.t < plan.duration_s:
        robot.step()
        assert not robot.fallen
        truth, point = robot.truth, plan.sample(robot.truth.t)
        if 1.0 < truth.t < plan.duration_s - 1.0:
            left = truth.left_wrench[2] >= truth.right_wrench[2]
            there, wanted = (truth.T_left, point.T_odom_left) if left else (truth.T_right, point.T_odom_right)
            errors.append(truth.com - there[:3, 3] - point.com + wanted[:3, 3])
    return 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))


def test_deflections_are_those_of_the_planned_torques():
    """Without damping they are what the virtual robot's own plan makes of its springs."""
    undamped = {f"robot.{side}.damping": [0.0] * 6 for side in ("left", "right")}
    t, deflection, links, plan = planned("test1", 2, undamped)
    with_all, _ = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=2)), 1.0)
    own = links(t)[0] - with_all(t)[0]
    walking = (t > 0.1) & (t < plan.duration_s - 0.1)
    # Where the swing foot leaves or lands, accelerations jump, and splines of 5 and differences over 10 ms differ.
    assert np.percentile(np.abs(deflection - own)[walking], 90) < 2e-4
    assert np.abs(own).max() > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("gait", ["test1", "test2"])
def test_the_com_follows_its_plan(gait):
    """Motors that lead by it halve the error of a lowered own lead by far, and that of the usual one."""
    t, deflection, links, plan = planned(gait, 4)
    compensated = tracking(MotorMotion(t, links(t)[0] - deflection, links.start), plan)
    lowered, usual = (
        tracking(plan_motion(COMAN, plan_walk(robot_gait(COMAN, gait, steps=4)), lead)[0], plan) for lead in (0.5, 0.8)
    )
    assert (compensated < 0.5 * lowered).all() and (compensated < usual).all()
    assert compensated.max() < 0.6


def test_plans_that_are_none_give_nothing_and_do_no_harm():
    links, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=2)), 0.0)
    made = feedforward(links)
    t = np.arange(0.0, 1.0, 0.01)
    points = plan.references(t, [START_NS + round(1e9 * each) for each in t])
    assert [made.update(point) is None for point in points[:3]] == [True, True, False]
    high = points[3].com + np.array([0.0, 0.0, 0.4])
    spoilt = [
        replace(points[3], com=np.full(3, np.nan)),
        replace(points[4], com=high),
        replace(points[5], phase=Phase.FLIGHT),
        replace(points[6], T_odom_left=np.full((4, 4), np.inf)),
    ]
    assert all(made.update(point) is None for point in spoilt)
    after = [made.update(point) for point in points[10:13]]  # it begins again
    assert after[:2] == [None, None] and np.isfinite(after[2].deflection).all()
    assert made.update(points[12]) is None  # twice the same
    assert made.update(points[40]) is None  # a gap
    load = ROBOT.mass * 9.81 / 2.0  # standing: both feet carry half, and the knees most
    assert abs(after[2].torque[3]) < 0.3 * load and after[2].torque.shape == (12,)


def test_a_plan_far_from_the_last_one_is_solved():
    """After a long walk, odom begins again."""
    links, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=2)), 0.0)
    usual, made = feedforward(links), feedforward(links)
    t = np.arange(0.0, 0.3, 0.01)
    points = plan.references(t, [START_NS + round(1e9 * each) for each in t])

    def moved(point, x):
        left, right = point.T_odom_left.copy(), point.T_odom_right.copy()
        left[0, 3] += x
        right[0, 3] += x
        return replace(point, com=point.com + [x, 0.0, 0.0], T_odom_left=left, T_odom_right=right)

    for x in (0.0, 12.0, 0.0, -40.0):
        wanted, found = (
            [made_.update(each) for each in given]
            for made_, given in ((usual, points), (made, [moved(each, x) for each in points]))
        )
        np.testing.assert_allclose(found[-1].deflection, wanted[-1].deflection, atol=1e-6)


def test_the_trunk_may_point_anywhere():
    """As the root link of an iCub, whose x points back."""
    back = '<link name="back"/><joint name="b" type="fixed"><parent link="base_link"/><child link="back"/>' + (
        '<origin xyz="0 0 0" rpy="0 0 3.14159265358979"/></joint>'
    )
    text = urdf(COMAN).replace("</robot>", f"{back}</robot>")
    config = CONFIG.replaced({"robot.base_frame": "back"})
    links, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=2)), 0.0)
    first = dict(zip(COMAN.joint_names, links(np.zeros(1))[0][0], strict=True))
    t = np.arange(0.0, 0.1, 0.01)
    points, found = plan.references(t, [START_NS + round(1e9 * each) for each in t]), []
    for robot, settings in ((ROBOT, CONFIG), (Robot(text, config.robot), config)):
        made = Feedforward(robot, settings)
        made.start(np.array([first[name] for name in robot.joint_names]))
        found.append([made.update(point) for point in points][-1].deflection)
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


@pytest.mark.parametrize("moved", [0.002, 0.03])
def test_a_plan_that_jumps_gives_nothing_until_it_goes_on(moved):
    """One point that is off, or a plan made anew: second differences would ask for torques no robot has."""
    links, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=2)), 0.0)
    t = np.arange(0.0, 2.0, 0.01)
    points = plan.references(t, [START_NS + round(1e9 * each) for each in t])
    usual, made = feedforward(links), feedforward(links)
    most = max(abs(found.torque).max() for point in points if (found := usual.update(point)) is not None)
    points[60:63] = [replace(point, com=point.com + [moved, 0.0, 0.0]) for point in points[60:63]]
    points[120:] = [replace(point, com=point.com + [moved, 0.0, 0.0]) for point in points[120:]]
    found = [made.update(point) for point in points]
    assert max(abs(each.torque).max() for each in found if each is not None) < 1.5 * most
    assert sum(each is None for each in found) < 15


def test_a_leg_in_the_air_hangs():
    """Its knee carries shank and foot, no more."""
    links, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=2)), 0.0)
    made = feedforward(links)
    t = np.arange(0.0, plan.duration_s, 0.01)
    points = plan.references(t, [START_NS + round(1e9 * each) for each in t])
    knees = [(point.phase, found.torque[[3, 9]]) for point in points if (found := made.update(point)) is not None]
    for phase, stance, swing in ((Phase.LEFT, 0, 1), (Phase.RIGHT, 1, 0)):
        on_one = np.abs([torque for each, torque in knees if each == phase])
        assert np.median(on_one[:, stance]) > 5.0 * np.median(on_one[:, swing])
