# SPDX-License-Identifier: BSD-3-Clause
"""What is published of a state of the trunk model: COM, tilt, deflections."""

from __future__ import annotations

from ...base.compiled import Held, compiled
from ...base.types import Array, Integers
from ...robot.posture import tilt

FALLEN = 0.3  # [m], [rad] by which the support sole of a free run has left the ground when the robot has fallen


@compiled
def com_and_tilt(out: Array, held: Held, R: Array, up: Array, y: Array, w: Array) -> bool:
    """Fill in COM and its velocity, roll and pitch of the trunk (8,) [m], [m/s], [rad] of a state.

    Returns whether the robot stands: else it fell over an edge of the support sole, in whose frame all this is.

    Args:
        out: filled in.
        held: the terms.
        R, up: orientation (3, 3) of the support sole and z (3,) of the trunk in the base frame.
        y, w: (m + 6,) coordinates and their rates.
    """
    terms = held.value[0]
    J, com, at = terms.geometry.J, terms.geometry.com, terms.linear.y
    out[6], out[7] = tilt(R, up)
    for i in range(3):
        out[i], out[3 + i] = com[i], 0.0
    for j in range(J.shape[1]):
        for i in range(3):
            out[i] += J[i, j] * (y[j] - at[j])
            out[3 + i] += J[i, j] * w[j]
        for i in range(2):
            out[6 + i] += J[3 + i, j] * (y[j] - at[j])
    stands = True
    for i in range(y.shape[0] - 6, y.shape[0]):
        stands &= abs(y[i]) < FALLEN
    return stands


@compiled
def deflections(
    out: Array, held: Held, y: Array, q: Array, order: Integers, com: Array, reference: Array, left: bool
) -> None:  # fmt: skip
    """Fill in deflections (3 + m,) of the COM [m] and of the joints, the left leg's first [rad], by a state.

    Args:
        out: filled in.
        held: the terms.
        y: (m + 6,) coordinates.
        q, com: measured joints (nj,) [rad] and COM (3,) [m]: the COM is corrected by what y differs from q.
        order: (m,) as in `pose_legs`.
        reference: (3,) [m].
        left: the support foot is the left one.
    """
    m, terms = order.shape[0], held.value[0]
    for i in range(3):
        out[i] = com[i] - reference[i]
    for j in range(m):
        for i in range(3):
            out[i] += terms.geometry.J[i, j] * (y[j] - q[order[j]])
        out[3 + (j if left else (j + m // 2) % m)] = y[j] - terms.theta[j]
