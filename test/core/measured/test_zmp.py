# SPDX-License-Identifier: BSD-3-Clause
"""Centre of pressure and zero moment point against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Array
from coman_reduced_model.core.measured.odometry import pose
from coman_reduced_model.core.measured.zmp import cop, zmp_from_wrenches

inside = st.floats(-0.1, 0.1)
force = st.floats(10.0, 1000.0)


def pressure(x: float, y: float, fz: float, fx: float = 0.0, fy: float = 0.0) -> Array:
    """Wrench of a force that acts at (x, y) on the sole, with a twisting moment besides."""
    f = np.array([fx, fy, fz])
    return np.concatenate([f, np.cross([x, y, 0.0], f) + [0, 0, 3.0]])


@given(inside, inside, force, st.floats(-50, 50), st.floats(-50, 50))
def test_cop_is_where_the_force_acts(x: float, y: float, fz: float, fx: float, fy: float) -> None:
    assert cop(pressure(x, y, fz, fx, fy)) == pytest.approx([x, y, 0.0], abs=1e-9)


@given(inside, inside, force, inside, inside, force, st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3))
def test_zmp_is_the_mean_of_both_cops_weighted_by_load(
    x1: float, y1: float, f1: float, x2: float, y2: float, f2: float, dx: float, dy: float, yaw: float
) -> None:
    R, p = Rotation.from_euler("z", yaw).as_matrix(), np.array([dx, dy, 0.0])
    second = R @ [x2, y2, 0.0] + p
    expected = (f1 * np.array([x1, y1, 0.0]) + f2 * second) / (f1 + f2)
    left, right = pressure(x1, y1, f1, 5.0, -3.0), pressure(x2, y2, f2, -2.0, 1.0)
    assert zmp_from_wrenches(left, right, np.eye(4), pose(R, p)) == pytest.approx(expected, abs=1e-9)
    assert zmp_from_wrenches(right, left, pose(R, p), np.eye(4)) == pytest.approx(expected, abs=1e-9)


def test_no_point_without_force_or_without_wrench() -> None:
    air, ground = np.zeros(6), pressure(0.01, 0.0, 100.0)
    assert cop(air) is None and cop(-ground) is None and cop(np.full(6, np.nan)) is None
    assert zmp_from_wrenches(air, air, np.eye(4), np.eye(4)) is None
    assert zmp_from_wrenches(None, ground, np.eye(4), np.eye(4)) is None
    assert zmp_from_wrenches(ground, None, np.eye(4), np.eye(4)) is None
    assert zmp_from_wrenches(ground, air, np.eye(4), np.eye(4)) == pytest.approx([0.01, 0.0, 0.0])
