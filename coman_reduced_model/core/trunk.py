# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of the trunk on its legs, with all six freedoms (`trunk_model` tells the physics)."""

from __future__ import annotations

import numpy as np

from .compiled import apply, compiled, inverse, mul
from .types import Array


@compiled
def trunk_twist(J_sole: Array, columns: Array, p: Array) -> Array:
    """(6, n) twist of the trunk against a sole at rest, in base axes at the base origin, by the joints of the leg.

    Args:
        J_sole: (6, nv) velocity of the sole against the trunk, base axes, at the sole.
        columns: (n,) of the leg's joints.
        p: (3,) of the sole in the base frame [m].
    """
    n = columns.shape[0]
    V = np.empty((6, n))
    for i in range(n):
        c = columns[i]
        w0, w1, w2 = J_sole[3, c], J_sole[4, c], J_sole[5, c]
        V[0, i] = -J_sole[0, c] - (p[1] * w2 - p[2] * w1)
        V[1, i] = -J_sole[1, c] - (p[2] * w0 - p[0] * w2)
        V[2, i] = -J_sole[2, c] - (p[0] * w1 - p[1] * w0)
        V[3, i], V[4, i], V[5, i] = -w0, -w1, -w2
    return V


@compiled
def com_jacobian(V: Array, columns: Array, J_com: Array, com: Array, R: Array) -> Array:
    """(6, n) velocity of the COM and angular velocity of the trunk, in sole axes, by the joints of a leg.

    Unlike (8) the COM is that of all links: the links of the leg itself move less than the trunk.

    Args:
        V: from `trunk_twist`.
        columns: (n,) of the leg's joints.
        J_com: (3, nv) of the COM against the trunk, base axes.
        com: (3,) in the base frame [m].
        R: (3, 3) orientation of the sole in the base frame.
    """
    n = columns.shape[0]
    J = np.empty((6, n))
    for i in range(n):
        c = columns[i]
        a0 = V[0, i] + V[4, i] * com[2] - V[5, i] * com[1] + J_com[0, c]
        a1 = V[1, i] + V[5, i] * com[0] - V[3, i] * com[2] + J_com[1, c]
        a2 = V[2, i] + V[3, i] * com[1] - V[4, i] * com[0] + J_com[2, c]
        for k in range(3):
            J[k, i] = R[0, k] * a0 + R[1, k] * a1 + R[2, k] * a2
            J[3 + k, i] = R[0, k] * V[3, i] + R[1, k] * V[4, i] + R[2, k] * V[5, i]
    return J


@compiled
def closure(V_other: Array, R_s: Array, p_s: Array, R_o: Array, p_o: Array, R_so: Array, p_so: Array) -> Array:
    """Deflection (n,) [rad] that the joints of the other leg need for its sole to stand where it stands.

    Args:
        V_other: (6, n) `trunk_twist` of the other leg.
        R_s, p_s, R_o, p_o: soles of the support leg and the other leg in the base frame, by forward kinematics.
        R_so, p_so: where the other sole stands in the frame of the support sole.
    """
    R_want = mul(R_s, R_so)
    p_want = p_s + apply(R_s, p_so)
    R_e = mul(R_want, R_o.T)
    p_e = p_want - apply(R_e, p_o)
    w = np.array([R_e[2, 1] - R_e[1, 2], R_e[0, 2] - R_e[2, 0], R_e[1, 0] - R_e[0, 1]]) * 0.5
    sine = np.sqrt((w * w).sum())
    if sine > 1e-9:
        w *= np.arcsin(min(1.0, sine)) / sine
    xi = np.empty(6)  # small motion of the sole against the trunk, at the base origin
    xi[0] = p_e[0] - 0.5 * (w[1] * p_e[2] - w[2] * p_e[1])
    xi[1] = p_e[1] - 0.5 * (w[2] * p_e[0] - w[0] * p_e[2])
    xi[2] = p_e[2] - 0.5 * (w[0] * p_e[1] - w[1] * p_e[0])
    xi[3:] = w
    return apply(leg_inverse(V_other), -xi)


@compiled
def leg_inverse(V: Array) -> Array:
    """Joint motion of a leg by that of the trunk: the inverse (n, 6) of V (6, n), damped at singular postures."""
    A = mul(V.T, V)
    for i in range(A.shape[0]):
        A[i, i] += 1e-6
    return mul(inverse(A), V.T)


@compiled
def geometry(
    Y: Array, mass: float, com: Array, J_s: Array, R_s: Array, p_s: Array, columns_s: Array,
    J_o: Array, R_o: Array, p_o: Array, columns_o: Array, R_so: Array, p_so: Array,
) -> tuple[Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """How trunk, COM and the other leg move with the joints of the support leg (n) and the other one (k).

    Args:
        Y: (nv, nv) joint-space inertia with a free base, upper triangle.
        mass: [kg].
        com: (3,) in the base frame [m].
        J_s, R_s, p_s, columns_s: support leg: (6, nv) sole Jacobian, pose of the sole in the base frame, columns (n,).
        J_o, R_o, p_o, columns_o: the same of the other leg.
        R_so, p_so: where its sole stands in the frame of the support sole, if it does.

    Returns:
        V (6, n), V_o (6, k) twist of the trunk by either leg; J (6, n + k) velocity of the COM and angular velocity of
        the trunk in the axes of the support sole; J_o (6, k) the same by the other leg in the axes of its sole; and
        for a sole that stands B (k, n), motion of the other leg by that of the support leg, and (k,) how far its
        joints are from where they must be [rad].
    """
    n, k = columns_s.shape[0], columns_o.shape[0]
    J_com = Y[:3] / mass  # the base is the origin of the axes in which the momentum is told
    V, V_o = trunk_twist(J_s, columns_s, p_s), trunk_twist(J_o, columns_o, p_o)
    J = np.zeros((6, n + k))
    J[:, :n] = com_jacobian(V, columns_s, J_com, com, R_s)
    for i in range(3):
        for c in range(k):
            for j in range(3):
                J[i, n + c] += R_s[j, i] * J_com[j, columns_o[c]]
    J_other = com_jacobian(V_o, columns_o, J_com, com, R_o)
    return V, V_o, J, J_other, mul(leg_inverse(V_o), V), closure(V_o, R_s, p_s, R_o, p_o, R_so, p_so)


@compiled
def carried(Y: Array, tau: Array, down: Array, V: Array, columns: Array, other: Array) -> tuple[Array, Array, Array]:
    """Inertia (m, m) [kg m^2] that the joints of both legs feel while the support sole stands, and their torques [Nm].

    The support leg's n joints come first, then the other leg's; m of them.

    Args:
        Y: (nv, nv) joint-space inertia with a free base, upper triangle.
        tau: (nv,) generalised forces of the reference motion without gravity.
        down: (3,) gravity in base axes [m/s^2].
        V: (6, n) twist of the trunk by the joints of the support leg.
        columns: (n,) of the support leg in Y.
        other: of the other leg.

    Returns:
        M, the torques (m,) of tau, and those of the weight.
    """
    n, k = columns.shape[0], other.shape[0]
    index = np.empty(6 + n + k, dtype=np.int64)
    for i in range(6):
        index[i] = i
    for i in range(n):
        index[6 + i] = columns[i]
    for i in range(k):
        index[6 + n + i] = other[i]
    rows, m = 6 + n + k, n + k
    S, torque, weight = np.empty((rows, rows)), np.zeros(m), np.zeros(m)
    for i in range(rows):
        for j in range(rows):
            a, b = index[i], index[j]
            S[i, j] = Y[a, b] if a <= b else Y[b, a]
    for i in range(m):
        torque[i] = tau[index[6 + i]]
        for j in range(3):
            weight[i] -= S[j, 6 + i] * down[j]
    for i in range(6):
        pull = 0.0
        for j in range(3):
            pull -= S[j, i] * down[j]
        for j in range(n):
            torque[j] += V[i, j] * tau[i]
            weight[j] += V[i, j] * pull
    # N^T S N with N = [V 0; 1]: the base follows the support leg.
    SN = np.empty((rows, m))
    for i in range(rows):
        for j in range(m):
            SN[i, j] = S[i, 6 + j]
            if j < n:
                for b in range(6):
                    SN[i, j] += S[i, b] * V[b, j]
    M = np.empty((m, m))
    for i in range(m):
        for j in range(m):
            M[i, j] = SN[6 + i, j]
            if i < n:
                for b in range(6):
                    M[i, j] += V[b, i] * SN[b, j]
    return M, torque, weight


@compiled
def edges(sole: Array) -> Array:
    """Twists (4, 6) at the sole origin, in sole axes, of a sole that turns about its front, back, left and right edge.

    `sole`: x of the back and the front, y of the right and the left edge (4,) [m].
    """
    T = np.zeros((4, 6))
    T[0, 2], T[0, 4] = sole[1], 1.0
    T[1, 2], T[1, 4] = -sole[0], -1.0
    T[2, 2], T[2, 3] = sole[3], -1.0
    T[3, 2], T[3, 3] = -sole[2], 1.0
    return T


@compiled
def lifts(V: Array, R: Array, p: Array, sole: Array) -> Array:
    """Joint motions (n, 8) of a leg that turn its sole about each of its `edges`, lift, slide or twist it.

    The trunk stays. Columns: four edges, up, forward, left, about the vertical.

    Args:
        V: (6, n) `trunk_twist` of the leg.
        R, p: pose of its sole in the base frame.
        sole: the edges.
    """
    T = np.zeros((8, 6))
    T[:4] = edges(sole)
    T[4, 2] = T[5, 0] = T[6, 1] = T[7, 5] = 1.0
    T[7, 1] = 0.5 * (sole[0] + sole[1])  # about the middle of the sole
    T[7, 1] *= -1.0
    twist = np.zeros((6, 8))
    for e in range(8):
        v, w = apply(R, T[e, :3]), apply(R, T[e, 3:])
        twist[0, e] = v[0] + p[1] * w[2] - p[2] * w[1]
        twist[1, e] = v[1] + p[2] * w[0] - p[0] * w[2]
        twist[2, e] = v[2] + p[0] * w[1] - p[1] * w[0]
        twist[3:, e] = w
    return -mul(leg_inverse(V), twist)


@compiled
def without(K: Array, A: Array, part: float) -> Array:
    """1 - part K A (A^T K A)^-1 A^T: what is left of torques when motions A (n, a) are free (part = 1) or yield."""
    KA = mul(K, A)
    P = mul(KA, mul(inverse(mul(A.T, KA)), A.T))
    for i in range(P.shape[0]):
        for j in range(P.shape[0]):
            P[i, j] *= -part
        P[i, i] += 1.0
    return P


@compiled
def stand(K: Array, torque: Array, H: Array, friction: float, reach: float) -> tuple[Array, int]:
    """What a foot that can only press on the ground, within its sole, leaves of the springs of its leg.

    Where the springs would need a moment beyond an edge the foot turns about that edge, without resistance; where they
    would push it aside with more than friction holds it slides; where they would need a pull it is not held at all.
    With r the torques of the springs and tau those that the joints need for the leg's own weight and motion
    P r - (1 - P) tau is left, and P K P^T of the stiffness.

    Args:
        K: (n, n) stiffness of the joints.
        torque: (n,) r + tau with the foot flat on the ground: J^T times the reaction of the ground.
        H: from `lifts`.
        friction: coefficient between sole and ground.
        reach: lever at which friction resists twisting [m].

    Returns:
        P (n, n), and which constraints are left: a bit for each edge about which it turns; 16: none.
    """
    n = K.shape[0]
    P = np.eye(n)
    need = apply(H.T, torque)  # power of the reaction: moments about the edges, vertical force, ...
    free = 0
    for _ in range(4):
        if need[4] <= 0.0:
            return np.zeros((n, n)), 16
        worst, found = -1e-9, -1
        for e in range(4):
            if not free & (1 << e) and need[e] < worst:
                worst, found = need[e], e
        if found < 0:
            break
        free = (free | 1 << found) & ~(1 << (found ^ 1))
        A = np.zeros((n, 2))
        k = 0
        for e in range(4):
            if free & (1 << e):
                A[:, k] = H[:, e]
                k += 1
        P = without(K, A[:, :k].copy(), 1.0)
        need = apply(H.T, apply(P, torque))
    if need[4] <= 0.0:
        return np.zeros((n, n)), 16
    held = need
    aside = np.sqrt(need[5] ** 2 + need[6] ** 2 + (need[7] / reach) ** 2)
    P_held, K_held = P, K
    for k in range(3):  # sliding changes the pressure, and with it what friction holds
        kept = friction * max(0.0, held[4]) / aside
        if k == 0:
            if kept >= 1.0:
                break
            K_held = mul(mul(P, K), P.T)
        P = mul(without(K_held, H[:, 5:].copy(), 1.0 - min(1.0, kept)), P_held)
        held = apply(H.T, apply(P, torque))
        if held[4] <= 0.0:
            return np.zeros((n, n)), 16
    return P, free


@compiled
def implicit(M: Array, D: Array, K: Array, h: float) -> Array:
    """(M + h/2 D + h^2/4 K)^-1: what a step of the trapezoidal rule needs, stable for any h [s]."""
    A = M.copy()
    for i in range(M.shape[0]):
        for j in range(M.shape[0]):
            A[i, j] += 0.5 * h * D[i, j] + 0.25 * h * h * K[i, j]
    return inverse(A)


@compiled
def trapezoid(
    x: Array, w: Array, A: Array, D: Array, K: Array, f: Array, theta: Array, moved: Array, h: float
) -> tuple[Array, Array]:
    """One step of M x'' + D (x' - theta') + K (x - theta) = f by the trapezoidal rule.

    Args:
        x, w: (n,) positions [rad] and velocities at the beginning.
        A: from `implicit`.
        f: (n,) mean force over the step.
        theta, moved: (n,) mean position of the motors over the step, and how far they move in it: no rate is needed.
        h: [s].
    """
    rest = h * (f - apply(K, x + 0.5 * h * w - theta)) - apply(D, h * w - moved)
    faster = w + apply(A, rest)
    return x + 0.5 * h * (w + faster), faster


@compiled
def step_legs(
    x: Array, w: Array, dt: float, longest: float, double: bool, M: Array, K: Array, D: Array, f: Array,
    theta_0: Array, theta_1: Array, B: Array, held: Array, H: Array, friction: float, reach: float,
) -> tuple[Array, Array, int]:  # fmt: skip
    """One step of the joints of both legs, in parts short enough for the contact of the other foot to change.

    Args:
        x, w: (m,) link positions [rad] and velocities, the n joints of the support leg first.
        dt, longest: of the step, and of its parts at most [s].
        double: whether the other foot is on the ground, as far as it presses on it.
        M, K, D: (m, m) inertia, stiffness and damping, the latter without coupling between the legs.
        f: (m,) all other torques.
        theta_0, theta_1: (m,) motor positions at the beginning and the end.
        B: (k, n) other leg's joints by those of the support leg while both soles stand.
        held: (k,) positions of the other leg's joints then, for none of the support leg.
        H, friction, reach: see `stand`.

    Returns:
        x and w at the end, and what `stand` says of the other foot in the last part (16 in single support).
    """
    n = B.shape[1]
    x, w = x.copy(), w.copy()
    parts = max(1, int(np.ceil(dt / longest - 1e-6)))
    h = dt / parts
    moved = (theta_1 - theta_0) / parts
    code = 16
    if not double:
        A = implicit(M, D, K, h)
        for part in range(parts):
            x, w = trapezoid(x, w, A, D, K, f, theta_0 + (part + 0.5) * moved, moved, h)
        return x, w, code
    K_o, D_o = K[n:, n:].copy(), D[n:, n:].copy()
    M_so = mul(M[:n, n:], B)
    M_c = M[:n, :n] + M_so + M_so.T + mul(B.T, mul(M[n:, n:], B))
    for part in range(parts):
        theta = theta_0 + (part + 0.5) * moved
        off, turning = held + apply(B, x[:n]) - theta[n:], apply(B, w[:n]) - moved[n:] / h
        P, code = stand(K_o, apply(K_o, off) + apply(D_o, turning) - f[n:], H, friction, reach)
        # In the joints of the support leg: of the other leg's torques the part P acts, the rest the ground carries.
        BP = mul(B.T, P)
        KP, DP = mul(mul(BP, K_o), P.T), mul(mul(BP, D_o), P.T)
        K_c, D_c = K[:n, :n] + mul(KP, B), D[:n, :n] + mul(DP, B)
        # Its springs pull towards its own motors instead of those of the support leg.
        f_c = f[:n] + apply(BP, f[n:]) + apply(KP, theta[n:] - held - apply(B, theta[:n]))
        f_c += apply(DP, moved[n:] - apply(B, moved[:n])) / h
        x_s, w_s = trapezoid(x[:n], w[:n], implicit(M_c, D_c, K_c, h), D_c, K_c, f_c, theta[:n], moved[:n], h)
        x[:n], w[:n] = x_s, w_s
        x[n:], w[n:] = held + apply(B, x_s), apply(B, w_s)
    return x, w, code
