# SPDX-License-Identifier: BSD-3-Clause
"""Where a planned wrench of the ground presses, and how both feet share it."""

from __future__ import annotations

import numpy as np

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
    left, right = T_left[:, :3, 3], T_right[:, :3, 3]
    between, zmp = (left - right)[:, :2], zmp_of(wrench, support_height(T_left, T_right, phase))
    along = np.einsum("ni,ni->n", zmp - right[:, :2], between) / np.einsum("ni,ni->n", between, between)
    share = np.clip(along, 0.0, 1.0)
    share = np.where(phase == Phase.LEFT, 1.0, np.where(phase == Phase.RIGHT, 0.0, share))[:, None]
    # Each foot presses as far from its sole's origin as the ZMP is from the line between the soles.
    shift = np.zeros_like(left)
    shift[:, :2] = zmp - (right[:, :2] + share * between)
    parts = []
    for part, sole in ((share, left), (1.0 - share, right)):
        force = part * wrench[:, :3]
        parts.append(np.column_stack([force, np.cross(sole + shift, force)]))
    rest = wrench[:, 3:] - parts[0][:, 3:] - parts[1][:, 3:]  # the moment about the vertical
    parts[0][:, 3:] += share * rest
    parts[1][:, 3:] += (1.0 - share) * rest
    return parts[0], parts[1]


def support_height(T_left: Array, T_right: Array, phase: Array) -> Array:
    """(n,) [m] of the ground under the foot that bears; between both in double support."""
    left, right = T_left[:, 2, 3], T_right[:, 2, 3]
    return np.where(phase == Phase.LEFT, left, np.where(phase == Phase.RIGHT, right, 0.5 * (left + right)))
