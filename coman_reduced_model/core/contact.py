# SPDX-License-Identifier: BSD-3-Clause
"""Both soles on the ground, which can only press on them and hold them no more than friction does.

A foot touches the ground with its corners. One that has just landed, or is about to leave, stands on an edge or a
corner; one that is flat is held by all four. Nothing else tells how the load passes from leg to leg.
"""

from __future__ import annotations

import numpy as np

from .compiled import apply, compiled, inverse_positive, mul
from .types import Array

ROWS = 7  # constraints of a foot: its four corners up, its middle forward and left, its turning
_ROUNDS = 50  # of the iteration for the impulses, at most
_ENOUGH = 1e-3  # of the largest impulse: no corner's impulse changes by more in the last round
_SOFT = 0.02  # of the ground beside the foot: four corners under one rigid sole share the load alike
_RETURN = 0.02  # [s] in which a sole that is below the ground comes up


@compiled
def contacts(
    V: Array, R_s: Array, p_s: Array, V_o: Array, R_o: Array, p_o: Array, sole_s: Array, sole_o: Array, s: Array
) -> tuple[Array, Array, Array]:
    """Velocities of both soles against the ground, and where their corners are.

    Args:
        V, V_o: (6, n), (6, k) `trunk_twist` of the support leg and of the other one.
        R_s, p_s, R_o, p_o: pose of their soles in the base frame.
        sole_s, sole_o: (4,) x of the back and the front, y of the right and the left edge [m].
        s: (6,) small displacement of the support sole from level ground, in its axes [m], [rad].

    Returns:
        A (6, 6) twist of the trunk, in base axes at the base origin, by that of the support sole in its own; C (14, n +
        k + 6) velocities of the constraints of both feet by the joints and the support sole; heights (14,) of the
        corners [m], zero for the other constraints.
    """
    n, k = V.shape[1], V_o.shape[1]
    m = n + k
    A = np.zeros((6, 6))
    for j in range(3):
        w = R_s[:, j]
        for i in range(3):
            A[i, j] = w[i]
            A[3 + i, 3 + j] = w[i]
        A[0, 3 + j] = p_s[1] * w[2] - p_s[2] * w[1]
        A[1, 3 + j] = p_s[2] * w[0] - p_s[0] * w[2]
        A[2, 3 + j] = p_s[0] * w[1] - p_s[1] * w[0]
    T = np.zeros((6, m + 6))  # twist of the other sole against the ground, base axes, at the base origin
    for i in range(6):
        for j in range(n):
            T[i, j] = V[i, j]
        for j in range(k):
            T[i, n + j] = -V_o[i, j]
        for j in range(6):
            T[i, m + j] = A[i, j]
    C, height = np.zeros((2 * ROWS, m + 6)), np.zeros(2 * ROWS)
    for corner in range(4):
        x, y = sole_s[corner % 2], sole_s[2 + corner // 2]
        C[corner, m + 2], C[corner, m + 3], C[corner, m + 4] = 1.0, y, -x
        height[corner] = s[2] + s[3] * y - s[4] * x
    x, y = 0.5 * (sole_s[0] + sole_s[1]), 0.5 * (sole_s[2] + sole_s[3])
    C[4, m], C[4, m + 5] = 1.0, -y
    C[5, m + 1], C[5, m + 5] = 1.0, x
    C[6, m + 5] = 1.0
    r, c, P = np.zeros(3), np.zeros(3), np.zeros(3)
    for row in range(5):
        if row < 4:
            r[0], r[1] = sole_o[row % 2], sole_o[2 + row // 2]
        else:
            r[0], r[1] = 0.5 * (sole_o[0] + sole_o[1]), 0.5 * (sole_o[2] + sole_o[3])
        for i in range(3):
            c[i] = p_o[i] + R_o[i, 0] * r[0] + R_o[i, 1] * r[1]
        for i in range(3):
            P[i] = R_s[0, i] * (c[0] - p_s[0]) + R_s[1, i] * (c[1] - p_s[1]) + R_s[2, i] * (c[2] - p_s[2])
        if row < 4:
            height[ROWS + row] = P[2] + s[2] + s[3] * P[1] - s[4] * P[0]
        for j in range(m + 6):
            v0 = T[0, j] + T[4, j] * c[2] - T[5, j] * c[1]
            v1 = T[1, j] + T[5, j] * c[0] - T[3, j] * c[2]
            v2 = T[2, j] + T[3, j] * c[1] - T[4, j] * c[0]
            if row < 4:
                C[ROWS + row, j] = R_s[0, 2] * v0 + R_s[1, 2] * v1 + R_s[2, 2] * v2
            else:
                C[ROWS + 4, j] = R_s[0, 0] * v0 + R_s[1, 0] * v1 + R_s[2, 0] * v2
                C[ROWS + 5, j] = R_s[0, 1] * v0 + R_s[1, 1] * v1 + R_s[2, 1] * v2
                C[ROWS + 6, j] = R_s[0, 2] * T[3, j] + R_s[1, 2] * T[4, j] + R_s[2, 2] * T[5, j]
    return A, C, height


@compiled
def impulses(W: Array, v: Array, up: Array, P: Array, friction: float, reach: float) -> None:
    """Impulses P of the ground in one step, in place: the last ones come in.

    Args:
        W: (r, r) velocities of the constraints by impulses, r = 7 or 14.
        v: (r,) velocities at the end of the step without any impulse.
        up: (r,) velocities that corners must have at least; zero for the other constraints, which stick if they can.
        P: (r,) or more [Ns], [Nms].
        friction: coefficient.
        reach: lever at which friction resists twisting [m].
    """
    rows = v.shape[0]
    for _ in range(_ROUNDS):
        largest = changed = 0.0
        for first in range(0, rows, ROWS):
            pressing = 0.0
            for i in range(first, first + 4):
                if W[i, i] > 0.0:
                    u = v[i] - up[i] + _SOFT * W[i, i] * P[i]
                    for j in range(rows):
                        u += W[i, j] * P[j]
                    new = max(0.0, P[i] - u / (W[i, i] * (1.0 + _SOFT)))
                    largest, changed = max(largest, new), max(changed, abs(new - P[i]))
                    P[i] = new
                pressing += P[i]
            for i in range(first + 4, first + 7):
                u = v[i]
                for j in range(rows):
                    u += W[i, j] * P[j]
                P[i] -= u / W[i, i]
            most = friction * pressing
            aside = np.sqrt(P[first + 4] ** 2 + P[first + 5] ** 2)
            if aside > most:
                P[first + 4] *= most / aside
                P[first + 5] *= most / aside
            P[first + 6] = min(most * reach, max(-most * reach, P[first + 6]))
        if changed <= _ENOUGH * largest:
            break


@compiled
def solve_step(M: Array, K: Array, D: Array, C: Array, h: float) -> tuple[Array, Array, Array]:
    """What a step of the trapezoidal rule of h [s] needs, stable for any h: the same for all states of one sample.

    Args:
        M: (m + 6, m + 6) inertia.
        K, D: (m, m) stiffness and damping of the joints.
        C: (r, m + 6) from `contacts`.

    Returns:
        (M + h/2 D + h^2/4 K)^-1; how all velocities (m + 6, r) and those of the constraints (r, r) answer impulses.
    """
    A = M.copy()
    for i in range(K.shape[0]):
        for j in range(K.shape[0]):
            A[i, j] += 0.5 * h * D[i, j] + 0.25 * h * h * K[i, j]
    A = inverse_positive(A)
    AC = mul(A, C.T.copy())
    return A, AC, mul(C, AC)


@compiled
def step_soles(
    y: Array, w: Array, P: Array, h: float, parts: int, A: Array, AC: Array, W: Array, K: Array, D: Array, f: Array,
    theta_0: Array, theta_1: Array, C: Array, height: Array, y_t: Array, friction: float, reach: float,
) -> tuple[Array, Array]:  # fmt: skip
    """The joints of both legs and the support sole some steps later.

    M x'' + D (x' - theta') + K (x - theta) = f + what the ground does; the rate of the motors is not needed.

    Args:
        y, w: (m + 6,) link positions [rad], the support leg's first, and displacement of its sole [m], [rad]; rates.
        P: (14,) impulses of the step before, where the search for those of the next begins; replaced in place.
        h, parts: of the steps [s], and how many.
        A, AC, W: from `solve_step`, with r = 7 constraints of the support foot, or 14 of both.
        K, D: (m, m) stiffness and damping.
        f: (m + 6,) all other forces.
        theta_0, theta_1: (m,) motor positions at the beginning and the end.
        C, height: (14, m + 6), (14,) from `contacts`, at y_t (m + 6,).
        friction, reach: see `impulses`.

    Returns:
        y and w at the end. Where the support sole is on the ground does not matter and stays zero.
    """
    m, size, rows = theta_0.shape[0], y.shape[0], W.shape[0]
    y, w = y.copy(), w.copy()
    moved = (theta_1 - theta_0) / parts
    up, v, rest = np.zeros(rows), np.zeros(rows), np.zeros(size)
    P[rows:] = 0.0
    for part in range(parts):
        pull = apply(K, y[:m] + 0.5 * h * w[:m] - theta_0 - (part + 0.5) * moved)
        slow = apply(D, h * w[:m] - moved)
        for i in range(size):
            rest[i] = h * f[i]
            if i < m:
                rest[i] -= h * pull[i] + slow[i]
        faster = w + apply(A, rest)
        for i in range(rows):
            gap, v[i] = height[i], 0.0
            for j in range(size):
                gap += C[i, j] * (y[j] - y_t[j])
                v[i] += C[i, j] * faster[j]
            if i % ROWS < 4:
                up[i] = -gap / (h if gap > 0.0 else _RETURN)
        impulses(W, v, up, P, friction, reach)
        for i in range(size):
            for j in range(rows):
                faster[i] += AC[i, j] * P[j]
            y[i] += 0.5 * h * (w[i] + faster[i])
        w = faster
    y[m] = y[m + 1] = y[m + 5] = 0.0
    return y, w


@compiled
def track(
    filtered: Array, free: Array, P: Array, measured: Array, dt: float, longest: float, bandwidth: float,
    double: bool, M: Array, K: Array, D: Array, f: Array, theta_0: Array, theta_1: Array, C: Array,
    height: Array, y_t: Array, friction: float, reach: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Bring the filter of the measurement and the free run to a sample.

    Args:
        filtered, free: (2, m + 6) y and w as in `step_soles`.
        P: (2, 14) the impulses of both, in place.
        measured: (m,) link positions [rad].
        dt, longest: since the last sample, and of a step at most [s].
        bandwidth: of the filter [rad/s].
        double: whether the other foot may touch the ground.
        M: (m + 6, m + 6) inertia.
        K, D, f, theta_0, theta_1, C, height, y_t, friction, reach: as in `step_soles`.

    Returns:
        Filter and free run (2, m + 6) at the sample. The free run takes nothing of the measurement.
    """
    m, size = theta_0.shape[0], y_t.shape[0]
    parts = max(1, int(np.ceil(dt / longest - 1e-6)))
    h = dt / parts
    A, AC, W = solve_step(M, K, D, C if double else C[:ROWS], h)
    out = np.empty((2, 2, size))
    for k in range(2):
        state = free if k else filtered
        y, w = step_soles(
            state[0], state[1], P[k], h, parts, A, AC, W, K, D, f, theta_0, theta_1, C, height, y_t, friction, reach,
        )  # fmt: skip
        if k == 0:
            for i in range(size):  # the support sole stands, so it is level on the ground, or will be soon
                error = (measured[i] if i < m else 0.0) - y[i]
                y[i] += (1.0 - np.exp(-2.0 * bandwidth * dt)) * error
                w[i] += bandwidth**2 * dt * np.exp(-bandwidth * dt) * error
        out[k, 0], out[k, 1] = y, w
    return out[0], out[1]


@compiled
def support_share(P: Array) -> float:
    """Share of the load on the support foot, 0..1, by the impulses P (14,) of the last step; half if there are none."""
    support, other = P[:4].sum(), P[ROWS : ROWS + 4].sum()
    return support / (support + other) if support + other > 0.0 else 0.5


@compiled
def by_other(
    y: Array, w: Array, P: Array, C: Array, height: Array, y_t: Array, sole: Array
) -> tuple[Array, Array, Array]:
    """A state told by the other sole: its leg's joints come first then, and its own displacement last.

    Args:
        y, w, P: as in `step_soles`.
        C, height: (14, m + 6), (14,) at y_t.
        sole: (4,) of the other foot, as in `contacts`.
    """
    m = y.shape[0] - 6
    n = m // 2
    out = np.zeros((2, m + 6))
    for k in range(2):
        at = apply(C, w) if k else height + apply(C, y - y_t)
        out[k, :n], out[k, n:m] = (w[n:m], w[:n]) if k else (y[n:m], y[:n])
        back, front, right, left = at[ROWS] + at[ROWS + 2], at[ROWS + 1] + at[ROWS + 3], at[ROWS] + at[ROWS + 1], 0.0
        left = back + front - right
        roll, pitch = 0.5 * (left - right) / (sole[3] - sole[2]), 0.5 * (back - front) / (sole[1] - sole[0])
        out[k, m + 2] = 0.25 * (back + front) - 0.5 * (roll * (sole[2] + sole[3]) - pitch * (sole[0] + sole[1]))
        out[k, m + 3], out[k, m + 4] = roll, pitch
    return out[0], out[1], np.concatenate((P[ROWS:], P[:ROWS]))
