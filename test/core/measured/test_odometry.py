# SPDX-License-Identifier: BSD-3-Clause
"""Odometry chained from foot to foot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Array, Foot
from coman_reduced_model.core.measured.odometry import FootOdometry, inverse, pose

angle = st.floats(-3.0, 3.0)
steps = st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(0.05, 0.4), st.floats(-0.5, 0.5)), min_size=1, max_size=20)
trunks = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.2, 1.2), angle, st.floats(-0.3, 0.3))


def flat(x: float, y: float, yaw: float) -> Array:
    """Pose of a sole on the floor."""
    return pose(Rotation.from_euler("z", yaw).as_matrix(), np.array([x, y, 0.0]))


def trunk(x: float, y: float, z: float, yaw: float, pitch: float) -> Array:
    return pose(Rotation.from_euler("ZY", [yaw, pitch]).as_matrix(), np.array([x, y, z]))


def seen(T_world_base: Array, T_world_left: Array, T_world_right: Array) -> tuple[Array, ...]:
    """Arguments of `update` after the foot: the soles as the joints see them from the base."""
    left, right = (inverse(T_world_base) @ T for T in (T_world_left, T_world_right))
    return left[:3, :3], left[:3, 3], right[:3, :3], right[:3, 3]


def test_starts_at_the_first_support_sole_and_not_before() -> None:
    odometry = FootOdometry()
    soles = seen(trunk(0.1, 0.2, 0.5, 0.3, 0.1), flat(0, 0.1, 0), flat(0, -0.1, 0))
    assert np.isnan(odometry.update(Foot.NONE, *soles)).all()  # never an identity that nothing stands for
    assert odometry.update(Foot.RIGHT, *soles) == pytest.approx(np.eye(4))
    assert odometry.update(Foot.NONE, *soles) == pytest.approx(np.eye(4))
    odometry.reset()
    assert np.isnan(odometry.update(Foot.NONE, *soles)).all()


@given(steps, trunks, st.sampled_from([Foot.LEFT, Foot.RIGHT]))
def test_follows_any_walk_on_level_ground_exactly(walk: list, base: tuple, foot: Foot) -> None:
    odometry = FootOdometry()
    T_world_base = trunk(*base)
    soles = {foot: flat(0.3, -0.2, 0.7), foot.other: flat(0.3, 0.1, 0.6)}
    origin = soles[foot]
    odometry.update(foot, *seen(T_world_base, soles[Foot.LEFT], soles[Foot.RIGHT]))
    for x, y, yaw in walk:
        soles[foot.other] = soles[foot] @ flat(x, y, yaw)
        T_world_base = T_world_base @ trunk(x, 0.0, 0.0, yaw, 0.01)  # the trunk moves as it likes
        foot = foot.other
        arguments = seen(T_world_base, soles[Foot.LEFT], soles[Foot.RIGHT])
        T = odometry.update(foot, *arguments)
        assert pytest.approx(inverse(origin) @ soles[foot], abs=1e-9) == T
        R, p = arguments[:2] if foot == Foot.LEFT else arguments[2:]
        assert T @ inverse(pose(R, p)) == pytest.approx(inverse(origin) @ T_world_base, abs=1e-9)


def test_joint_errors_do_not_make_the_floor_lean() -> None:
    odometry = FootOdometry()
    T_world_base = trunk(0, 0, 0.5, 0, 0)
    for k in range(200):
        foot = Foot.LEFT if k % 2 else Foot.RIGHT
        tilt = Rotation.from_euler("xyz", [0.02, 0.05, 0.0]).as_matrix()  # always the same error, the worst case
        left, right = flat(0, 0.07, 0), pose(tilt, np.array([0.0, -0.07, 0.01]))
        T = odometry.update(foot, *seen(T_world_base, left, right))
        assert T[2] == pytest.approx([0, 0, 1, 0])
        assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3))


@pytest.mark.parametrize(("length", "tilt"), [(0.35, 0.05), (0.55, 0.03), (0.4, -0.06)])
def test_long_steps_on_a_sole_that_is_off_do_not_climb(length: float, tilt: float) -> None:
    """One sole sees the other up or down by them, that one does not see the first the other way."""
    odometry, R = FootOdometry(), Rotation.from_euler("y", tilt).as_matrix()
    for k in range(20):
        x = length * np.array([k - k % 2, k - (k + 1) % 2])  # left and right, of which one has just stepped
        left, right = flat(x[0], 0.07, 0), pose(R, np.array([x[1], -0.07, 0.0]))
        T = odometry.update(Foot.RIGHT if k % 2 else Foot.LEFT, *seen(trunk(x.mean(), 0, 0.5, 0, 0), left, right))
    assert T[2, 3] == 0.0 and T[0, 3] > 15.0 * length


@pytest.mark.parametrize(("height", "tilt"), [(0.03, 0.0), (0.15, 0.055), (-0.15, 0.04)])
def test_a_step_is_climbed(height: float, tilt: float) -> None:
    """By soles that are a few degrees off as well."""
    odometry, base = FootOdometry(), trunk(0.1, 0, 0.6, 0, 0)
    odometry.update(Foot.LEFT, *seen(base, flat(0, 0.07, 0), flat(0, -0.07, 0)))
    step = pose(Rotation.from_euler("y", tilt).as_matrix(), np.array([0.3, -0.07, height]))
    found = odometry.update(Foot.RIGHT, *seen(base, flat(0, 0.07, 0), step))[2, 3]
    assert found == pytest.approx(height, abs=0.5 * 0.3 * tilt + 1e-3)


def test_stance_does_not_move_while_the_other_foot_swings() -> None:
    odometry = FootOdometry()
    base = trunk(0, 0, 0.5, 0, 0)
    first = odometry.update(Foot.LEFT, *seen(base, flat(0, 0.1, 0), flat(0, -0.1, 0))).copy()
    second = odometry.update(Foot.LEFT, *seen(trunk(0.1, 0, 0.6, 0.2, 0.1), flat(0, 0.1, 0), flat(0.4, -0.2, 0.5)))
    assert second == pytest.approx(first)
