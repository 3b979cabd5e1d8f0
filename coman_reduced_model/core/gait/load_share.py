# SPDX-License-Identifier: BSD-3-Clause
"""Where a planned wrench of the ground presses, and how both feet share it."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Phase


def zmp_of(wrench: Array, height: float | Array) -> Array:
    """Where wrenches (n, 6) about the origin press on the ground at that height [m] or heights (n,): (n, 2) [m]."""
    f, m = wrench[:, :3], wrench[:, 3:]
    x = (height * f[:, 0] - m[:, 1]) / f[:, 2]
    y = (height * f[:, 1] + m[:, 0]) / f[:, 2]
    return np.stack([x, y], axis=1)


def share_load(wrench: Array, T_left: Array, T_right: Array, phase: Array) -> tuple[Array, Array]:
    """Splits ground wrenches (n, 6) between the feet, as (n, 6) left and right about the origin of odom.

    In single support one foot has it all. In double support the share follows the ZMP on its way from sole to sole.
    """
    out = np.empty((2, *wrench.shape))
    heights = support_height(T_left, T_right, phase)
    for k in range(len(wrench)):
        share_one(wrench[k], T_left[k], T_right[k], int(phase[k]), heights[k], out[:, k])
    return out[0], out[1]


@compiled
def share_one(wrench: Array, T_left: Array, T_right: Array, phase: int, height: float, out: Array) -> None:
    """`share_load` of one wrench (6,) on ground at a height [m], into out (2, 6)."""
    x, y = (height * wrench[0] - wrench[4]) / wrench[2], (height * wrench[1] + wrench[3]) / wrench[2]
    over_x, over_y = T_left[0, 3] - T_right[0, 3], T_left[1, 3] - T_right[1, 3]
    share = ((x - T_right[0, 3]) * over_x + (y - T_right[1, 3]) * over_y) / (over_x * over_x + over_y * over_y)
    share = 1.0 if phase == 1 or share > 1.0 else 0.0 if phase == 2 or share < 0.0 else share
    # Each foot presses as far from its sole's origin as the ZMP is from the line between the soles.
    shift_x, shift_y = x - T_right[0, 3] - share * over_x, y - T_right[1, 3] - share * over_y
    for foot, T, part in ((0, T_left, share), (1, T_right, 1.0 - share)):
        for i in range(3):
            out[foot, i] = part * wrench[i]
        px, py, pz = T[0, 3] + shift_x, T[1, 3] + shift_y, T[2, 3]
        out[foot, 3] = py * out[foot, 2] - pz * out[foot, 1]
        out[foot, 4] = pz * out[foot, 0] - px * out[foot, 2]
        out[foot, 5] = px * out[foot, 1] - py * out[foot, 0]
    for i in range(3, 6):  # the moment about the vertical
        rest = wrench[i] - out[0, i] - out[1, i]
        out[0, i] += share * rest
        out[1, i] += (1.0 - share) * rest


def support_height(T_left: Array, T_right: Array, phase: Array) -> Array:
    """(n,) [m] of the ground under the foot that bears; between both in double support."""
    left, right = T_left[:, 2, 3], T_right[:, 2, 3]
    return np.where(phase == Phase.LEFT, left, np.where(phase == Phase.RIGHT, right, 0.5 * (left + right)))
