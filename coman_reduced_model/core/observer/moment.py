# SPDX-License-Identifier: BSD-3-Clause
"""Moment about the COM of what pushes the robot: angular momentum by wrenches between looks, by encoders at each.

A Kalman filter beside that of the COM (`kalman.py`), for each axis of the support sole. State: angular momentum L of
all links about the COM [Nms], moment n of what pushes the robot about the COM [Nm]:

    L' = M + n,    n' = white,    measured L + white

M are the moments of the wrenches of the ground about the measured COM, an input at each sample. L is that of the links
while the support sole is at rest, by Pinocchio's centroidal map (Orin, Goswami and Lee 2013, Autonomous Robots 35).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import all_finite, apply, compiled, mul
from ..base.types import Array, Integers
from .memory import BEGINS, FASTEST, GOES_ON, LASTS, Memory, Noise, learn_walk, memory_of, take

SLOW = 0.05  # [m/s] at the radius of gyration, by which the first angular momentum may be off


class Moment(NamedTuple):
    """What is remembered from sample to sample, axes of the support sole; views of one array by `moment_of`."""

    x: Array  # (2, 3) angular momentum [Nms], moment [Nm]
    P: Array  # (3, 3) of each axis in a row: variance of the former, covariance, variance of the latter
    ground: (
        Array  # (2, 3) moment of both feet about the COM at the last sample [Nm]; over time since the last look [Nms]
    )
    power: Array  # (3,) variance of the latter [(Nms)^2]
    levers: Array  # (2, 3) from the COM to the support sole and to the other one [m]
    squares: Array  # (3,) sum of the squared moments of each foot [Nm^2]
    past: (
        Array  # (2, 3) measured angular momentum at the last look, and by how much the ground had not changed it [Nms]
    )
    white: Array  # (3,) variance of its noise [(Nms)^2], times the share of the memory that is known
    known: Array  # (1,) that share [1]
    walks: Array  # (2, 3) how the moment wanders, on both feet and on one [Nm^2 / s]
    wandered: Array  # (3,) sum of its corrections, fading [Nm]
    zeros: Array  # (2, 3) variances of the zeros of each foot sensor [N^2], [Nm^2]


SIZE = 19 * 3 + 1  # of the array of `Moment`


@compiled
def moment_of(block: Array) -> Moment:
    """The views of an array as long as SIZE."""
    rows = block[: SIZE - 1].reshape(-1, 3)
    return Moment(
        rows[:2], rows[2:5], rows[5:7], rows[7], rows[8:10], rows[10], rows[11:13],
        rows[13], block[SIZE - 1 :], rows[14:16], rows[16], rows[17:19],
    )  # fmt: skip


@compiled
def angular_momentum(A: Array, columns: Integers, qd: Array, turning: Array, R: Array) -> Array:
    """(3,) of all links about their COM [Nms], in the axes of a sole that stands still.

    Args:
        A: (6, nv) centroidal map, of the base frame.
        columns, qd: (nj,) of the joints in it, and their rates [rad/s].
        turning: (3,) of the root link against the sole, in its own axes [rad/s].
        R: (3, 3) orientation of the sole in the base frame.
    """
    L = np.zeros(3)
    for i in range(3):
        for j in range(3):
            L[i] += A[3 + i, 3 + j] * turning[j]
        for j in range(columns.shape[0]):
            L[i] += A[3 + i, columns[j]] * qd[j]
    return apply(R.T, L)


@compiled
def follow(
    block: Array, extra: Array, noise: Noise, step: tuple[int, float, int], own: Array, other: Array, R: Array,
    R_other: Array, p: Array, p_other: Array, com: Array, com_vel: Array, out: Array,
) -> None:  # fmt: skip
    """`memory.take`, and add up the moments of the ground.

    Args:
        extra: of `Moment`.
        p, p_other: (3,) of support sole and other sole in the base frame [m].
        block, noise, step, own, other, R, R_other, com, com_vel, out: as there.
    """
    take(block, noise, step, own, other, R, R_other, com, com_vel, out)
    moment, (what, dt, _) = moment_of(extra), step
    base, turned, levers = np.zeros((2, 3)), np.zeros((2, 3)), moment.levers
    for k in range(3):
        for j in range(3):
            base[0, k] += R_other[k, j] * other[j]
            base[1, k] += R_other[k, j] * other[3 + j]
    for i in range(3):
        levers[0, i] = levers[1, i] = -com[i]
        for k in range(3):
            levers[1, i] += R[k, i] * (p_other[k] - p[k])
            turned[0, i] += R[k, i] * base[0, k]
            turned[1, i] += R[k, i] * base[1, k]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        mine = own[3 + i] + levers[0, j] * own[k] - levers[0, k] * own[j]
        others = turned[1, i] + levers[1, j] * turned[0, k] - levers[1, k] * turned[0, j]
        moment.squares[i] = mine**2 + others**2
        change = mine + others - moment.ground[0, i]
        moment.ground[0, i] += change
        if what == GOES_ON:
            moment.ground[1, i] += dt * (moment.ground[0, i] - 0.5 * change)
            late = noise.delay * change / dt
            moment.power[i] += dt * LASTS * (noise.gain**2 * moment.squares[i] + late**2)


@compiled
def look(
    block: Array, extra: Array, noise: Noise, step: tuple[int, float, int], radius: float, A: Array, columns: Integers,
    qd: Array, base: Array, R: Array, R_other: Array, out: Array,
) -> None:  # fmt: skip
    """Take in the angular momentum by the encoders.

    Args:
        block, extra, noise, R, R_other: after `follow` of this sample.
        step: as there, but the time since the last look.
        radius: of gyration [m].
        A, columns, qd: of `angular_momentum`.
        base: `Posture.base_in_sole`.
        out: (7, 3) filled in: moment (3,) of what pushes the robot about its COM [Nm], its covariance with force and
            moment (6, 3) [N Nm], [Nm^2].
    """
    memory, moment, (what, dt, alone) = memory_of(block), moment_of(extra), step
    measured = angular_momentum(A, columns, qd, base[5], R)
    if what == GOES_ON:
        _correct(moment, noise, (dt, alone), radius, measured)
    else:
        if what == BEGINS:
            moment.x[1], moment.P[2], moment.wandered[:] = 0.0, 0.0, 0.0
        else:  # in the axes of the sole before
            moment.x[1] = apply(R.T, apply(R_other, moment.x[1]))
        moment.x[0] = measured
        moment.P[0], moment.P[1], moment.past[1] = (noise.mass * radius * SLOW) ** 2, 0.0, np.nan
    moment.past[0], moment.ground[1], moment.power[:] = measured, 0.0, 0.0
    out[0] = moment.x[1]
    _write(moment, memory, noise.gain, out[1:4], out[4:])
    if what == BEGINS:
        for i in range(3):
            moment.P[2, i] = out[4 + i, i]


@compiled
def _correct(moment: Moment, noise: Noise, step: tuple[float, int], radius: float, measured: Array) -> None:
    """From the last look to this one."""
    x, P, ground, (dt, alone) = moment.x, moment.P, moment.ground[1], step
    share = 1.0 - np.exp(-dt / FASTEST)
    missing = measured - moment.past[0] - ground
    twice = missing - moment.past[1]
    moment.past[1] = missing
    if all_finite(twice):
        moment.white[:] += share * (twice * twice / 6.0 - moment.white)
        moment.known[0] += share * (1.0 - moment.known[0])
    walks, correction = moment.walks[alone], np.empty(3)
    for i in range(3):
        walk = walks[i] * dt
        x[0, i] += ground[i] + dt * x[1, i]
        P[0, i] += (
            2.0 * dt * P[1, i] + dt * dt * (P[2, i] + walk / 3.0) + moment.power[i] + dt * noise.force * radius**2
        )
        P[1, i] += dt * (P[2, i] + 0.5 * walk)
        P[2, i] += walk
        white = moment.white[i] / moment.known[0] if moment.known[0] > 0.0 else (noise.mass * radius * SLOW) ** 2
        gains = P[0, i] / (P[0, i] + white), P[1, i] / (P[0, i] + white)
        off = measured[i] - x[0, i]
        correction[i] = gains[1] * off
        x[0, i] += gains[0] * off
        x[1, i] += correction[i]
        P[2, i] -= gains[1] * P[1, i]
        P[0, i], P[1, i] = (1.0 - gains[0]) * P[0, i], (1.0 - gains[0]) * P[1, i]
    learn_walk(moment.wandered, walks, correction, noise.mass * noise.gravity * radius, dt)


@compiled
def _write(moment: Moment, memory: Memory, gain: float, with_force: Array, alone: Array) -> None:
    """Fill in covariances (3, 3) of the force with the moment, and of the moment.

    By the filter, the COM, gains, and zeros; those of forces are in force and moment.
    """
    by_com = _skew(memory.force)
    with_force[:] = 0.0
    alone[:] = mul(mul(by_com, memory.constants), by_com.T)
    for i in range(3):
        alone[i, i] += moment.P[2, i] + gain**2 * moment.squares[i] + 2.0 * moment.zeros[1, i]
    for foot in range(2):
        lever = _skew(moment.levers[foot])
        zeros = lever * moment.zeros[0]
        with_force += zeros.T
        alone += mul(zeros, lever.T)


@compiled
def _skew(a: Array) -> Array:
    """(3, 3) such that its product with b is a x b."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -a[2], a[1], -a[0]
    return out - out.T
