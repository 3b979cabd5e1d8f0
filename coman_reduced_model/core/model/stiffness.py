# SPDX-License-Identifier: BSD-3-Clause
"""Joint springs seen at the COM: (8)-(13) of the paper. Compiled, because they run at the rate of the sensors."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled, inverse, mul
from ..base.types import Array


@compiled
def leg_jacobian(J_joints: Array, columns: Array, com: Array, R: Array) -> Array:
    """The Jacobian of (8), from the sole to the frame at the COM.

    Args:
        J_joints: (6, nv) velocity [linear; angular] of the sole against the trunk, base axes, at the base origin.
        columns: (n,) columns of the leg's joints, hip to ankle.
        com: (3,) COM in base axes [m].
        R: rotation (3, 3) of the sole in the base frame.

    Returns:
        (6, n) linear [m/rad] over angular [1] velocity of the trunk-fixed frame at the COM, in the axes of the
        sole, the sole held still.
    """
    n = columns.shape[0]
    J = np.empty((6, n))
    for i in range(n):
        c = columns[i]
        v0, v1, v2 = J_joints[0, c], J_joints[1, c], J_joints[2, c]
        w0, w1, w2 = J_joints[3, c], J_joints[4, c], J_joints[5, c]
        # Seen from the sole the trunk moves the other way; at the COM: -(v + w x com).
        a0 = -v0 - (w1 * com[2] - w2 * com[1])
        a1 = -v1 - (w2 * com[0] - w0 * com[2])
        a2 = -v2 - (w0 * com[1] - w1 * com[0])
        for k in range(3):
            J[k, i] = R[0, k] * a0 + R[1, k] * a1 + R[2, k] * a2
            J[3 + k, i] = -(R[0, k] * w0 + R[1, k] * w1 + R[2, k] * w2)
    return J


@compiled
def height_hessian(J: Array) -> Array:
    """Second derivative of the COM height by the joint angles, (n, n) [m/rad^2], of the Jacobian (6, n) of (8).

    For two joints of a chain d^2c/dq_i dq_j = a_i x J_j with i the one nearer to the sole; joints count from the
    hip, so that the nearer one has the larger index.
    """
    n = J.shape[1]
    H = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            H[i, j] = H[j, i] = J[3, i] * J[1, j] - J[4, i] * J[0, j]
    return H


@compiled
def add_gravity_stiffness(J: Array, load: float, at: Array, K_q: Array, torque: Array) -> None:
    """Add what a load [N] at the COM does to the joints of a leg, in place: `effects/gravity_stiffness.py`.

    Args:
        J: (6, n) as in `height_hessian`.
        load: [N].
        at: (n,) deflection [rad] of the posture at which the weight itself is counted.
        K_q, torque: (n, n) stiffness [Nm/rad] and (n,) torque at no deflection [Nm], to be changed.
    """
    H = height_hessian(J)
    for i in range(H.shape[0]):
        for j in range(H.shape[0]):
            K_q[i, j] += load * H[i, j]
            torque[i] -= load * H[i, j] * at[j]


@compiled
def spring_damper(J: Array, K_q: Array, D_q: Array, length: float, limit: float) -> tuple[Array, Array, bool]:
    """Cartesian stiffness and damping K_c, D_c of (12), (13), safe where J is singular.

    K_c is the inverse of the compliance J K_q^-1 J^T, which exists where J^-1 does not (straight knee); for six
    joints it equals J^-T K_q J^-1. D_c = K_c J K_q^-1 D_q K_q^-1 J^T K_c, which for six joints equals J^-T D_q J^-1.
    Near a singular posture a damped compliance is added in all directions, so that none vanishes, which bounds
    stiffness and damping there and changes nothing elsewhere.

    Args:
        J: (6, n) or, for the trunk free to turn (`condensed`), its linear rows (3, n).
        K_q, D_q: (n, n) joint stiffness [Nm/rad] and damping [Nms/rad].
        length: of the leg [m]; makes rows of metres and of radians comparable.
        limit: smallest singular value of the scaled J that is taken as it is [1].

    Returns:
        K (r, r), D (r, r) in N/m, N, Nm and their rates, and whether the posture is near singular.
    """
    rows, n = J.shape
    Js = J.copy()
    for i in range(3):
        for j in range(n):
            Js[i, j] /= length
    S = inverse(K_q)
    JS = mul(Js, S)
    C = mul(JS, Js.T)
    stiffest = 0.0
    for i in range(n):
        stiffest = max(stiffest, abs(K_q[i, i]))
    floor = limit * limit / stiffest
    # A speck that only makes the inverse exist: 1e-6 of the floor.
    for i in range(rows):
        C[i, i] += 1e-6 * floor
    K = inverse(C)
    square = 0.0
    for i in range(rows):
        for j in range(rows):
            square += K[i, j] * K[i, j]
    smallest = 1.0 / np.sqrt(square)
    near_singular = smallest < floor
    B = mul(mul(JS, D_q), JS.T)
    if near_singular:
        # What is added yields as slowly as the joints do on average: undamped it would ring.
        SDS = mul(mul(S, D_q), S)
        time, compliance = 0.0, 0.0
        for i in range(n):
            time += SDS[i, i]
            compliance += S[i, i]
        time /= compliance
        for i in range(rows):
            C[i, i] += floor - smallest
            B[i, i] += (floor - smallest) * time
        K = inverse(C)
    D = mul(mul(K, B), K.T)
    K_c = np.empty((rows, rows))
    for i in range(rows):
        for j in range(rows):
            scale = (length if i < 3 else 1.0) * (length if j < 3 else 1.0)
            K_c[i, j] = 0.5 * (K[i, j] + K[j, i]) / scale
            D[i, j] /= scale
    return K_c, D, near_singular
