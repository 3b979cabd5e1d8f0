# SPDX-License-Identifier: BSD-3-Clause
"""Links in the frames of their parents, and the root link in that of a sole, against forward kinematics of our own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import NAMES, forward, robot_of, urdf_of
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.robot.links import Links

seeds = st.integers(0, 2**32 - 1)


def matrix(pose):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return T


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=10)
@given(seed=seeds)
def test_the_chain_of_links_is_forward_kinematics(name, seed):
    robot = robot_of(name)
    q = np.random.default_rng(seed).uniform(-3.0, 3.0, len(robot.joint_names))
    links = Links(robot)
    between = [(*names, pose) for names, pose in zip(links.moving, links.poses(q), strict=True)] + links.fixed
    poses = {robot.root: np.eye(4)}
    while between:
        known = [each for each in between if each[0] in poses]
        assert known, "links that hang on nothing"
        poses.update({child: poses[parent] @ matrix(pose) for parent, child, pose in known})
        between = [each for each in between if each[1] not in poses]
    expected, _, _ = forward(urdf_of(name), dict(zip(robot.joint_names, q, strict=True)))
    assert poses.keys() == expected.keys()
    for link, T in expected.items():
        np.testing.assert_allclose(poses[link], T, atol=2e-6, err_msg=link)  # axes that are rounded in the URDF


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=10)
@given(seed=seeds, foot=st.sampled_from([Foot.LEFT, Foot.RIGHT]))
def test_the_root_link_moves_as_its_pose_changes(name, seed, foot):
    robot, rng, dt = robot_of(name), np.random.default_rng(seed), 1e-6
    n = len(robot.joint_names)
    q, qd = rng.uniform(-0.7, 0.7, n), rng.uniform(-2.0, 2.0, n)
    found = []
    for at in (q - dt * qd, q + dt * qd, q):
        posture = robot.posture()
        posture.update(at, qd)
        posture.com_in_sole(foot)
        found.append(posture.base_in_sole)
    before, after, now = found
    np.testing.assert_allclose(now[:3], posture.R[foot].T, atol=1e-12)
    np.testing.assert_allclose(now[:3] @ posture.p[foot] + now[3], 0.0, atol=1e-12)  # the sole in its own frame
    linear = now[:3].T @ (after[3] - before[3]) / (2 * dt)
    turned = Rotation.from_matrix(before[:3].T @ after[:3]).as_rotvec() / (2 * dt)
    np.testing.assert_allclose(now[4:], (linear, turned), atol=1e-5)
