# SPDX-License-Identifier: BSD-3-Clause
"""What the observer does at one sample, compiled: the filter, and what it learns of its own noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import Held, all_finite, apply, compiled, mul
from ..base.types import Array, Integers
from .kalman import SIZE, C, F, N, V, advance, com_covariance, correct, net_force, turned

WALKS = (0.01, 1.0)  # of the weight: how far an external force wanders in the root of a second, least and most
WANDERED, LEARNT = 0.05, 0.3  # [s] over which corrections of the force add up, and memory of what they add up to
LASTS = 0.1  # [s] for which an error by a step of an encoder lasts
FASTEST = 2.0  # [s] memory of the white noise
EVEN = 1.2  # times the shortest interval between samples: third differences want them alike
LEAST = 1e-5  # [m] of white noise at least
JUDGED = 2.0  # [s] memory of the NIS
LATELY = 0.05  # [s] memory of the squared innovations by which the published covariance is scaled
CALM = 0.5  # least of them that counts: the share of a variance that is left where innovations are small
BEGINS, GOES_ON, CHANGES = 0, 1, 2  # at a sample: the filter begins, or goes on, by the same sole or by the other one
ROWS = 21  # of what is known at a sample, as `take` fills it in


class Memory(NamedTuple):
    """What is remembered from sample to sample, axes of the support sole; views of one array by `memory_of`."""

    x: Array  # (12,) state and
    P: Array  # (12, 12) covariance, as in `kalman.py`
    rounding: Array  # (3, 3) covariance of what steps of encoders make of the measured COM [m^2]
    constants: Array  # (3, 3) of what masses and zeros of encoders make of it [m^2]
    past: Array  # (4, 3) measured COM, newest last [m]
    white: Array  # (3,) its variance without what lasts [m^2], times the share of the memory that is known
    walks: Array  # (2, 3) how the external force wanders, on both feet and on one [N^2 / s]
    wandered: Array  # (3,) sum of the corrections of that force, fading [N]
    force: Array  # (3,) of the ground at the last sample, and `Noise.aslant` [N]
    constant: Array  # (3,) variance of an external force by what is constant [N^2]
    scalars: Array  # (3,) share of the memory of `white` that is known; mean NIS; NIS of the last sample [1]
    squares: Array  # (3,) mean of the last squared innovations, each in its own variance [1]
    steps: Array  # (3,) between the measured COM of `past` [s]


class Noise(NamedTuple):
    """What does not change from sample to sample, but for the slope of the ground."""

    mass: float  # [kg]
    gravity: float  # [m/s^2]
    force: float  # that neither sensors nor gains explain [N^2 s]
    gain: float  # [1] spread of the gains of wrenches
    delay: float  # [s] and of their delays
    aslant: Array  # (3,) weight of the robot less what it is on level ground, in the axes of the support sole [N]


SIZES = (SIZE, SIZE * SIZE, 9, 9, 12, 3, 6, 3, 3, 3, 3, 3, 3)  # of the fields of `Memory`


@compiled
def memory_of(block: Array) -> Memory:
    """The views of an array as long as the sum of SIZES."""
    P, at = block[SIZE : SIZE + SIZE * SIZE].reshape(SIZE, SIZE), SIZE + SIZE * SIZE
    rounding, constants, past = block[at : at + 9], block[at + 9 : at + 18], block[at + 18 : at + 30]
    at += 30
    return Memory(
        block[:SIZE], P, rounding.reshape(3, 3), constants.reshape(3, 3), past.reshape(4, 3), block[at : at + 3],
        block[at + 3 : at + 9].reshape(2, 3), block[at + 9 : at + 12], block[at + 12 : at + 15],
        block[at + 15 : at + 18], block[at + 18 : at + 21], block[at + 21 : at + 24], block[at + 24 : at + 27],
    )  # fmt: skip


@compiled
def take(
    block: Array, noise: Noise, step: tuple[int, float, int], own: Array, other: Array, R: Array, R_other: Array,
    com: Array, com_vel: Array, out: Array,
) -> None:  # fmt: skip
    """Bring the filter to a sample.

    Args:
        block: of `Memory`.
        noise: constants.
        step: BEGINS, GOES_ON or CHANGES, the time since the last sample [s], and 1 if one foot stands alone, else 0.
        own, other: wrenches (6,) on the support foot and on the other one, in the axes of their soles.
        R, R_other: (3, 3) orientations of these soles in the base frame.
        com, com_vel: (3,) measured [m], [m/s].
        out: (ROWS, 3), filled in: COM [m], velocity [m/s], external force [N]; covariances (3, 3) of the measured COM
            and of the force, (6, 6) of COM and velocity.
    """
    memory, (what, dt, alone) = memory_of(block), step
    white, lasting = _measured(memory)
    force = net_force(R, R_other, own, other) + noise.aslant
    if what == BEGINS:
        _begin(memory, lasting, com, com_vel)
    else:
        if what == CHANGES:
            _change(memory, lasting, R, R_other, com, dt)
        _follow(memory, noise, (dt, alone), (white, lasting), force, com)
    memory.force[:] = force
    _write(memory, white, lasting, out)


@compiled
def _begin(memory: Memory, lasting: Array, com: Array, com_vel: Array) -> None:
    x, P = memory.x, memory.P
    x[:], P[:], memory.past[:], memory.squares[:] = 0.0, 0.0, np.nan, 1.0
    x[C:V], x[V:F] = com, com_vel
    P[C:V, C:V], P[N:, N:] = memory.rounding, lasting
    for i in range(3):
        P[V + i, V + i], P[F + i, F + i] = 0.05**2, memory.constant[i]
    memory.past[3] = com  # with which the other sole's is compared, if it is next


@compiled
def _change(memory: Memory, lasting: Array, R: Array, R_other: Array, com: Array, dt: float) -> None:
    """The other sole is the support: what the encoders were believed to be off by stays as sure as it was.

    The state becomes that of the last sample, `dt` ago [s], in the new sole.
    """
    turn = mul(R.T.copy(), R_other.copy())
    x, P = memory.x, memory.P
    off = apply(turn, x[C:V] - memory.past[3])
    x[:], P[:] = turned(x, P, turn)
    if all_finite(off):
        x[C:V] = com + off - dt * x[V:F]
    x[N:] = 0.0
    P[N:, :] = 0.0
    P[:, N:] = 0.0
    P[N:, N:] = lasting
    P[C:V, C:V] += 2.0 * memory.rounding  # of what the one sole measured last, and the other measures first
    memory.past[:] = np.nan


@compiled
def _measured(memory: Memory) -> tuple[Array, Array]:
    """Covariances (3, 3) [m^2] of the measured COM by what is white, and by what lasts.

    The rounding of encoders is white where the joints move by a step or more from sample to sample, and lasts where
    they hardly move. Third differences show how much of it is white; it must not count twice.
    """
    white, lasting, share = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        white[i, i] = memory.white[i] / max(memory.scalars[0], 1e-9) + LEAST**2
        share[i] = min(white[i, i] / memory.rounding[i, i], 1.0) if memory.scalars[0] > 0.0 else 0.0
    for i in range(3):
        for j in range(3):
            if i != j:
                white[i, j] = np.sqrt(share[i] * share[j]) * memory.rounding[i, j]
            lasting[i, j] = np.sqrt((1.0 - share[i]) * (1.0 - share[j])) * memory.rounding[i, j]
    return white, lasting


@compiled
def _follow(
    memory: Memory, noise: Noise, step: tuple[float, int], measured: tuple[Array, Array], force: Array, com: Array
) -> None:
    """From the last sample to this one, at which the COM is measured."""
    x, last, scalars = memory.x, memory.force, memory.scalars
    (dt, alone), (white, lasting) = step, measured
    mean, power, walks = np.empty(3), np.empty((2, 3)), memory.walks[alone]
    for i in range(3):
        swing = force[i] - (noise.mass * noise.gravity if i == 2 else 0.0)
        mean[i] = 0.5 * (force[i] + last[i])
        power[0, i] = noise.force + LASTS * ((noise.gain * swing) ** 2 + (noise.delay * (force[i] - last[i]) / dt) ** 2)
        power[1, i] = walks[i]
    advance(x, memory.P, mean, dt, noise.mass, noise.gravity, power, lasting, LASTS)
    before, squares = x[F:N].copy(), np.empty(3)
    scalars[2] = correct(x, memory.P, com, white, squares)
    scalars[1] += (1.0 - np.exp(-dt / JUDGED)) * (scalars[2] - scalars[1])
    memory.squares[:] += (1.0 - np.exp(-dt / LATELY)) * (squares - memory.squares)
    _learn_white(memory, com, dt)
    learn_walk(memory.wandered, walks, x[F:N] - before, noise.mass * noise.gravity, dt)


@compiled
def _learn_white(memory: Memory, com: Array, dt: float) -> None:
    """By third differences of the measured COM (3,) [m]."""
    past, steps, share = memory.past, memory.steps, 1.0 - np.exp(-dt / FASTEST)
    steps[0], steps[1], steps[2] = steps[1], steps[2], dt
    third = np.empty(3)
    for i in range(3):
        for k in range(3):
            past[k, i] = past[k + 1, i]
        past[3, i] = com[i]
        third[i] = past[3, i] - 3.0 * past[2, i] + 3.0 * past[1, i] - past[0, i]
    if all_finite(third) and steps.max() <= EVEN * steps.min():
        for i in range(3):
            memory.white[i] += share * (third[i] * third[i] / 20.0 - memory.white[i])
        memory.scalars[0] += share * (1.0 - memory.scalars[0])


@compiled
def learn_walk(wandered: Array, walks: Array, correction: Array, weight: float, dt: float) -> None:
    """How far the force wanders, by corrections (3,) [N]: where it is as assumed, their sum has its variance.

    wandered, walks (3,): that sum, fading [N], and the walks [N^2 / s]; changed in place.
    """
    share, fade = 1.0 - np.exp(-dt / LEARNT), np.exp(-dt / WANDERED)
    for i in range(3):
        wandered[i] = wandered[i] * fade + correction[i]
        walk = walks[i] + share * (2.0 / WANDERED * wandered[i] ** 2 - walks[i])
        walks[i] = min(max(walk, (WALKS[0] * weight) ** 2), (WALKS[1] * weight) ** 2)


@compiled
def _write(memory: Memory, white: Array, lasting: Array, out: Array) -> None:
    """Fill in `out` of `take`.

    Where innovations have lately been larger or smaller than they should be, so are errors. What is too much of them
    belongs to the motion alone, for the noise of the encoders is known: so it counts squared.
    """
    x, P, covariance, scale = memory.x, memory.P, out[9:].reshape(6, 6), np.empty(6)
    for i in range(3):
        out[0, i], out[1, i], out[2, i] = x[C + i], x[V + i], x[F + i]
        for j in range(3):
            out[3 + i, j] = white[i, j] + lasting[i, j] + memory.constants[i, j]
            out[6 + i, j] = P[F + i, F + j]
        out[6 + i, i] += memory.constant[i]
        square = memory.squares[i]
        scale[i] = scale[3 + i] = square if square > 1.0 else np.sqrt(max(square, CALM))
    for i in range(6):
        for j in range(6):
            constants = memory.constants[i, j] if i < 3 and j < 3 else 0.0
            covariance[i, j] = scale[i] * scale[j] * P[i, j] + constants


@compiled
def learn_steps(encoders: Array, q: Array) -> None:
    """The smallest change of each encoder is its resolution: encoders (2, nj) are that and the last positions [rad]."""
    for j in range(q.shape[0]):
        step = abs(q[j] - encoders[1, j])
        if step >= 1e-9 and step < encoders[0, j]:
            encoders[0, j] = step
        encoders[1, j] = q[j]


@compiled
def learn_posture(
    rounding: Array, constants: Array, posture: Held, columns: Array, left: bool, steps: Array, idx_v: Integers,
    zeros: Array, masses: Array,
) -> None:  # fmt: skip
    """Fill in `rounding` and `constants` of `Memory` at a posture.

    Args:
        posture: `Views`.
        columns: as in `com_covariance`.
        left: the support foot is the left one.
        steps: (nj,) of the encoders [rad]; infinite where not known.
        idx_v: (nj,) columns of the joints in the velocities of the model.
        zeros: (nv,) variance of the zeros of the encoders [rad^2].
        masses: (3, 3) covariance of the COM by masses, base frame [m^2].
    """
    at, variance = posture.value, np.zeros(zeros.shape[0])
    R = at.R_left if left else at.R_right
    for j in range(steps.shape[0]):
        variance[idx_v[j]] = steps[j] ** 2 / 12.0 if np.isfinite(steps[j]) else 0.0
    rounding[:] = com_covariance(at.com, at.J_com, at.J, columns, R, variance)
    constants[:] = com_covariance(at.com, at.J_com, at.J, columns, R, zeros) + mul(R.T, mul(masses, R))
    for i in range(3):
        rounding[i, i] += LEAST**2
