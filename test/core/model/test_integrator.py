# SPDX-License-Identifier: BSD-3-Clause
"""Exact steps against closed forms, matrix exponentials and a dense numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from coman_reduced_model.core.model.integrator import phi_functions, step

ONE = np.array([0])
NO_MOVE = np.zeros(1)
seeds = st.integers(0, 2**32 - 1)


def matrix(value):
    return np.array([[float(value)]])


def swing(x, v, m, k, d, dt, steps=1, force=0.0):
    """States of a mass on a spring, (steps + 1, 2)."""
    states = [np.array([x, v], float)]
    for _ in range(steps):
        moment = (matrix(k), matrix(d), np.array([force]), NO_MOVE, NO_MOVE)
        state = step(states[-1], matrix(m), ONE, moment, moment, dt)
        states.append(state)
    return np.array(states)


def random_system(seed, n=3, fastest=300.0):
    """M, K, D of n coupled masses with springs between 1 and `fastest` rad/s."""
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, n))
    K = A @ A.T
    D = B @ B.T
    mass = rng.uniform(1.0, 50.0)
    return (
        mass * np.eye(n),
        mass * (K / np.linalg.norm(K) * rng.uniform(1.0, fastest) ** 2 + np.eye(n)),
        mass * D / np.linalg.norm(D) * rng.uniform(0.0, 0.2 * fastest),
    )


@given(seeds, st.floats(1e-4, 300.0), st.integers(1, 6))
@settings(deadline=None, max_examples=60)
def test_phi_functions_agree_with_a_block_exponential(seed, size, n):
    """exp([[Z, 1, 0], [0, 0, 1], [0, 0, 0]]) has e^Z, phi_1(Z), phi_2(Z) in its first row."""
    Z = np.random.default_rng(seed).normal(size=(n, n))
    Z = Z - 1.1 * np.linalg.norm(Z, 2) * np.eye(n)  # decaying, as motions are
    Z *= size / np.linalg.norm(Z, 2)
    zero, one = np.zeros((n, n)), np.eye(n)
    whole = expm(np.block([[Z, one, zero], [zero, zero, one], [zero, zero, zero]]))
    for i, phi in enumerate(phi_functions(Z)):
        np.testing.assert_allclose(phi, whole[:n, i * n : (i + 1) * n], atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.0005, 0.005, 0.1])
@pytest.mark.parametrize(("k", "zeta"), [(3000.0, 0.05), (9e4, 0.02), (400.0, 0.7), (5000.0, 3.0)])
def test_free_oscillation_has_the_frequency_and_decay_of_the_closed_form(k, zeta, dt):
    m = 17.3
    omega = np.sqrt(k / m)
    states = swing(0.01, 0.0, m, k, 2 * zeta * np.sqrt(k * m), dt, 50)
    t = dt * np.arange(51)
    root = np.sqrt(complex(zeta**2 - 1.0))
    fast, slow = omega * (-zeta - root), omega * (-zeta + root)
    x = 0.01 * ((slow * np.exp(fast * t) - fast * np.exp(slow * t)) / (slow - fast)).real
    np.testing.assert_allclose(states[:, 0], x, atol=1e-12)


def test_static_sag():
    """The sag is m g / k, and a mass in equilibrium stays there to the last digit."""
    sag = -17.3 * 9.81 / 30000.0
    states = swing(sag, 0.0, 17.3, 30000.0, 50.0, 0.01, 1000, force=-17.3 * 9.81)
    np.testing.assert_allclose(states, np.tile([sag, 0.0], (1001, 1)), atol=1e-13)
    assert swing(0.0, 0.0, 17.3, 30000.0, 500.0, 0.1, 20, force=-17.3 * 9.81)[-1, 0] == pytest.approx(sag, rel=1e-6)


@given(seeds, st.sampled_from([0.0005, 0.005, 0.02, 0.1]))
@settings(deadline=None, max_examples=40)
def test_energy_never_grows_without_input_and_is_kept_without_damping(seed, dt):
    M, K, D = random_system(seed)
    axes, zero = np.arange(3), np.zeros(3)

    def energies(damping):
        state = np.random.default_rng(seed).normal(size=6)
        found = []
        for _ in range(200):
            found.append(state[:3] @ K @ state[:3] + state[3:] @ M @ state[3:])
            state = step(state, M, axes, (K, damping, zero, zero, zero), (K, damping, zero, zero, zero), dt)
        return np.array(found)

    damped, free = energies(D), energies(np.zeros((3, 3)))
    assert (np.diff(damped) <= 1e-9 * damped[0]).all()
    np.testing.assert_allclose(free, free[0], rtol=1e-9)


@given(seeds, st.floats(0.0005, 0.1), st.integers(2, 100))
@settings(deadline=None, max_examples=40)
def test_one_long_step_is_many_short_ones(seed, dt, parts):
    """No term of the step size is dropped, while the reference moves linearly."""
    M, K, D = random_system(seed)
    rng = np.random.default_rng(seed)
    axes = np.array([0, 2])
    state, p, v = rng.normal(size=6), rng.normal(size=3), rng.normal(size=3)

    def moment(w):
        p_w = p + w * dt * v
        return K, D, K @ p_w + D @ v + [0.0, 0.0, -100.0 * w], p_w, v

    once = step(state, M, axes, moment(0.0), moment(1.0), dt)
    many = state
    for part in range(parts):
        many = step(many, M, axes, moment(part / parts), moment((part + 1) / parts), dt / parts)
    np.testing.assert_allclose(once, many, rtol=1e-8, atol=1e-8 * np.abs(many).max())


@given(seeds, st.floats(0.001, 0.1))
@settings(deadline=None, max_examples=15)
def test_a_step_agrees_with_dense_integration(seed, dt):
    M, K, D = random_system(seed, fastest=100.0)
    rng = np.random.default_rng(seed + 1)
    state, u = rng.normal(size=6), rng.normal(size=(2, 3))

    def motion(t, z):
        force = u[0] + (u[1] - u[0]) * t / dt
        return np.concatenate((z[3:], np.linalg.solve(M, force - K @ z[:3] - D @ z[3:])))

    dense = solve_ivp(motion, (0.0, dt), state, rtol=1e-10, atol=1e-12).y[:, -1]
    zero = np.zeros(3)
    exact = step(state, M, np.arange(3), (K, D, u[0], zero, zero), (K, D, u[1], zero, zero), dt)
    np.testing.assert_allclose(exact, dense, rtol=1e-6, atol=1e-7 * np.abs(dense).max())


def test_changing_stiffness_counts_to_second_order_and_never_pulls_a_mass_at_rest():
    """K, D and p move together: where the coordinates have their origin does not matter, however large K p is."""
    M, K, D = random_system(5, fastest=60.0)
    axes, g = np.arange(3), np.array([0.0, 0.0, -9.81 * M[0, 0]])

    def moment(t, origin):
        k, p, v = 1.0 + 3.0 * t, np.full(3, origin + 0.1 * t), np.full(3, 0.1)
        return k * K, k * D, k * (K @ p + D @ v) + g, p, v

    def run(parts, origin):
        state = np.concatenate((np.full(3, origin + 0.001), np.zeros(3)))
        for i in range(parts):
            start, end = moment(0.2 * i / parts, origin), moment(0.2 * (i + 1) / parts, origin)
            state = step(state, M, axes, start, end, 0.2 / parts)
        return state[:3] - origin

    exact = run(20000, 0.0)
    np.testing.assert_allclose(run(40, 100.0), run(40, 0.0), atol=1e-9)
    coarse, fine = (np.abs(run(parts, 0.0) - exact).max() for parts in (20, 40))
    assert fine < 0.3 * coarse and fine < 1e-5
    at_rest = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    still = [(k * K, k * D, k * K @ at_rest[:3], at_rest[:3], np.zeros(3)) for k in (1.0, 2.0)]
    np.testing.assert_allclose(step(at_rest, M, axes, *still, 0.01), at_rest, atol=1e-12)


def test_no_stiffness_and_negative_stiffness_are_no_exceptions():
    """A free mass falls, a pendulum topples: K needs no inverse."""
    (_, fall) = swing(0.0, 2.0, 5.0, 0.0, 0.0, 0.3, force=-5.0 * 9.81)
    np.testing.assert_allclose(fall, [2.0 * 0.3 - 0.5 * 9.81 * 0.09, 2.0 - 9.81 * 0.3], rtol=1e-12)
    omega = np.sqrt(9.81 / 0.4)
    (_, topple) = swing(0.01, 0.05, 5.0, -5.0 * omega**2, 0.0, 0.4)
    c, s = np.cosh(omega * 0.4), np.sinh(omega * 0.4)
    np.testing.assert_allclose(topple, [0.01 * c + 0.05 / omega * s, 0.01 * omega * s + 0.05 * c], rtol=1e-11)


@pytest.mark.parametrize("dt", [0.0005, 0.1])
def test_springs_of_any_stiffness_stay_bounded(dt):
    states = swing(0.01, 0.0, 17.3, 17.3 * 1e8, 17.3 * 100.0, dt, 100)
    assert np.abs(states[:, 0]).max() <= 0.01 * (1 + 1e-6)


def test_what_is_not_integrated_is_neither_moved_nor_felt():
    M, K, D = random_system(7)
    zero, axes = np.zeros(3), np.array([0, 2])
    state = np.array([0.1, 5.0, 0.2, 0.0, -3.0, 0.0])
    other = state.copy()
    other[[1, 4]] = [-8.0, 9.0]
    moment = (K, D, zero, zero, zero)
    a, b = (step(s, M, axes, moment, moment, 0.01) for s in (state, other))
    np.testing.assert_array_equal(a[[1, 4]], [5.0, -3.0])
    np.testing.assert_array_equal(a[[0, 2, 3, 5]], b[[0, 2, 3, 5]])


@given(seeds, st.floats(0.005, 0.02))
def test_a_reference_that_bends_between_two_samples_pulls_with_its_mean(seed, dt):
    """One step between the ends of a cubic against a hundred along it: slow masses feel the same impulse."""
    rng = np.random.default_rng(seed)
    M, K, D = random_system(seed, fastest=1.0)
    ends = rng.normal(size=(4, 3)) * np.array([[0.01], [0.01], [0.1], [0.1]])

    def moment(s):
        p_0, p_1, v_0, v_1 = ends
        way = np.array([2 * s**3 - 3 * s**2 + 1, 3 * s**2 - 2 * s**3])
        rate = np.array([s**3 - 2 * s**2 + s, s**3 - s**2]) * dt
        p = way @ [p_0, p_1] + rate @ [v_0, v_1]
        v = 6 * (s - s**2) / dt * (p_1 - p_0) + np.array([3 * s**2 - 4 * s + 1, 3 * s**2 - 2 * s]) @ [v_0, v_1]
        return K, D, K @ p + D @ v, p, v

    at_rest = np.zeros(6)
    once = step(at_rest, M, np.arange(3), moment(0.0), moment(1.0), dt)
    many = at_rest
    for part in range(100):
        many = step(many, M, np.arange(3), moment(part / 100), moment((part + 1) / 100), dt / 100)
    straight = [(K, D, K @ p + D @ v, np.zeros(3), np.zeros(3)) for p, v in zip(ends[:2], ends[2:], strict=True)]
    linear = step(at_rest, M, np.arange(3), *straight, dt)
    assert np.abs(once - many)[3:].max() < 0.05 * np.abs(linear - many)[3:].max()
