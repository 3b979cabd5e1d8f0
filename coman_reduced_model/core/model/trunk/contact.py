# SPDX-License-Identifier: BSD-3-Clause
"""Both soles on the ground, which can only press on them and hold them no more than friction does.

A foot touches the ground with its corners. One that has just landed, or is about to leave, stands on an edge or a
corner; one that is flat is held by all four. That alone decides how the load passes from leg to leg.

Coordinates are y (m + 6,): the joints of both legs, the support leg's first, and a small displacement of the support
sole from level ground, in its axes. Constraints are 14 rows, seven of the support foot and seven of the other one: four
corners up, the middle of the sole forward and left, and its yaw.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.compiled import apply, compiled, inverse_positive
from ...base.types import Array

ROWS = 7  # constraints of a foot
_ROUNDS = 50  # of the iteration for the impulses, at most
_ENOUGH = 1e-3  # of the largest impulse: no corner's impulse changes by more in the last round
_SINKS = 1e-4  # [m] by which a sole sinks in that bears the weight: a hard floor, whose edges give way twice as much
_RETURN = 0.01  # [s] in which a sole that is below the ground comes up


class Sole(NamedTuple):
    """One sole and its leg at a posture, in base axes."""

    R: Array  # (3, 3) orientation in the base frame
    p: Array  # (3,) position there [m]
    twist: Array  # (6, n) twist of the trunk by the joints of the leg, this sole at rest, about the base origin
    edges: Array  # (4,) x of the back and the front, y of the right and the left edge in the sole frame [m]
    ground: Array  # (3,) under it when both stand: height at its origin [m], by x and by y of its frame [1]


class Linear(NamedTuple):
    """M y'' + D (x' - theta') + K (x - theta) = f + ground, linearised at y, with x the first m of the coordinates."""

    y: Array  # (m + 6,) where all this was taken [rad], [m], [rad]
    K: Array  # (m, m) [Nm/rad]
    D: Array  # (m, m) [Nms/rad]
    f: Array  # (m + 6,) forces that depend on neither deflection nor ground [Nm], [N], [Nm]
    C: Array  # (14, m + 6) velocities of the constraints by those of the coordinates
    height: Array  # (14,) of the corners above the ground at y [m]; zero for the other constraints
    reach: Array  # (1,) lever at which friction resists yaw of a sole [m]
    most: Array  # (1,) that a corner of the other foot bears at most [N]


class Solver(NamedTuple):
    """What one trapezoidal step of a fixed length needs, the same for all states of one sample.

    Only the first `rows` constraints are in use: those of the support foot, or of both.
    """

    h: float  # [s]
    rows: int  # 7 or 14
    inverse: Array  # (m + 6, m + 6) (M + h/2 D + h^2/4 K)^-1
    by_impulse: Array  # (rows, m + 6), or more rows, velocities of the coordinates by impulses, a row a constraint
    contact: Array  # (rows, rows), or more, velocities of the constraints by their impulses, and how corners sink in


class State(NamedTuple):
    """State of both legs and the support sole."""

    y: Array  # (m + 6,)
    w: Array  # (m + 6,) rates of y
    P: Array  # (14,) impulses of the ground in the last step [Ns], [Nms]: the search for the next ones begins there


class Options(NamedTuple):
    """What does not change from sample to sample."""

    friction: float  # coefficient between soles and ground
    longest: float  # of the implicit steps [s]
    bandwidth: float  # of the filter of the measurement [rad/s]


@compiled
def contacts(support: Sole, other: Sole, s: Array, A: Array, C: Array, height: Array) -> None:
    """Velocities of both soles against the ground, and where their corners are, in place.

    Args:
        support, other: the soles.
        s: (6,) small displacement of the support sole from level ground, in its axes [m], [rad].
        A: (6, 6) twist of the trunk, in base axes at the base origin, by that of the support sole in its own.
        C, height: as in `Linear`.
    """
    _by_sole(support.R, support.p, A)
    C[:], height[:] = 0.0, 0.0
    _support_rows(C, height, support.edges, s)
    _other_rows(C, height, support, other, _relative_twist(support, other, A), s)


@compiled
def _by_sole(R: Array, p: Array, A: Array) -> None:
    """Fill in A of `contacts`: the twist by that of a sole with pose R, p."""
    A[:] = 0.0
    for j in range(3):
        for i in range(3):
            A[i, j] = R[i, j]
            A[3 + i, 3 + j] = R[i, j]
        A[0, 3 + j] = p[1] * R[2, j] - p[2] * R[1, j]
        A[1, 3 + j] = p[2] * R[0, j] - p[0] * R[2, j]
        A[2, 3 + j] = p[0] * R[1, j] - p[1] * R[0, j]


@compiled
def _relative_twist(support: Sole, other: Sole, A: Array) -> Array:
    """(6, m + 6) twist of the other sole against the ground by all coordinates, base axes, at the base origin."""
    n, k = support.twist.shape[1], other.twist.shape[1]
    T = np.zeros((6, n + k + 6))
    for i in range(6):
        for j in range(n):
            T[i, j] = support.twist[i, j]
        for j in range(k):
            T[i, n + j] = -other.twist[i, j]
        for j in range(6):
            T[i, n + k + j] = A[i, j]
    return T


@compiled
def _support_rows(C: Array, height: Array, edges: Array, s: Array) -> None:
    m = C.shape[1] - 6
    for corner in range(4):
        x, y = edges[corner % 2], edges[2 + corner // 2]
        C[corner, m + 2], C[corner, m + 3], C[corner, m + 4] = 1.0, y, -x
        height[corner] = s[2] + s[3] * y - s[4] * x
    x, y = 0.5 * (edges[0] + edges[1]), 0.5 * (edges[2] + edges[3])
    C[4, m], C[4, m + 5] = 1.0, -y
    C[5, m + 1], C[5, m + 5] = 1.0, x
    C[6, m + 5] = 1.0


@compiled
def _other_rows(C: Array, height: Array, support: Sole, other: Sole, T: Array, s: Array) -> None:
    R_s, p_s, R_o, p_o, edges = support.R, support.p, other.R, other.p, other.edges
    r, c, P = np.zeros(3), np.zeros(3), np.zeros(3)  # a point of the sole: in its frame, in base and in support axes
    for row in range(5):
        if row < 4:
            r[0], r[1] = edges[row % 2], edges[2 + row // 2]
        else:
            r[0], r[1] = 0.5 * (edges[0] + edges[1]), 0.5 * (edges[2] + edges[3])
        for i in range(3):
            c[i] = p_o[i] + R_o[i, 0] * r[0] + R_o[i, 1] * r[1]
        for i in range(3):
            P[i] = R_s[0, i] * (c[0] - p_s[0]) + R_s[1, i] * (c[1] - p_s[1]) + R_s[2, i] * (c[2] - p_s[2])
        if row < 4:
            ground = other.ground[0] + other.ground[1] * r[0] + other.ground[2] * r[1]
            height[ROWS + row] = P[2] + s[2] + s[3] * P[1] - s[4] * P[0] - ground
        for j in range(C.shape[1]):
            v0 = T[0, j] + T[4, j] * c[2] - T[5, j] * c[1]
            v1 = T[1, j] + T[5, j] * c[0] - T[3, j] * c[2]
            v2 = T[2, j] + T[3, j] * c[1] - T[4, j] * c[0]
            if row < 4:
                C[ROWS + row, j] = R_s[0, 2] * v0 + R_s[1, 2] * v1 + R_s[2, 2] * v2
            else:
                C[ROWS + 4, j] = R_s[0, 0] * v0 + R_s[1, 0] * v1 + R_s[2, 0] * v2
                C[ROWS + 5, j] = R_s[0, 1] * v0 + R_s[1, 1] * v1 + R_s[2, 1] * v2
                C[ROWS + 6, j] = R_s[0, 2] * T[3, j] + R_s[1, 2] * T[4, j] + R_s[2, 2] * T[5, j]


@compiled
def impulses(W: Array, v: Array, up: Array, P: Array, friction: float, reach: float, most: float) -> None:
    """Impulses P of the ground in one step, in place: the last ones come in.

    Projected Gauss-Seidel: a corner presses or is free, friction holds a sole within its cone or lets it slide.

    Args:
        W: (r, r) or more, velocities of the constraints by impulses, r = 7 or 14; symmetric.
        v: (r,) velocities at the end of the step without any impulse.
        up: (r,) velocities that corners must have at least; zero for the other constraints, which stick if they can.
        P: (r,) or more [Ns], [Nms].
        friction: coefficient.
        reach: lever at which friction resists yaw [m].
        most: with which a corner of the other foot presses at most [Ns].
    """
    rows = v.shape[0]
    by_v = np.empty(rows)  # impulse that changes the velocity of a constraint by one; 0: a corner that nothing moves
    for i in range(rows):
        corner = i % ROWS < 4
        by_v[i] = 0.0 if corner and not W[i, i] > 0.0 else 1.0 / W[i, i]
    for _ in range(_ROUNDS):
        largest = changed = 0.0
        for first in range(0, rows, ROWS):
            pressing, bears = 0.0, most if first > 0 else np.inf
            for i in range(first, first + ROWS):
                u = v[i]  # without an impulse of its own; those that have just changed are added last: no waiting
                for j in range(i + 1, rows):
                    u += W[i, j] * P[j]
                for j in range(i):
                    u += W[i, j] * P[j]
                new = (up[i] - u) * by_v[i]
                if i < first + 4:
                    new = min(max(0.0, new), bears) if by_v[i] > 0.0 else P[i]
                    largest, changed = max(largest, new), max(changed, abs(new - P[i]))
                    pressing += new
                P[i] = new
            _slide(P[first + 4 : first + ROWS], friction * pressing, reach)
        if changed <= _ENOUGH * largest:
            break


@compiled
def _slide(P: Array, most: float, reach: float) -> None:
    """Impulses P (3,) forward, left and in yaw, in place: no more than friction gives."""
    aside = np.sqrt(P[0] ** 2 + P[1] ** 2)
    if aside > most:
        P[0] *= most / aside
        P[1] *= most / aside
    P[2] = min(most * reach, max(-most * reach, P[2]))


@compiled
def make_solver(M: Array, K: Array, D: Array, C: Array, h: float, rows: int) -> Solver:
    """The solver of a step of the trapezoidal rule of h [s], stable for any h.

    Args:
        M: (m + 6, m + 6) inertia.
        K, D: (m, m) stiffness and damping of the joints.
        C: (14, m + 6) constraints.
        rows: 7: of the support foot alone, or 14: of both.
    """
    m, size = K.shape[0], M.shape[0]
    A = M.copy()
    for i in range(m):
        for j in range(m):
            A[i, j] += 0.5 * h * D[i, j] + 0.25 * h * h * K[i, j]
    A = inverse_positive(A)
    soft = 4.0 * _SINKS / (9.81 * M[m + 2, m + 2] * h * (h + _RETURN))  # of a corner; M has the mass of the robot there
    by_impulse, contact = np.zeros((rows, size)), np.zeros((rows, rows))
    for i in range(rows):
        first = _first(i, m)
        for k in range(first, size):
            for j in range(size):
                by_impulse[i, j] += C[i, k] * A[k, j]  # A is symmetric
        for j in range(i + 1):
            for k in range(first, size):
                contact[i, j] += C[i, k] * by_impulse[j, k]
            contact[j, i] = contact[i, j]
        if i % ROWS < 4:
            contact[i, i] += soft
    return Solver(h, rows, A, by_impulse, contact)


@compiled
def _first(row: int, m: int) -> int:
    """The first coordinate that a constraint depends on: for those of the support foot it is its displacement."""
    return m if row < ROWS else 0


@compiled
def step_soles(
    state: State, linear: Linear, solver: Solver, theta_0: Array, theta_1: Array, parts: int, friction: float
) -> None:
    """Bring the joints of both legs and the support sole, in place, some steps of the solver further.

    Where the support sole is on the ground (x, y, yaw) does not matter and stays zero.

    Args:
        state: at the beginning; at the end, when it returns.
        linear: the equations of motion; the rate of the motors is not needed.
        solver: of the same sample.
        theta_0, theta_1: (m,) motor positions at the beginning and the end [rad].
        parts: how many steps of the solver.
        friction: coefficient.
    """
    y, w, P = state
    h, rows, m, size = solver.h, solver.rows, theta_0.shape[0], state.y.shape[0]
    push, faster, up, v = np.empty(size), np.empty(size), np.empty(rows), np.empty(rows)
    bent, turned = np.empty(m), np.empty(m)
    P[rows:] = 0.0
    for part in range(parts):
        for k in range(m):
            moved = (theta_1[k] - theta_0[k]) / parts
            bent[k] = h * (y[k] + 0.5 * h * w[k] - theta_0[k] - (part + 0.5) * moved)
            turned[k] = h * w[k] - moved
        for i in range(size):
            push[i], faster[i] = h * linear.f[i], w[i]
        for i in range(m):
            for k in range(m):
                push[i] -= linear.K[i, k] * bent[k] + linear.D[i, k] * turned[k]
        _add_rows(faster, solver.inverse, push, size)  # it is symmetric
        _constraints(linear, y, faster, h, up, v)
        impulses(solver.contact, v, up, P, friction, linear.reach[0], h * linear.most[0])
        _add_rows(faster, solver.by_impulse, P, rows)
        for i in range(size):
            y[i] += 0.5 * h * (w[i] + faster[i])
            w[i] = faster[i]
    y[m] = y[m + 1] = y[m + 5] = 0.0


@compiled
def _add_rows(y: Array, A: Array, x: Array, n: int) -> None:
    """Add the first n rows of A (n or more, k), times x (n,), to y (k,), in place."""
    for i in range(n):
        if x[i] != 0.0:  # a free corner has no impulse
            for j in range(y.shape[0]):
                y[j] += A[i, j] * x[i]


@compiled
def _constraints(linear: Linear, y: Array, w: Array, h: float, up: Array, v: Array) -> None:
    """Velocities v (r,) of the constraints at coordinates y with rates w, and those that corners must have, up (r,)."""
    size = y.shape[0]
    for i in range(v.shape[0]):
        height = linear.height[i]
        v[i] = up[i] = 0.0
        for k in range(_first(i, size - 6), size):
            height += linear.C[i, k] * (y[k] - linear.y[k])
            v[i] += linear.C[i, k] * w[k]
        if i % ROWS < 4:
            up[i] = -height / (h if height > 0.0 else h + _RETURN)


@compiled
def track(
    states: tuple[State, State], linear: Linear, M: Array, double: bool, theta_0: Array, theta_1: Array,
    measured: Array, dt: float, options: Options,
) -> bool:  # fmt: skip
    """Bring the filter of the measurement and the free run, both in place, to the next sample.

    The free run takes nothing of the measurement.

    Args:
        states: filter and free run at the last sample.
        linear, M: the equations of motion at this sample, with inertia M (m + 6, m + 6).
        double: whether the other foot may touch the ground.
        theta_0, theta_1: (m,) motor positions at the last sample and at this one [rad].
        measured: (m,) link positions [rad].
        dt: since the last sample [s].
        options: of the model.

    Returns:
        Whether the filter is finite.
    """
    parts = max(1, int(np.ceil(dt / options.longest - 1e-6)))
    solver = make_solver(M, linear.K, linear.D, linear.C, dt / parts, 2 * ROWS if double else ROWS)
    for state in states:
        step_soles(state, linear, solver, theta_0, theta_1, parts, options.friction)
    return correct(states[0], measured, options.bandwidth, dt)


@compiled
def correct(state: State, measured: Array, bandwidth: float, dt: float) -> bool:
    """Pull a state towards the measured joints (m,) [rad], in place, by a critically damped filter of that bandwidth.

    The support sole stands, so it is level on the ground, or will be soon. Returns whether the state is finite.
    """
    y, w, finite = state.y, state.w, True
    by_y, by_w = 1.0 - np.exp(-2.0 * bandwidth * dt), bandwidth**2 * dt * np.exp(-bandwidth * dt)
    for i in range(y.shape[0]):
        error = (measured[i] if i < measured.shape[0] else 0.0) - y[i]
        y[i] += by_y * error
        w[i] += by_w * error
        finite &= np.isfinite(y[i]) and np.isfinite(w[i])
    return finite


@compiled
def support_share(P: Array) -> float:
    """Share of the load on the support foot, 0..1, by the impulses P (14,) of the last step; half if there are none."""
    support, other = P[:4].sum(), P[ROWS : ROWS + 4].sum()
    return support / (support + other) if support + other > 0.0 else 0.5


@compiled
def switch_support(state: State, linear: Linear, edges: Array) -> State:
    """The same state with the other foot as the support foot: its leg's joints come first, its displacement last.

    Args:
        state: of the old support foot.
        linear: of the old support foot.
        edges: (4,) of the sole that becomes the support sole, as in `Sole`.
    """
    m = state.y.shape[0] - 6
    n = m // 2
    heights, rates = linear.height + apply(linear.C, state.y - linear.y), apply(linear.C, state.w)
    y, w = np.zeros(m + 6), np.zeros(m + 6)
    y[:n], y[n:m], w[:n], w[n:m] = state.y[n:m], state.y[:n], state.w[n:m], state.w[:n]
    _displace(y[m:], heights[ROWS : ROWS + 4], edges)
    _displace(w[m:], rates[ROWS : ROWS + 4], edges)
    return State(y, w, np.concatenate((state.P[ROWS:], state.P[:ROWS])))


@compiled
def _displace(s: Array, corners: Array, edges: Array) -> None:
    """Height, roll and pitch of a sole into its displacement s (6,), in place, by the heights of its corners (4,)."""
    back, front, right = corners[0] + corners[2], corners[1] + corners[3], corners[0] + corners[1]
    left = back + front - right
    roll, pitch = 0.5 * (left - right) / (edges[3] - edges[2]), 0.5 * (back - front) / (edges[1] - edges[0])
    s[2] = 0.25 * (back + front) - 0.5 * (roll * (edges[2] + edges[3]) - pitch * (edges[0] + edges[1]))
    s[3], s[4] = roll, pitch
