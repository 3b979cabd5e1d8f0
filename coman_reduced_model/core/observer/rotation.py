# SPDX-License-Identifier: BSD-3-Clause
"""Rotation of the trunk to gravity and its angular velocity: gyro, and orientation by the IMU or by the encoders.

A Kalman filter beside that of the COM (`kalman.py`). The level frame is the support sole turned upright: z against
gravity, x above that of the sole. R (3, 3) leads from the trunk into it; about each axis of the trunk, the error t of R
[rad], the angular velocity w [rad/s] and the zero b of the gyro [rad/s] are

    t' = w,    w' = white,    b' = white (slow),    measured t + white,    measured w + b + white

Roll and pitch are measured by the orientation of the IMU or, without it, by the encoders, the support sole being taken
as flat on the ground; yaw always by the encoders, against the support sole. What both differ by over seconds is partly
how the IMU is mounted, as much as the nominal variability of both says; that part is taken off. Errors of the three
axes are taken as independent of each other, as for a trunk that stands about upright; the error is multiplicative, on
the right (Sola 2017, Quaternion kinematics for the error-state Kalman filter).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import Held, all_finite, compiled, mul
from ..base.types import Array, Integers
from ..measured.slope import up_of
from .memory import BEGINS, CALM, CHANGES, FASTEST, LATELY, LEARNT, learn_walk

FIRST_RATE, FIRST_ZERO = 1.0, 0.05  # [rad/s] by which angular velocity and zero of the gyro may be off at first
DRIFT = 5e-4  # [rad/s] by which that zero wanders in the root of a second
FIRST_WHITE = (0.005, 0.05)  # [rad], [rad/s] noise of orientation and gyro before it is known
LEAST = (1e-5, 1e-4)  # [rad], [rad/s] of it at least
GAP = 0.1  # [s] that a message of the IMU counts for at most
SOLES = 10.0  # [s] over which soles that roll leave no mean tilt
FAR = 3.0  # standard deviations: what IMU and encoders differ by counts up to there, as a robot that falls is no mount
BY_ENCODERS, BY_IMU = 0, 1  # what measures roll and pitch


class Turned(NamedTuple):
    """What is remembered from sample to sample, by axes of the trunk; views of one array by `turned_of`."""

    R: Array  # (3, 3) trunk to level frame
    w: Array  # (3,) angular velocity [rad/s]
    b: Array  # (3,) zero of the gyro [rad/s]
    P: Array  # (6, 3) covariances tt, tw, tb, ww, wb, bb of each axis in a column
    before: Array  # (3, 3) measured R at the last measurement
    turns: Array  # (2, 3) how it had changed before, newest last [rad]
    rates: Array  # (3, 3) measured rates, newest last [rad/s]
    white: Array  # (2, 3) variances of the noise [rad^2], [rad^2/s^2], times the share of the memory that is known
    known: Array  # (3,) these shares [1], and since when the IMU has said nothing [s]
    quiet: Array  # (3,) least variance of the noise of rates so far [rad^2/s^2]
    walks: Array  # (2, 3) how the angular velocity wanders, on both feet and on one [rad^2 / s^3]
    wandered: Array  # (3,) sum of its corrections, fading [rad/s]
    squares: Array  # (2, 3) mean of the last squared innovations of orientation and rates, each in its variance [1]
    constants: Array  # (3, 3) covariance of R by what is constant [rad^2]
    mount: Array  # (3,) mean turn from the orientation by the encoders to that by the IMU [rad]
    shares: Array  # (3,) seconds that it is known for, share of it that is how the IMU is mounted, its limit [rad]


SIZE = 33 * 3  # of the array of `Turned`
OUT = 16  # rows of what is known at a sample, as `follow` fills it in


@compiled
def turned_of(block: Array) -> Turned:
    """The views of an array as long as SIZE."""
    rows = block.reshape(-1, 3)
    return Turned(
        rows[:3], rows[3], rows[4], rows[5:11], rows[11:14], rows[14:16], rows[16:19], rows[19:21], rows[21],
        rows[22], rows[23:25], rows[25], rows[26:28], rows[28:31],
        rows[31], rows[32],
    )  # fmt: skip


@compiled
def follow(
    block: Array, step: tuple[int, float, int], sensors: tuple[int, bool, bool, float], natural: float,
    posture: tuple[Array, Array, Array], up: Array, orientation: Array, gyro: Array, out: Array,
) -> bool:  # fmt: skip
    """Bring the filter to a sample.

    Args:
        block: of `Turned`.
        step: BEGINS, GOES_ON or CHANGES, the time since the last sample [s], and 1 if one foot stands alone, else 0.
        sensors: BY_ENCODERS or BY_IMU, whether the IMU's orientation and its rates are new, how much later than the
            sample they are [s].
        natural: angular velocity that is usual for a robot of this size [rad/s].
        posture: orientations (3, 3) of IMU, trunk and support sole in the base frame.
        up: (3,) against gravity in the axes of the support sole, as far as it is known without the IMU.
        orientation, gyro: (4,) x y z w, (3,) [rad/s] of the IMU.
        out: (OUT, 3), filled in: R, w, covariance (6, 6) of both.

    Returns:
        Whether all of that is finite.
    """
    at, (what, dt, alone), (source, oriented, turning, late) = turned_of(block), step, sensors
    turning = turning and all_finite(gyro) and bool(gyro.any())  # drivers without a gyro send zeros
    R_imu, R_trunk, _ = posture
    age = min(at.known[2] + dt, GAP) if what != BEGINS else 0.0  # since the IMU's last message
    measured = _measured(at, source, oriented, posture, up, orientation, age)
    if what == BEGINS:
        _begin(at, measured)
    else:
        _predict(at, dt, at.walks[alone])
        if what == CHANGES:
            _change(at, source, measured)
    off = rotation_vector(at.R, measured)
    correction, new = np.zeros((3, 3)), oriented or source == BY_ENCODERS
    for i in range(3):
        if new or i == 2:  # yaw by the encoders is always new
            delay = late if source == BY_IMU and i < 2 else 0.0
            white = _white(at, 0, i)
            since = age if source == BY_IMU and i < 2 else dt
            _correct(at, 0, i, (1.0, delay, 0.0), off[i] - delay * at.w[i], white, correction, since)
    if turning:
        for i in range(3):
            rate = 0.0
            for k in range(3):
                for m in range(3):
                    rate += R_trunk[k, i] * R_imu[k, m] * gyro[m]
            at.rates[0, i], at.rates[1, i], at.rates[2, i] = at.rates[1, i], at.rates[2, i], rate
            gap = rate - at.w[i] - correction[1, i] - at.b[i] - correction[2, i]
            white = _white(at, 1, i) + at.walks[alone, i] * abs(late)
            _correct(at, 1, i, (0.0, 1.0, 1.0), gap, white, correction, age)
    at.w[:] += correction[1]
    at.b[:] += correction[2]
    at.R[:] = mul(at.R, turn_by(correction[0]))
    if what != BEGINS:
        learn_walk(at.wandered, at.walks[alone], correction[1], natural, dt)
        _learn_white(at, measured, new, turning, (age if source == BY_IMU else dt, age))
    at.known[2] = 0.0 if oriented or turning else age
    if new:
        at.before[:] = measured
    _write(at, out)
    return all_finite(out.ravel())


@compiled
def _measured(
    at: Turned, source: int, oriented: bool, posture: tuple[Array, Array, Array], up: Array, orientation: Array,
    dt: float,
) -> Array:  # fmt: skip
    """The measured R: its z by the IMU or by the sole, its x by the sole."""
    R_imu, R_trunk, R_sole = posture
    u, flat, ahead = np.zeros(3), np.zeros(3), np.zeros(3)  # up by the IMU and by the sole, x of it; axes of the trunk
    seen = up_of(orientation)
    for i in range(3):
        for k in range(3):
            ahead[i] += R_trunk[k, i] * R_sole[k, 0]
            for m in range(3):
                u[i] += R_trunk[k, i] * R_imu[k, m] * seen[m]
                flat[i] += R_trunk[k, i] * R_sole[k, m] * up[m]
    if source != BY_IMU:
        return level_frame(flat, ahead)
    if not oriented:
        return level_frame(at.R[2], ahead)
    R = level_frame(u, ahead)
    _learn_mount(at, rotation_vector(level_frame(flat, ahead), R), dt)
    return mul(R, turn_by(-at.shares[1] * at.mount))


@compiled
def _learn_mount(at: Turned, off: Array, dt: float) -> None:
    """By how the IMU and the encoders differ, (3,) [rad], `dt` after the last time [s]."""
    at.shares[0] = min(at.shares[0] + dt, SOLES)
    share = min(dt / at.shares[0], 1.0) if at.shares[0] > 0.0 else 1.0
    if all_finite(off):
        for i in range(3):
            at.mount[i] += share * (max(min(off[i], at.shares[2]), -at.shares[2]) - at.mount[i])


@compiled
def level_frame(up: Array, ahead: Array) -> Array:
    """R (3, 3) by its z, `up` (3,), and what its x is above, (3,), in the axes of the trunk."""
    out = np.empty((3, 3))
    length = np.sqrt(up[0] ** 2 + up[1] ** 2 + up[2] ** 2)
    along = (ahead[0] * up[0] + ahead[1] * up[1] + ahead[2] * up[2]) / length**2
    for i in range(3):
        out[2, i], out[0, i] = up[i] / length, ahead[i] - along * up[i]
    out[0] /= np.sqrt(out[0, 0] ** 2 + out[0, 1] ** 2 + out[0, 2] ** 2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[1, i] = out[2, j] * out[0, k] - out[2, k] * out[0, j]
    return out


@compiled
def _begin(at: Turned, measured: Array) -> None:
    at.R[:], at.w[:], at.b[:], at.P[:] = measured, 0.0, 0.0, 0.0
    at.P[0], at.P[3], at.P[5] = FIRST_WHITE[0] ** 2, FIRST_RATE**2, FIRST_ZERO**2
    at.before[:], at.turns[:], at.rates[:] = np.nan, np.nan, np.nan
    at.quiet[:] = np.inf
    at.white[:], at.known[:], at.squares[:], at.wandered[:] = 0.0, 0.0, 1.0, 0.0


@compiled
def _predict(at: Turned, dt: float, walks: Array) -> None:
    """To the next sample."""
    at.R[:] = mul(at.R, turn_by(dt * at.w))
    P = at.P
    for i in range(3):
        walk = walks[i] * dt
        P[0, i] += 2.0 * dt * P[1, i] + dt * dt * (P[3, i] + walk / 3.0)
        P[1, i] += dt * (P[3, i] + 0.5 * walk)
        P[2, i] += dt * P[4, i]
        P[3, i] += walk
        P[5, i] += DRIFT**2 * dt


@compiled
def _change(at: Turned, source: int, measured: Array) -> None:
    """The other sole is the support: the level frame turns about z, and without an IMU it tilts as well."""
    if source == BY_IMU:
        heading = mul(measured, at.R.T.copy())
        angle = np.arctan2(heading[1, 0] - heading[0, 1], heading[0, 0] + heading[1, 1])
        at.R[:] = mul(turn_by(np.array((0.0, 0.0, angle))), at.R)
    else:
        at.R[:] = measured
    at.turns[:] = np.nan
    at.before[:] = np.nan


@compiled
def _correct(
    at: Turned, kind: int, i: int, H: tuple[float, float, float], off: float, white: float, correction: Array, dt: float
) -> None:
    """Take in one measurement of axis i, of `kind` orientation (0) or rate (1), by its innovation; P in place.

    H: what it measures of t, w and b. `correction` (3, 3) adds up those of t, w and b.
    """
    P, (t, w, b) = at.P, H
    PH = (
        t * P[0, i] + w * P[1, i] + b * P[2, i],
        t * P[1, i] + w * P[3, i] + b * P[4, i],
        t * P[2, i] + w * P[4, i] + b * P[5, i],
    )
    S = t * PH[0] + w * PH[1] + b * PH[2] + white
    at.squares[kind, i] += (1.0 - np.exp(-dt / LATELY)) * (off * off / S - at.squares[kind, i])
    row = 0
    for k in range(3):
        correction[k, i] += PH[k] * off / S
        for m in range(k, 3):
            P[row, i] -= PH[k] * PH[m] / S
            row += 1


@compiled
def _white(at: Turned, kind: int, i: int) -> float:
    """Variance of the noise of a measurement, as in `_correct`."""
    if not at.known[kind] > 0.0:
        return FIRST_WHITE[kind] ** 2
    return (min(at.quiet[i], at.white[1, i] / at.known[1]) if kind == 1 else at.white[0, i] / at.known[0]) + LEAST[
        kind
    ] ** 2


@compiled
def _learn_white(at: Turned, measured: Array, new: bool, turning: bool, since: tuple[float, float]) -> None:
    """By third differences of the measured rotation, and second ones of the rates.

    A trunk that shakes has large differences of rates as well. The noise of a gyro is always the same: that of the
    calmest third of a second counts. `since` the last orientation, and the last rates [s].
    """
    share = 1.0 - np.exp(-since[0] / FASTEST)
    if new:
        turn, turns = rotation_vector(at.before, measured), at.turns
        third = turn - 2.0 * turns[1] + turns[0]
        turns[0], turns[1] = turns[1].copy(), turn
        _add_difference(at, 0, third, 20.0, share)
    if turning:
        _add_difference(at, 1, at.rates[2] - 2.0 * at.rates[1] + at.rates[0], 6.0, 1.0 - np.exp(-since[1] / LEARNT))
        for i in range(3):
            if at.known[1] > 0.5:
                at.quiet[i] = min(at.quiet[i], at.white[1, i] / at.known[1])


@compiled
def _add_difference(at: Turned, kind: int, difference: Array, times: float, share: float) -> None:
    """`times` is the variance of a difference over that of what it is made of."""
    if all_finite(difference):
        at.white[kind] += share * (difference * difference / times - at.white[kind])
        at.known[kind] += share * (1.0 - at.known[kind])


@compiled
def _write(at: Turned, out: Array) -> None:
    """Fill in `out` of `follow`; innovations that have lately been large or small scale it as that of the COM."""
    covariance, scale = out[4:].reshape(6, 6), np.empty(6)
    out[:3], out[3], covariance[:] = at.R, at.w, 0.0
    for i in range(3):
        for kind in range(2):
            square = at.squares[kind, i]
            scale[3 * kind + i] = square if square > 1.0 else np.sqrt(max(square, CALM))
        covariance[i, i] = scale[i] ** 2 * at.P[0, i]
        covariance[i, 3 + i] = covariance[3 + i, i] = scale[i] * scale[3 + i] * at.P[1, i]
        covariance[3 + i, 3 + i] = scale[3 + i] ** 2 * at.P[3, i]
        for j in range(3):
            covariance[i, j] += at.constants[i, j]


@compiled
def rotation_vector(R: Array, to: Array) -> Array:
    """(3,) by which R is turned about its own axes to become `to`, for small angles [rad]."""
    out = np.zeros(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            out[i] += 0.5 * (R[m, k] * to[m, j] - R[m, j] * to[m, k])
    return out


@compiled
def turn_by(angles: Array) -> Array:
    """The rotation (3, 3) by a vector (3,) [rad], by Rodrigues' formula."""
    angle = np.sqrt(angles[0] ** 2 + angles[1] ** 2 + angles[2] ** 2)
    s = np.sin(angle) / angle if angle > 1e-9 else 1.0
    c = (1.0 - np.cos(angle)) / angle**2 if angle > 1e-9 else 0.5
    out = np.empty((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = 1.0 - c * (angles[j] ** 2 + angles[k] ** 2)
        out[i, j] = c * angles[i] * angles[j] - s * angles[k]
        out[j, i] = c * angles[i] * angles[j] + s * angles[k]
    return out


@compiled
def consider(
    block: Array, posture: Held, columns: tuple[Integers, Integers], R_trunk: Array, by_imu: bool,
    steps: Array, idx_v: Integers, zero: float, tilts: tuple[float, float],
) -> None:  # fmt: skip
    """Fill in the covariance by what is constant, and how much of what IMU and encoders differ by is the IMU's.

    Args:
        block: of `Turned`.
        posture: `Views`.
        columns: of the joints between trunk and support sole, and between trunk and IMU.
        R_trunk: (3, 3) of the trunk in the base frame.
        by_imu: roll and pitch are the IMU's.
        steps: (nj,) of the encoders [rad]; infinite where not known.
        idx_v: (nj,) columns of the joints.
        zero: variance of the zeros of the encoders [rad^2].
        tilts: variances of the slope of the ground, and of how the IMU is mounted [rad^2].
    """
    at, J = turned_of(block), posture.value.J
    C, axis, variance = np.zeros((2, 3, 3)), np.zeros(3), np.zeros(J.shape[1])
    for j in range(steps.shape[0]):
        variance[idx_v[j]] = zero + (steps[j] ** 2 / 12.0 if np.isfinite(steps[j]) else 0.0)
    for of in range(2):
        for c in columns[of]:
            for i in range(3):
                axis[i] = R_trunk[0, i] * J[3, c] + R_trunk[1, i] * J[4, c] + R_trunk[2, i] * J[5, c]
            for i in range(3):
                for j in range(3):
                    C[of, i, j] += variance[c] * axis[i] * axis[j]
    u = at.R[2]
    yaw = trace = 0.0
    for i in range(3):
        trace += C[0, i, i]
        for j in range(3):
            yaw += u[i] * C[0, i, j] * u[j]
    flat = tilts[0] + 0.5 * (trace - yaw)  # of roll and pitch by the encoders
    at.shares[1], at.shares[2] = tilts[1] / (tilts[1] + flat), FAR * np.sqrt(tilts[1] + flat)
    for i in range(3):
        for j in range(3):
            level = (1.0 if i == j else 0.0) - u[i] * u[j]
            if by_imu:
                mount = (1.0 - at.shares[1]) * tilts[1] * level
                at.constants[i, j] = C[1, i, j] + mount + yaw * u[i] * u[j]
            else:
                at.constants[i, j] = C[0, i, j] + tilts[0] * level
