# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of the trunk on its legs, with all six freedoms (`trunk_model` tells the physics)."""

from __future__ import annotations

import numpy as np

from .compiled import compiled, mul
from .contact import contacts
from .robot import tilt
from .stiffness import topple
from .types import Array


@compiled
def trunk_twist(J_joints: Array, columns: Array) -> Array:
    """(6, n) twist of the trunk against a sole at rest, in base axes at the base origin, by the joints of the leg.

    Args:
        J_joints: (6, nv) of `Posture`: what the joints carry moves so against the trunk, the trunk the other way.
        columns: (n,) of the leg's joints.
    """
    V = np.empty((6, columns.shape[0]))
    for i in range(6):
        for j in range(columns.shape[0]):
            V[i, j] = -J_joints[i, columns[j]]
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
def geometry(
    Y: Array, mass: float, com: Array, J_joints: Array, R_s: Array, p_s: Array, columns_s: Array, sole_s: Array,
    R_o: Array, p_o: Array, columns_o: Array, sole_o: Array, y: Array, w: Array, V_before: Array, A_before: Array,
    dt: float, v: Array, a: Array,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """How trunk, COM and soles move with the joints of the support leg (n) and the other one (k), m of them.

    Args:
        Y: (nv, nv) joint-space inertia with a free base, upper triangle.
        mass: [kg].
        com: (3,) in the base frame [m].
        J_joints: (6, nv) of `Posture`.
        R_s, p_s, columns_s, sole_s: support leg: pose of the sole in the base frame, columns (n,), edges of the sole
            (4,).
        R_o, p_o, columns_o, sole_o: the same of the other leg.
        y, w: (m + 6,) joints and displacement of the support sole, their rates.
        V_before, A_before: V and A of the sample before, dt [s] ago; dt = 0: there is none.
        v, a: velocity and acceleration (nv,) of the model; those of the base are written, the joints not accelerating.

    Returns:
        V (6, n) twist of the trunk by the support leg, in base axes; A, C, height from `contact.contacts`; J (6, m)
        velocity of the COM and angular velocity of the trunk in the axes of the support sole, and J_o (6, k) the same
        by the other leg in the axes of its sole; COM (3,) in the support sole; downward direction (3,) in base axes.
    """
    n, k = columns_s.shape[0], columns_o.shape[0]
    m = n + k
    J_com = Y[:3] / mass  # the base is the origin of the axes in which the momentum is told
    V, V_o = trunk_twist(J_joints, columns_s), trunk_twist(J_joints, columns_o)
    A, C, height = contacts(V, R_s, p_s, V_o, R_o, p_o, sole_s, sole_o, y[m:])
    J = np.zeros((6, m))
    J[:, :n] = com_jacobian(V, columns_s, J_com, com, R_s)
    at, down = np.zeros(3), np.zeros(3)
    for i in range(3):
        down[i] = y[m + 4] * R_s[i, 0] - y[m + 3] * R_s[i, 1] - R_s[i, 2]
        for j in range(3):
            at[i] += R_s[j, i] * (com[j] - p_s[j])
            for c in range(k):
                J[i, n + c] += R_s[j, i] * J_com[j, columns_o[c]]
    for i in range(6):
        v[i] = a[i] = 0.0
        for j in range(n):
            v[i] += V[i, j] * w[j]
            a[i] += (V[i, j] - V_before[i, j]) * w[j]
        for j in range(6):
            v[i] += A[i, j] * w[m + j]
            a[i] += (A[i, j] - A_before[i, j]) * w[m + j]
        a[i] = a[i] / dt if dt > 0.0 else 0.0
    return V, A, C, height, J, com_jacobian(V_o, columns_o, J_com, com, R_o), at, down


@compiled
def topple_both(J: Array, J_o: Array, load: float, load_o: float, at: Array, K: Array, f: Array) -> None:
    """`stiffness.topple` of both legs: stiffness K (m, m) and forces f (m + 6,), in place.

    Args:
        J, J_o: from `geometry`.
        load, load_o: weight on the support leg and on the other one [N].
        at: (m,) deflections [rad].
    """
    n, m = at.shape[0] - J_o.shape[1], at.shape[0]
    torque = np.zeros(m)
    topple(J[:, :n], load, at[:n], K[:n, :n], torque[:n])
    topple(J_o, load_o, at[n:], K[n:, n:], torque[n:])
    for i in range(m):
        f[i] -= torque[i]


@compiled
def tell(com: Array, J: Array, y_t: Array, state: Array, R: Array, up: Array) -> Array:
    """COM and velocity, roll and pitch of the trunk (8,) of a state (2, m + 6), as seen from the posture y_t.

    Args:
        com, J, y_t: of `LegTerms`.
        R, up: orientation (3, 3) of the sole and z (3,) of the trunk in the base frame at that posture.
    """
    out, m = np.zeros(8), J.shape[1]
    for i in range(3):
        out[i] = com[i]
        for j in range(m):
            out[i] += J[i, j] * (state[0, j] - y_t[j])
            out[3 + i] += J[i, j] * state[1, j]
    out[6], out[7] = tilt(R, up)
    for i in range(2):
        for j in range(m):
            out[6 + i] += J[3 + i, j] * (state[0, j] - y_t[j])
    return out


@compiled
def carried(Y: Array, tau: Array, down: Array, V: Array, columns: Array, other: Array, A: Array) -> tuple[Array, Array]:
    """Inertia (m + 6, m + 6) that the joints of both legs and the support sole feel, and the forces (m + 6,) on them.

    The support leg's n joints come first, then the other leg's; m of them; then the motion of the support sole.

    Args:
        Y: (nv, nv) joint-space inertia with a free base, upper triangle.
        tau: (nv,) generalised forces of the reference motion without gravity.
        down: (3,) gravity in base axes [m/s^2].
        V: (6, n) twist of the trunk by the joints of the support leg.
        columns: (n,) of the support leg in Y.
        other: of the other leg.
        A: (6, 6) twist of the trunk by that of the support sole.

    Returns:
        M, and the forces of weight and motion.
    """
    n, k = columns.shape[0], other.shape[0]
    m = n + k
    index = np.empty(6 + m, dtype=np.int64)
    for i in range(6):
        index[i] = i
    for i in range(n):
        index[6 + i] = columns[i]
    for i in range(k):
        index[6 + n + i] = other[i]
    base = np.zeros((6, m + 6))  # twist of the trunk by all coordinates
    for i in range(6):
        for j in range(n):
            base[i, j] = V[i, j]
        for j in range(6):
            base[i, m + j] = A[i, j]
    S, f = np.empty((6 + m, 6 + m)), np.zeros(m + 6)
    for i in range(6 + m):
        for j in range(6 + m):
            a, b = index[i], index[j]
            S[i, j] = Y[a, b] if a <= b else Y[b, a]
    for i in range(m):
        f[i] = -tau[index[6 + i]]
        for j in range(3):
            f[i] += S[j, 6 + i] * down[j]
    for i in range(6):
        pull = -tau[i]
        for j in range(3):
            pull += S[j, i] * down[j]
        for j in range(m + 6):
            f[j] += base[i, j] * pull
    # N^T S N with N = [base; 1 0].
    SN = mul(S[:, :6].copy(), base)
    for i in range(6 + m):
        for j in range(m):
            SN[i, j] += S[i, 6 + j]
    M = mul(base.T, SN[:6])
    for i in range(m):
        for j in range(m + 6):
            M[i, j] += SN[6 + i, j]
    return M, f
