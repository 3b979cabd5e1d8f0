# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of the trunk on its legs, with all six freedoms (`trunk_model` tells the physics)."""

from __future__ import annotations

import numpy as np

from .compiled import apply, compiled, inverse, mul, pick
from .integrator import advance, transition
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
    Y: Array, mass: float, com: Array, rate: Array, J_s: Array, R_s: Array, p_s: Array, columns_s: Array,
    J_o: Array, R_o: Array, p_o: Array, columns_o: Array, double: bool, R_so: Array, p_so: Array,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """How the trunk and the other leg move with the joints of the support leg.

    Args:
        Y: (nv, nv) joint-space inertia with a free base, upper triangle.
        mass: [kg].
        com: (3,) in the base frame [m].
        rate: (nv,) joint velocities, base at rest [rad/s].
        J_s, R_s, p_s, columns_s: support leg: (6, nv) sole Jacobian, pose of the sole in the base frame, columns (n,).
        J_o, R_o, p_o, columns_o: the same of the other leg (k joints).
        double: whether the other leg stands.
        R_so, p_so: where its sole then stands in the frame of the support sole.

    Returns:
        V (6, n) twist of the trunk; its twists (2, 6) by `rate`, the one or the other sole held still; J (6, n) and
        J_o (6, k) of the COM, each in the axes of its sole; B (k, n) other leg's joints by those of the support leg;
        d_other, d_other_rate (k,) deflection of the other leg for none of the support leg. k is 0 unless double.
    """
    J_com = Y[:3] / mass  # the base is the origin of the axes in which the momentum is told
    V, V_o = trunk_twist(J_s, columns_s, p_s), trunk_twist(J_o, columns_o, p_o)
    rate_s, rate_o = pick(rate, columns_s), pick(rate, columns_o)
    twists = np.empty((2, 6))
    twists[0], twists[1] = apply(V, rate_s), apply(V_o, rate_o)
    J = com_jacobian(V, columns_s, J_com, com, R_s)
    if not double:
        return V, twists, J, np.zeros((6, 0)), np.zeros((0, V.shape[1])), np.zeros(0), np.zeros(0), V_o
    J_other = com_jacobian(V_o, columns_o, J_com, com, R_o)
    B = mul(leg_inverse(V_o), V)
    d_other = closure(V_o, R_s, p_s, R_o, p_o, R_so, p_so)
    d_other_rate = apply(B, rate_s)
    for i in range(d_other_rate.shape[0]):
        d_other_rate[i] -= rate_o[i]
    return V, twists, J, J_other, B, d_other, d_other_rate, V_o


@compiled
def carried(
    Y: Array, tau: Array, down: Array, V: Array, columns: Array, B: Array, other: Array
) -> tuple[Array, Array, Array]:
    """Inertia (n, n) [kg m^2] that the joints of the support leg feel, and torques (n,) [Nm] there, of all links.

    Args:
        Y: (nv, nv) joint-space inertia with a free base, upper triangle.
        tau: (nv,) generalised forces of the reference motion without gravity.
        down: (3,) gravity in base axes [m/s^2].
        V: (6, n) twist of the trunk by the joints of the support leg.
        columns: (n,) of the support leg in Y.
        B: (k, n) motion of the other leg's joints by those of the support leg; k is 0 in single support.
        other: columns of the other leg.

    Returns:
        M, the torques of tau, and those of the weight.
    """
    n, k = columns.shape[0], B.shape[0]
    rows = 6 + n + k
    index = np.empty(rows, dtype=np.int64)
    N = np.zeros((rows, n))
    for i in range(6):
        index[i] = i
        N[i] = V[i]
    for i in range(n):
        index[6 + i] = columns[i]
        N[6 + i, i] = 1.0
    for i in range(k):
        index[6 + n + i] = other[i]
        N[6 + n + i] = B[i]
    S, torque, weight = np.empty((rows, rows)), np.zeros(n), np.zeros(n)
    for i in range(rows):
        for j in range(rows):
            a, b = index[i], index[j]
            S[i, j] = Y[a, b] if a <= b else Y[b, a]
    for i in range(rows):
        pull = 0.0
        for j in range(3):
            pull -= S[j, i] * down[j]
        for j in range(n):
            torque[j] += N[i, j] * tau[index[i]]
            weight[j] += N[i, j] * pull
    return mul(N.T, mul(S, N)), torque, weight


@compiled
def coast(state: Array, M_inv: Array, K: Array, D: Array, u: Array, horizons: Array) -> Array:
    """How far the deflections move (k, n) by each horizon (k,) ascending [s], under a force (n,) that stays."""
    n = u.shape[0]
    moved = np.empty((horizons.shape[0], n))
    z, start = state, 0.0
    E, G_0, G_1 = transition(M_inv, K, D, horizons[0])
    for i in range(horizons.shape[0]):
        steps = round((horizons[i] - start) / horizons[0])
        if abs(start + steps * horizons[0] - horizons[i]) < 1e-9:  # a multiple of the first one: the same step again
            for _ in range(steps):
                z = advance(z, E, G_0, G_1, u, u)
        else:
            z = advance(z, *transition(M_inv, K, D, horizons[i] - start), u, u)
        moved[i] = z[:n] - state[:n]
        start = horizons[i]
    return moved
