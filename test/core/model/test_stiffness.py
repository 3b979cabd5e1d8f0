# SPDX-License-Identifier: BSD-3-Clause
"""Springs seen at the COM, (8)-(13): against inverse Jacobians, energies and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots import bent, robot_of

from coman_reduced_model.core.base.compiled import apply, inverse, mul
from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.model.stiffness import spring_damper
from coman_reduced_model.core.robot.leg import height_hessian

LIMIT = 0.02
LENGTH = 0.5
seeds = st.integers(0, 2**32 - 1)


def jacobian(q, foot=Foot.LEFT):
    posture = robot_of("coman").posture()
    posture.update(q, np.zeros(len(q)))
    return posture.leg_jacobian(foot)


@st.composite
def legs(draw):
    """A leg away from singular postures: J (6, 6), K_q, D_q."""
    rng = np.random.default_rng(draw(seeds))
    robot = robot_of("coman")
    q = bent(robot, knee=rng.uniform(0.4, 1.4)) + rng.uniform(-0.2, 0.2, 12)
    J = jacobian(q, draw(st.sampled_from((Foot.LEFT, Foot.RIGHT))))
    return J, np.diag(rng.uniform(100.0, 4000.0, 6)), np.diag(rng.uniform(0.2, 15.0, 6))


@given(seeds, st.integers(1, 7))
@settings(deadline=None, max_examples=50)
def test_small_matrices_agree_with_numpy(seed, n):
    rng = np.random.default_rng(seed)
    A, B, x = rng.normal(size=(n, n)), rng.normal(size=(n, 4)), rng.normal(size=n)
    np.testing.assert_allclose(mul(A, B), A @ B, atol=1e-12)
    np.testing.assert_allclose(apply(A, x), A @ x, atol=1e-12)
    assume(np.linalg.cond(A) < 1e6)
    np.testing.assert_allclose(inverse(A) @ A, np.eye(n), atol=1e-8)


def test_the_inverse_needs_pivots_and_never_raises():
    np.testing.assert_array_equal(inverse(np.array([[0.0, 2.0], [4.0, 0.0]])), [[0.0, 0.25], [0.5, 0.0]])
    assert not np.isfinite(inverse(np.zeros((3, 3)))).any()
    assert not np.isfinite(inverse(np.full((2, 2), np.nan))).any()


@given(legs())
@settings(deadline=None, max_examples=50)
def test_six_joints_give_the_papers_congruence(leg):
    """(12), (13): K_c = J^-T K_q J^-1, D_c = J^-T D_q J^-1; symmetric, positive, and (9)-(11) hold."""
    J, K_q, D_q = leg
    K, D, near_singular = spring_damper(J, K_q, D_q, LENGTH, 1e-6)
    J_inv = np.linalg.inv(J)
    assert not near_singular
    assert np.abs(K - J_inv.T @ K_q @ J_inv).max() < 1e-5 * np.abs(K).max()
    assert np.abs(D - J_inv.T @ D_q @ J_inv).max() < 1e-5 * np.abs(D).max()
    np.testing.assert_array_equal(K, K.T)
    assert np.linalg.eigvalsh(K).min() > 0.0
    assert np.linalg.eigvalsh(0.5 * (D + D.T)).min() > 0.0
    dq = 1e-3 * np.arange(1.0, 7.0)
    np.testing.assert_allclose(J.T @ (K @ (J @ dq)), K_q @ dq, rtol=1e-4)


@given(legs())
@settings(deadline=None, max_examples=50)
def test_condensed_is_the_stiffness_of_least_energy(leg):
    """The trunk turns as it likes: of all deflections that move the COM by dp the springs take the cheapest."""
    J, K_q, D_q = leg
    K, D, near_singular = spring_damper(J[:3], K_q, D_q, LENGTH, 1e-6)
    assert not near_singular
    np.testing.assert_allclose(K, np.linalg.inv(J[:3] @ np.linalg.inv(K_q) @ J[:3].T), rtol=1e-5)
    dp = np.array([1e-3, -2e-3, 5e-4])
    kkt = np.block([[K_q, J[:3].T], [J[:3], np.zeros((3, 3))]])
    dq = np.linalg.solve(kkt, np.concatenate((np.zeros(6), dp)))[:6]
    assert dp @ K @ dp == pytest.approx(dq @ K_q @ dq, rel=1e-5)
    assert dp @ D @ dp == pytest.approx(dq @ D_q @ dq, rel=1e-5)
    full, _, _ = spring_damper(J, K_q, D_q, LENGTH, 1e-6)
    assert np.linalg.eigvalsh(full[:3, :3] - K).min() > -1e-6 * np.abs(full).max()  # holding the trunk stiffens


@given(legs(), st.floats(0.3, 2.0))
@settings(deadline=None, max_examples=20)
def test_the_length_that_scales_changes_nothing(leg, length):
    for rows in (3, 6):
        a = spring_damper(leg[0][:rows], *leg[1:], LENGTH, 1e-6)
        b = spring_damper(leg[0][:rows], *leg[1:], length, 1e-6)
        for one, other in zip(a[:2], b[:2], strict=True):
            assert np.abs(one - other).max() < 1e-4 * np.abs(one).max()


@pytest.mark.slow
@pytest.mark.parametrize("rows", [3, 6])
def test_a_straight_knee_is_flagged_finite_and_continuous(rows):
    robot = robot_of("coman")
    leg = (np.diag([3000.0, 3500.0, 2500.0, 180.0, 200.0, 3000.0]), np.diag([12.0, 12.0, 8.0, 4.0, 4.0, 8.0]))
    knees = np.linspace(-0.2, 0.4, 6001)
    found = [spring_damper(jacobian(bent(robot, knee))[:rows], *leg, LENGTH, LIMIT) for knee in knees]
    blocks = np.array([(K, D) for K, D, _ in found])
    flags = np.array([near_singular for _, _, near_singular in found])
    if rows == 6:  # with the trunk free to turn hip and ankle move the COM up and down, whatever the knee
        assert flags[np.abs(knees) < 1e-3].all() and not flags[0] and not flags[-1]
    assert np.isfinite(blocks).all()
    assert np.abs(blocks[:, 0]).max() < 1.01 * 3500.0 / (LIMIT * LENGTH) ** 2
    jumps = np.abs(np.diff(blocks, axis=0)).max(axis=(2, 3)) / np.abs(blocks).max(axis=(2, 3))[1:]
    assert jumps.max() < 0.02
    for K, D in blocks[::20]:
        modes = np.linalg.eigvalsh(np.linalg.solve(np.linalg.cholesky(K), D) @ np.linalg.inv(np.linalg.cholesky(K)).T)
        assert modes.min() > 1e-4 and modes.max() < 0.1  # [s] D / K of the joints is 0.002 to 0.022 s


def test_a_leg_of_five_joints_is_not_near_singular_for_that(bend=0.6):
    J = jacobian(bent(robot_of("coman"), bend))[:, :5].copy()
    K, D, near_singular = spring_damper(J, np.diag([3000.0] * 5), np.diag([10.0] * 5), LENGTH, LIMIT)
    assert not near_singular and np.isfinite(K).all() and np.isfinite(D).all()


@given(seeds, st.sampled_from((Foot.LEFT, Foot.RIGHT)))
@settings(deadline=None, max_examples=15)
def test_height_hessian_is_the_second_derivative_of_the_height(seed, foot):
    """Of a point fixed to the trunk where the COM is, above a sole that stands still."""
    robot = robot_of("coman")
    q = np.random.default_rng(seed).uniform(-0.6, 0.6, 12)
    posture, still = robot.posture(), np.zeros(12)
    posture.update(q, still)
    point = posture.com.copy()
    H = height_hessian(posture.leg_jacobian(foot))

    def height(dq):
        moved = q.copy()
        moved[robot.legs[foot]] += dq
        posture.update(moved, still)
        return posture.R[foot][:, 2] @ (point - posture.p[foot])

    e, unit = 1e-4, np.eye(6)
    for i in range(6):
        for j in range(6):
            a, b = e * unit[i], e * unit[j]
            second = (height(a + b) - height(a - b) - height(b - a) + height(-a - b)) / (4 * e * e)
            assert H[i, j] == pytest.approx(second, abs=2e-6)
