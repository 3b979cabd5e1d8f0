# SPDX-License-Identifier: BSD-3-Clause
"""Centre of pressure of a foot and zero moment point of both, from the wrenches of the ground on flat soles."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array

MIN_FORCE = 5.0  # [N] below this the quotient moment / force is noise


def cop(wrench: Array, min_force: float = MIN_FORCE) -> Array | None:
    """Centre of pressure (3,) [m] in the frame of a flat sole, whose plane is z = 0.

    Args:
        wrench: (6,) force [N] and torque [Nm] of the ground on the foot, about the sole origin, in its frame.
        min_force: vertical force [N] that is needed at least.

    Returns:
        The point, or None when the vertical force is too small for one.
    """
    fz = wrench[2]
    if not fz >= min_force:
        return None
    return np.array([-wrench[4] / fz, wrench[3] / fz, 0.0])


def zmp_from_wrenches(
    left_wrench: Array | None,
    right_wrench: Array | None,
    T_support_left: Array,
    T_support_right: Array,
    min_force: float = MIN_FORCE,
) -> Array | None:
    """Zero moment point (3,) [m] of both feet on the ground plane of the support sole, in its frame.

    Args:
        left_wrench: (6,) force [N] and torque [Nm] of the ground on the left foot, in its sole frame; None: missing.
        right_wrench: the same for the right foot.
        T_support_left: pose (4, 4) of the left sole in the support sole frame.
        T_support_right: pose (4, 4) of the right sole there.
        min_force: total vertical force [N] that is needed at least.

    Returns:
        The point, or None when a wrench is missing or the total vertical force is too small.
    """
    if left_wrench is None or right_wrench is None:
        return None
    zmp = np.empty(3)  # what compiled code fills costs less than what it returns
    return zmp if _net(left_wrench, right_wrench, T_support_left, T_support_right, zmp) >= min_force else None


@compiled
def _net(left: Array, right: Array, T_left: Array, T_right: Array, zmp: Array) -> float:
    """Write the ZMP (3,) [m] in the support sole; the total vertical force [N], without which it is infinite or NaN."""
    mx = my = fz = 0.0
    for wrench, T in ((left, T_left), (right, T_right)):
        f0 = T[0, 0] * wrench[0] + T[0, 1] * wrench[1] + T[0, 2] * wrench[2]
        f1 = T[1, 0] * wrench[0] + T[1, 1] * wrench[1] + T[1, 2] * wrench[2]
        f2 = T[2, 0] * wrench[0] + T[2, 1] * wrench[1] + T[2, 2] * wrench[2]
        mx += T[0, 0] * wrench[3] + T[0, 1] * wrench[4] + T[0, 2] * wrench[5] + T[1, 3] * f2 - T[2, 3] * f1
        my += T[1, 0] * wrench[3] + T[1, 1] * wrench[4] + T[1, 2] * wrench[5] + T[2, 3] * f0 - T[0, 3] * f2
        fz += f2
    zmp[0], zmp[1], zmp[2] = -my / fz, mx / fz, 0.0
    return fz
