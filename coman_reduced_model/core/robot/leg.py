# SPDX-License-Identifier: BSD-3-Clause
"""One leg by its joints: the Jacobian (8) of the paper, and what a load at the COM adds to the joint stiffness."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
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
    """Add what a load [N] at the COM does to the joints of a leg, in place: option `gravity_stiffness`.

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
