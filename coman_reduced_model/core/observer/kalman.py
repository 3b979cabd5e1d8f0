# SPDX-License-Identifier: BSD-3-Clause
"""The Kalman filter of the COM: Newton's law between samples, joint encoders at each.

State (12,), in axes of the support sole: COM c [m], velocity v [m/s], apparent external force f [N], error n of the
measured COM that lasts [m]:

    c' = v,    m v' = F + m g + f,    f' = white,    n' = -n / tau + white,    z = c + n + white

F are the wrenches of the ground, an input. Springs do not appear: what the model of the springs says is what the
estimate is to judge. n is the part of the rounding of the encoders that stays, as long as the joints hardly move: a
filter that takes it as white is too sure of itself. Anchors: kinetics observer (arXiv 2406.13267), LIPM-DCM observer
with bias of mc_rtc.
"""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled, mul
from ..base.types import Array

SIZE = 12
C, V, F, N = 0, 3, 6, 9  # where the parts of the state begin


@compiled
def advance(
    x: Array, P: Array, force: Array, dt: float, mass: float, gravity: float, noise: Array, lasting: Array, tau: float
) -> None:
    """Bring state x (12,) and covariance P (12, 12) to the next sample, in place.

    Args:
        x, P: at the last sample.
        force: (3,) of the ground on both feet, mean since then [N].
        dt: since then [s].
        mass, gravity: [kg], [m/s^2].
        noise: (2, 3) intensities: of the force [N^2 s], and of the random walk of f [N^2 / s].
        lasting: (3, 3) covariance of n [m^2].
        tau: time constant of n [s].
    """
    keep, far, fast = np.exp(-dt / tau), 0.5 * dt * dt / mass, dt / mass
    for i in range(3):
        push = force[i] / mass - (gravity if i == 2 else 0.0)
        x[C + i] += dt * x[V + i] + 0.5 * dt * dt * (push + x[F + i] / mass)
        x[V + i] += dt * (push + x[F + i] / mass)
        x[N + i] *= keep
    _lead(P, dt, far, fast, keep)
    _lead(P.T, dt, far, fast, keep)
    for i in range(3):
        q = noise[0, i] / mass**2
        P[C + i, C + i] += q * dt**3 / 3.0
        P[V + i, V + i] += q * dt
        P[C + i, V + i] += 0.5 * q * dt * dt
        P[V + i, C + i] += 0.5 * q * dt * dt
        P[F + i, F + i] += noise[1, i] * dt
        for j in range(3):
            P[N + i, N + j] += (1.0 - keep * keep) * lasting[i, j]


@compiled
def _lead(P: Array, dt: float, far: float, fast: float, keep: float) -> None:
    """Multiply P by the matrix that leads from sample to sample, in place."""
    for i in range(3):
        for j in range(SIZE):
            P[C + i, j] += dt * P[V + i, j] + far * P[F + i, j]
            P[V + i, j] += fast * P[F + i, j]
            P[N + i, j] *= keep


@compiled
def correct(x: Array, P: Array, measured: Array, R: Array, squares: Array) -> float:
    """Take in the measured COM (3,) [m] with white noise R (3, 3) [m^2]; x and P in place.

    squares (3,) become those of the innovations, each in its own variance [1].

    Returns:
        The normalised innovation squared (NIS), 3 on average if all is as assumed.
    """
    S, off = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        off[i] = measured[i] - x[C + i] - x[N + i]
        for j in range(3):
            S[i, j] = R[i, j] + P[C + i, C + j] + P[C + i, N + j] + P[N + i, C + j] + P[N + i, N + j]
        squares[i] = off[i] * off[i] / S[i, i]
    inverse = inverse_of_3(S)
    PH = np.empty((SIZE, 3))
    for i in range(SIZE):
        for j in range(3):
            PH[i, j] = P[i, C + j] + P[i, N + j]
    gain = mul(PH, inverse)
    nis = 0.0
    for i in range(3):
        for j in range(3):
            nis += off[i] * inverse[i, j] * off[j]
    for i in range(SIZE):
        for j in range(3):
            x[i] += gain[i, j] * off[j]
        for k in range(i, SIZE):
            less = 0.0
            for j in range(3):
                less += gain[i, j] * PH[k, j]
            P[i, k] -= less
            P[k, i] = P[i, k]
    return nis


@compiled
def inverse_of_3(S: Array) -> Array:
    """The inverse of a matrix (3, 3)."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            out[i, j] = S[a, c] * S[b, d] - S[a, d] * S[b, c]
    det = S[0, 0] * out[0, 0] + S[0, 1] * out[1, 0] + S[0, 2] * out[2, 0]
    return out / det


@compiled
def turned(x: Array, P: Array, R: Array) -> tuple[Array, Array]:
    """State and covariance in other axes, R (3, 3) leading into them; where their origin is does not matter here."""
    B = np.zeros((SIZE, SIZE))
    for part in range(0, SIZE, 3):
        for i in range(3):
            for j in range(3):
                B[part + i, part + j] = R[i, j]
    return mul(B, x.reshape(SIZE, 1))[:, 0].copy(), mul(mul(B, P), B.T.copy())


@compiled
def net_force(R: Array, R_other: Array, own: Array, other: Array) -> Array:
    """Force (3,) [N] of the ground on both feet, axes of the support sole.

    Args:
        R, R_other: (3, 3) orientation of the support sole and of the other one in the base frame.
        own, other: wrenches on them, in their axes.
    """
    out = own[:3].copy()
    for k in range(3):
        base = R_other[k, 0] * other[0] + R_other[k, 1] * other[1] + R_other[k, 2] * other[2]
        for i in range(3):
            out[i] += R[k, i] * base
    return out


@compiled
def com_covariance(com: Array, J_com: Array, J: Array, columns: Array, R: Array, variance: Array) -> Array:
    """Covariance (3, 3) [m^2] of the measured COM in the sole frame by those of the joints, each alone.

    Args:
        com, J_com, J: of `Posture`.
        columns: of the joints between the root link and the sole.
        R: (3, 3) orientation of the sole in the base frame.
        variance: (nv,) of the joints, by columns of the Jacobians [rad^2].
    """
    out, g, s = np.zeros((3, 3)), np.empty(3), np.empty(3)
    moves_base = np.zeros(variance.shape[0], np.bool_)
    for c in columns:
        moves_base[c] = True
    for c in range(variance.shape[0]):
        if not variance[c] > 0.0:
            continue
        for i in range(3):
            g[i] = J_com[i, c]
        if moves_base[c]:
            g[0] -= J[0, c] + J[4, c] * com[2] - J[5, c] * com[1]
            g[1] -= J[1, c] + J[5, c] * com[0] - J[3, c] * com[2]
            g[2] -= J[2, c] + J[3, c] * com[1] - J[4, c] * com[0]
        for i in range(3):
            s[i] = R[0, i] * g[0] + R[1, i] * g[1] + R[2, i] * g[2]
        for i in range(3):
            for j in range(3):
                out[i, j] += variance[c] * s[i] * s[j]
    return out
