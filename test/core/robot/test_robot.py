# SPDX-License-Identifier: BSD-3-Clause
"""Kinematics against forward kinematics of our own and finite differences; URDFs that cannot be used."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import NAMES, bent, config_of, forward, robot_of, urdf_of
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.configuration import RobotConfig
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.errors import RobotError

FEET = (Foot.LEFT, Foot.RIGHT)
seeds = st.integers(0, 2**32 - 1)


def random_posture(robot, seed, size=0.7):
    rng = np.random.default_rng(seed)
    n = len(robot.joint_names)
    posture, q, qd = robot.posture(), rng.uniform(-size, size, n), rng.uniform(-2.0, 2.0, n)
    posture.update(q, qd)
    return posture, q, qd


def oracle(name, q, foot):
    """COM in the sole and the pose of the other sole in it, by our own forward kinematics."""
    robot = robot_of(name)
    poses, mass, com = forward(urdf_of(name), dict(zip(robot.joint_names, q, strict=True)))
    legs = config_of(name).robot
    soles = {Foot.LEFT: poses[legs.left.sole_frame], Foot.RIGHT: poses[legs.right.sole_frame]}
    T = np.linalg.inv(soles[foot])
    return mass, T[:3, :3] @ com + T[:3, 3], T @ soles[foot.other]


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=15)
@given(seed=seeds)
def test_com_and_soles_agree_with_kinematics_of_our_own(name, seed):
    """Masses of all links count, that of the root link too: a fixed base would lose it."""
    robot = robot_of(name)
    posture, q, _ = random_posture(robot, seed)
    for foot in FEET:
        mass, com, T_other = oracle(name, q, foot)
        assert robot.mass == pytest.approx(mass, rel=1e-12)
        np.testing.assert_allclose(posture.com_in_sole(foot)[0], com, atol=1e-8)  # 1 nm: rounded rpy of meshes
        R, p = posture.sole_to_sole(foot, foot.other)
        np.testing.assert_allclose(R, T_other[:3, :3], atol=1e-8)
        np.testing.assert_allclose(p, T_other[:3, 3], atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=15)
@given(seed=seeds)
def test_velocity_is_the_derivative_of_the_position(name, seed):
    robot = robot_of(name)
    posture, q, qd = random_posture(robot, seed)
    dt = 1e-6
    velocities = [posture.com_in_sole(foot)[1] for foot in FEET]
    ends = []
    for t in (-dt, dt):
        posture.update(q + qd * t, qd)
        ends.append([posture.com_in_sole(foot)[0] for foot in FEET])
    np.testing.assert_allclose(velocities, (np.array(ends[1]) - ends[0]) / (2 * dt), atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=15)
@given(seed=seeds, foot=st.sampled_from(FEET))
def test_leg_jacobian_is_the_derivative_of_the_trunk_fixed_frame_at_the_com(name, seed, foot):
    robot = robot_of(name)
    posture, q, qd = random_posture(robot, seed)
    J, com = posture.leg_jacobian(foot).copy(), posture.com.copy()
    eps = 1e-6
    for column, joint in enumerate(robot.legs[foot]):
        poses = []
        for sign in (-1, 1):
            moved = q.copy()
            moved[joint] += sign * eps
            posture.update(moved, qd)
            R = posture.R[foot].T.copy()  # of the trunk in the sole
            poses.append((R, R @ (com - posture.p[foot])))
        (R0, p0), (R1, p1) = poses
        np.testing.assert_allclose(J[:3, column], (p1 - p0) / (2 * eps), atol=1e-7)
        np.testing.assert_allclose(J[3:, column], Rotation.from_matrix(R1 @ R0.T).as_rotvec() / (2 * eps), atol=1e-7)


def test_a_posture_is_refreshed_as_a_whole():
    """What is read twice may be cached, but never beyond the next update."""
    robot = robot_of("coman")
    posture = robot.posture()
    still = np.zeros(len(robot.joint_names))
    before = posture.leg_jacobian(Foot.LEFT).copy()
    posture.update(bent(robot), still)
    fresh = robot.posture()
    fresh.update(bent(robot), still)
    assert np.abs(posture.leg_jacobian(Foot.LEFT) - before).max() > 0.01
    np.testing.assert_array_equal(posture.leg_jacobian(Foot.LEFT), fresh.leg_jacobian(Foot.LEFT))
    np.testing.assert_array_equal(posture.com_in_sole(Foot.RIGHT), fresh.com_in_sole(Foot.RIGHT))


def test_continuous_joints_are_joints_like_others():
    turning = Robot(urdf_of("coman").replace('type="revolute"', 'type="continuous"'), Config().robot)
    plain = robot_of("coman")
    assert turning.joint_names == plain.joint_names
    a, b = turning.posture(), plain.posture()
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, qd = rng.uniform(-4.0, 4.0, 12), rng.uniform(-1.0, 1.0, 12)  # beyond half a turn
        a.update(q, qd)
        b.update(q, qd)
        for foot in FEET:
            np.testing.assert_allclose(a.com_in_sole(foot), b.com_in_sole(foot), atol=1e-12)
            np.testing.assert_allclose(a.leg_jacobian(foot), b.leg_jacobian(foot), atol=1e-12)


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_joints_come_back_from_a_configuration(kind):
    robot = Robot(urdf_of("coman").replace('type="revolute"', f'type="{kind}"'), Config().robot)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, len(robot.joint_names))
    configuration = np.zeros(robot.model.nq)
    robot.scatter(q, configuration)
    assert robot.gather(configuration) == pytest.approx(q)


def edited(change):
    """The URDF of COMAN after `change(root)`."""
    root = ElementTree.fromstring(urdf_of("coman"))
    change(root)
    return ElementTree.tostring(root, encoding="unicode")


def with_arm(root):
    root.append(
        ElementTree.fromstring(
            '<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
    )
    root.append(
        ElementTree.fromstring(
            '<joint name="Arm" type="revolute"><parent link="base_link"/><child link="arm"/><axis xyz="0 1 0"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    )


def test_extra_joints_move_the_com():
    robot, plain = Robot(edited(with_arm), Config().robot), robot_of("coman")
    assert set(robot.joint_names) == {*plain.joint_names, "Arm"}
    assert robot.mass == pytest.approx(plain.mass + 2.0)
    posture = robot.posture()
    q, still = np.zeros(13), np.zeros(13)
    forward_reach = posture.com_in_sole(Foot.LEFT)[0]
    q[robot.joint_names.index("Arm")] = np.pi
    posture.update(q, still)
    backward_reach = posture.com_in_sole(Foot.LEFT)[0]
    np.testing.assert_allclose(forward_reach - backward_reach, [2 * 0.2 * 2.0 / robot.mass, 0.0, 0.0], atol=1e-12)
    assert [robot.joint_names[i] for i in robot.legs[Foot.RIGHT]] == list(Config().robot.right.joints)


def fixed_knee(root):
    (joint,) = (j for j in root.findall("joint") if j.get("name") == "LKneeSag")
    joint.set("type", "fixed")


def without_mass(root):
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)


def sole_nowhere(root, where="0 0 nan"):
    for link in root.findall("link"):
        for origin in link.findall("collision/origin") if link.get("name") == "l_foot" else ():
            origin.set("xyz", where)


SWAPPED = ("LHipLat", "LHipSag", *Config().robot.left.joints[2:])
LEFT = Config().robot.left


@pytest.mark.parametrize(
    ("urdf", "config", "wanted"),
    [
        (lambda: "", RobotConfig(), "empty"),
        (lambda: "<robot", RobotConfig(), "not XML"),
        (lambda: "<html/>", RobotConfig(), "<html>"),
        (lambda: '<robot name="r"/>', RobotConfig(), "not a URDF"),
        (lambda: '<robot name="r"><link name="a"/><link name="b"/></robot>', RobotConfig(), "one root link.* 2: a, b"),
        (lambda: '<robot name="r"><link name="a"/><joint name="j"/></robot>', RobotConfig(), "cannot be read"),
        (lambda: edited(without_mass), RobotConfig(), "no mass"),
        (lambda: urdf_of("coman"), RobotConfig(base_frame="pelvis"), "'pelvis'.*robot.base_frame.*base_link"),
        (lambda: urdf_of("coman"), RobotConfig(left=replace(LEFT, sole_frame="sole")), "'sole'.*robot.left.sole_frame"),
        (lambda: urdf_of("coman"), RobotConfig(left=replace(LEFT, joints=SWAPPED)), "LHipSag, LHipLat.*not LHipLat"),
        (lambda: urdf_of("coman"), RobotConfig(left=replace(LEFT, joints=("Hip",))), "'Hip'.*robot.left.joints.*LHipS"),
        (lambda: urdf_of("coman"), RobotConfig(left=replace(LEFT, joints=(), damping=(1.0,))), "damping: 1 val.* 6"),
        (lambda: urdf_of("coman"), RobotConfig("", "", "l_foot"), "base_frame: 'l_foot' is on the left leg"),
        (lambda: urdf_of("coman"), RobotConfig(right=LEFT, left=replace(LEFT, sole_frame="r_sole")), "RHipSag.*not LH"),
        (lambda: edited(fixed_knee), RobotConfig(), "LKneeSag"),
        (lambda: edited(sole_nowhere), RobotConfig(), "collision shape of a foot"),
    ],
)  # fmt: skip
def test_a_urdf_that_cannot_be_used_is_refused_in_one_line(urdf, config, wanted, capfd):
    with pytest.raises(RobotError, match=wanted) as error:
        Robot(urdf(), config, source="file.urdf")
    assert str(error.value).startswith("file.urdf: ") and "\n" not in str(error.value)
    assert len(str(error.value)) < 500
    if wanted not in ("cannot be read", "collision shape of a foot"):  # the parser says that on the terminal as well
        assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("where", "edges"), [("0 0 1e300", [-0.1, 0.1, -0.05, 0.05]), ("1e300 0 0", [-0.2, 0.2, -0.1, 0.1])]
)
def test_a_sole_that_is_far_away_has_edges(where, edges):
    """Those of its shape; those of the configuration, where rounding leaves no area."""
    robot = Robot(edited(partial(sole_nowhere, where=where)), RobotConfig(foot_length=0.4, foot_width=0.2))
    assert robot.soles[Foot.LEFT].tolist() == edges


@settings(deadline=None, max_examples=20)
@given(st.lists(st.floats(-100, 100), min_size=6, max_size=6), st.sampled_from(FEET))
def test_a_wrench_does_the_same_work_in_any_frame_of_the_foot(values, foot):
    """Told at the ankle, arriving at the sole: equal power with any motion of the foot."""
    robot = robot_of("coman")
    ft, sole = {Foot.LEFT: ("l_ft", "l_sole"), Foot.RIGHT: ("r_ft", "r_sole")}[foot]
    poses, _, _ = forward(urdf_of("coman"), {})
    T = np.linalg.inv(poses[sole]) @ poses[ft]
    R, p = T[:3, :3], T[:3, 3]
    assert np.linalg.norm(p) > 0.01
    force, torque = np.array(values[:3]), np.array(values[3:])
    at_sole = robot.wrench_to_sole(foot, ft, force, torque)
    v, w = np.array([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -0.7])  # of the sole, in its frame
    there = R.T @ (v + np.cross(w, p)), R.T @ w  # of the other frame, in its own
    assert at_sole @ np.concatenate((v, w)) == pytest.approx(there[0] @ force + there[1] @ torque, abs=1e-9)


def test_wrench_frames_that_make_no_sense_are_named():
    robot = robot_of("coman")
    with pytest.raises(RobotError, match=r"left foot.*'nowhere'"):
        robot.wrench_to_sole(Foot.LEFT, "nowhere", np.zeros(3), np.zeros(3))
    with pytest.raises(RobotError, match=r"right foot.*'l_sole'.*not fixed"):
        robot.wrench_to_sole(Foot.RIGHT, "l_sole", np.zeros(3), np.zeros(3))
    plain = np.arange(6.0)
    np.testing.assert_allclose(robot.wrench_to_sole(Foot.LEFT, "/l_sole", plain[:3], plain[3:]), plain)
