# SPDX-License-Identifier: BSD-3-Clause
"""Exact steps of M x'' + D x' + K x = u(t) with u linear over the step: stable for any step, whatever the stiffness.

The particular solution for a ramp u = u0 + du t is x_p = K^-1 (u - D K^-1 du), x_p' = K^-1 du; what is left decays
with the matrix exponential. No term of the step size is dropped, so that the sample rate does not matter.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .types import Array


@njit(cache=True)
def expm(A: Array) -> Array:
    """Matrix exponential of a small matrix (n, n) by scaling and squaring with a Taylor series of degree 12."""
    n = A.shape[0]
    norm = 0.0
    for i in range(n):
        norm = max(norm, np.abs(A[i]).sum())
    squarings = 0
    while norm > 0.5 and squarings < 60:
        norm *= 0.5
        squarings += 1
    B = A / 2.0**squarings
    E = np.eye(n)
    for k in range(12, 0, -1):  # Horner
        E = B @ E / k
        for i in range(n):
            E[i, i] += 1.0
    for _ in range(squarings):
        E = E @ E
    return E


@njit(cache=True)
def transition(M_inv: Array, K: Array, D: Array, dt: float) -> Array:
    """(2n, 2n) transition of the free motion [x; x'] over dt [s]; M_inv, K, D are (n, n)."""
    n = K.shape[0]
    MK = M_inv @ K
    MD = M_inv @ D
    # Velocities are measured in units of the fastest frequency, which balances the matrix and saves squarings.
    omega = 1.0
    for i in range(n):
        omega = max(omega, np.sqrt(abs(MK[i, i])))
    A = np.zeros((2 * n, 2 * n))
    for i in range(n):
        A[i, n + i] = omega * dt
        for j in range(n):
            A[n + i, j] = -MK[i, j] * dt / omega
            A[n + i, n + j] = -MD[i, j] * dt
    E = expm(A)
    E[:n, n:] /= omega
    E[n:, :n] *= omega
    return E


@njit(cache=True)
def advance(state: Array, Phi: Array, K_inv: Array, D: Array, u0: Array, u1: Array, dt: float) -> Array:
    """One step of [x; x'] (2n,) under a force that goes linearly from u0 to u1 (n,) in dt [s]."""
    n = K_inv.shape[0]
    rate = K_inv @ ((u1 - u0) / dt)
    lag = K_inv @ (D @ rate)
    start = K_inv @ u0 - lag
    end = K_inv @ u1 - lag
    offset = state.copy()
    offset[:n] -= start
    offset[n:] -= rate
    out = Phi @ offset
    out[:n] += end
    out[n:] += rate
    return out


@njit(cache=True)
def select(M: Array, K: Array, D: Array, axes: Array) -> tuple[Array, Array, Array]:
    """M^-1, K and D (n, n) of the integrated axes (n,) alone."""
    n = axes.shape[0]
    Ms, Ks, Ds = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            Ms[i, j] = M[axes[i], axes[j]]
            Ks[i, j] = K[axes[i], axes[j]]
            Ds[i, j] = D[axes[i], axes[j]]
    return np.linalg.inv(Ms), Ks, Ds


@njit(cache=True)
def step(state: Array, M: Array, K: Array, D: Array, axes: Array, u0: Array, u1: Array, dt: float) -> Array:
    """One exact step over dt [s] of the axes that are integrated.

    Args:
        state: (2d,) all coordinates and their velocities; those not in `axes` are returned as they are.
        M, K, D: (d, d).
        axes: (n,) indices of the integrated coordinates.
        u0, u1: (d,) force at the start and at the end.
        dt: [s].
    """
    d, n = K.shape[0], axes.shape[0]
    M_inv, Ks, Ds = select(M, K, D, axes)
    reduced, first, last = np.empty(2 * n), np.empty(n), np.empty(n)
    for i in range(n):
        reduced[i], reduced[n + i] = state[axes[i]], state[d + axes[i]]
        first[i], last[i] = u0[axes[i]], u1[axes[i]]
    reduced = advance(reduced, transition(M_inv, Ks, Ds, dt), np.linalg.inv(Ks), Ds, first, last, dt)
    out = state.copy()
    for i in range(n):
        out[axes[i]], out[d + axes[i]] = reduced[i], reduced[n + i]
    return out


@njit(cache=True)
def run(
    state: Array, M: Array, K: Array, D: Array, axes: Array, force: Array, moved: Array, faster: Array, dt: float
) -> Array:
    """Many equal steps while the reference goes its way and all else stays: the end state (2d,).

    Args:
        state, M, K, D, axes: as in `step`.
        force: (d,) at the start.
        moved, faster: (k + 1, d) displacement and change of velocity of the reference since the start, every dt.
        dt: [s].
    """
    d, n = K.shape[0], axes.shape[0]
    M_inv, Ks, Ds = select(M, K, D, axes)
    Phi, K_inv = transition(M_inv, Ks, Ds, dt), np.linalg.inv(Ks)
    reduced = np.empty(2 * n)
    for i in range(n):
        reduced[i], reduced[n + i] = state[axes[i]], state[d + axes[i]]
    forces = np.empty((moved.shape[0], n))
    for k in range(moved.shape[0]):
        u = force + K @ moved[k] + D @ faster[k]
        for i in range(n):
            forces[k, i] = u[axes[i]]
    for k in range(moved.shape[0] - 1):
        reduced = advance(reduced, Phi, K_inv, Ds, forces[k], forces[k + 1], dt)
    out = state.copy()
    for i in range(n):
        out[axes[i]], out[d + axes[i]] = reduced[i], reduced[n + i]
    return out
