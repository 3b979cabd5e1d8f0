# SPDX-License-Identifier: BSD-3-Clause
"""What the joiner computes of messages: compiled, for it is done with every one of them."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Integers, Reference
from .stream import usable


@compiled
def all_usable(a: Array, b: Array, c: Array, d: Array, e: Array, f: Array, g: Array, h: Array) -> bool:
    """Whether all values of all vectors are usable."""
    return usable(a) and usable(b) and usable(c) and usable(d) and usable(e) and usable(f) and usable(g) and usable(h)


@compiled
def to_sole(matrix: Array, force: Array, torque: Array, out: Array) -> bool:
    """Write a wrench (6,) by the matrix (6, 6) to its sole; whether it was usable."""
    for i in range(6):
        out[i] = 0.0
        for j in range(3):
            out[i] += matrix[i, j] * force[j] + matrix[i, 3 + j] * torque[j]
    return usable(force) and usable(torque)


@compiled
def mix(first: Array, second: Array, weight: float, out: Array) -> None:
    """Write the point that is `weight` of the way from the first to the second (n,)."""
    for i in range(out.shape[0]):
        out[i] = first[i] + weight * (second[i] - first[i])


@compiled
def _mix_plans(
    weight: float, com_0: Array, com_1: Array, vel_0: Array, vel_1: Array, acc_0: Array, acc_1: Array, zmp_0: Array,
    zmp_1: Array, now: Array, preview_0: Array, preview_1: Array, preview_vel_0: Array, preview_vel_1: Array,
    ahead: Array,
) -> None:  # fmt: skip
    """The same for all vectors of two plans: now (4, 3) and their previews (n, 3), ahead (2, n, 3)."""
    mix(com_0, com_1, weight, now[0])
    mix(vel_0, vel_1, weight, now[1])
    mix(acc_0, acc_1, weight, now[2])
    mix(zmp_0, zmp_1, weight, now[3])
    for k in range(preview_0.shape[0]):
        mix(preview_0[k], preview_1[k], weight, ahead[0, k])
        mix(preview_vel_0[k], preview_vel_1[k], weight, ahead[1, k])


def mixed(old: Reference, new: Reference, weight: float, stamp: int) -> Reference:
    """The plan between two of its points: vectors interpolated, feet and phase those of the nearer one.

    Where the previews do not match, the nearer point is taken whole, with its own stamp.
    """
    nearer = new if weight > 0.5 else old
    if old.preview_dt != new.preview_dt or old.preview_com.shape != new.preview_com.shape:
        return nearer
    now, ahead = np.empty((4, 3)), np.empty((2, *new.preview_com.shape))
    _mix_plans(
        weight, old.com, new.com, old.com_vel, new.com_vel, old.com_acc, new.com_acc, old.zmp, new.zmp, now,
        old.preview_com, new.preview_com, old.preview_com_vel, new.preview_com_vel, ahead,
    )  # fmt: skip
    return Reference(
        stamp, now[0], now[1], now[2], now[3], nearer.T_odom_left, nearer.T_odom_right, nearer.phase, nearer.step,
        nearer.preview_dt, ahead[0], ahead[1], nearer.steps,
    )  # fmt: skip


@compiled
def brackets(
    stamps: Integers, available: Integers, at: Integers, max_age: int, reach: int, first: Integers, second: Integers
) -> None:
    """`Stream.bracket` for all stamps asked for: write the index to take, and that of the one to interpolate to.

    Args:
        stamps: (m,) of the stream, increasing.
        available: (k,) how many of them have come when a stamp is asked for; does not decrease.
        at: (k,) stamps asked for, increasing.
        max_age, reach: as there [ns].
        first, second: (k,) written; -1: none.
    """
    i = -1
    for k in range(at.shape[0]):
        while i + 1 < available[k] and stamps[i + 1] <= at[k]:
            i += 1
        before, after = i, i + 1 if i + 1 < available[k] else -1
        if before >= 0 and at[k] - stamps[before] > max_age:
            before = -1
        if after >= 0 and stamps[after] - at[k] > min(reach, max_age):
            after = -1
        first[k], second[k] = (before, after) if before >= 0 else (after, -1)


@compiled
def mix_rows(values: Array, stamps: Integers, at: Integers, first: Integers, second: Integers, out: Array) -> None:
    """Write a row for each stamp, between those that `brackets` found; where it found none, nothing is written."""
    for k in range(at.shape[0]):
        i, j = first[k], second[k]
        if i < 0:
            continue
        if j < 0 or stamps[i] == at[k]:
            out[k] = values[i]
        else:
            mix(values[i], values[j], (at[k] - stamps[i]) / (stamps[j] - stamps[i]), out[k])
