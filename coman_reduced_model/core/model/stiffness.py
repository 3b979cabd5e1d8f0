# SPDX-License-Identifier: BSD-3-Clause
"""Joint springs seen at the COM: (8)-(13) of the paper. Compiled, because they run at the rate of the sensors."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled, inverse, mul
from ..base.types import Array


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
    return K_c, D, near_singular and n >= rows  # what fewer joints than rows cannot move is no posture's fault
