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
def step(state: Array, M_inv: Array, K: Array, D: Array, u0: Array, u1: Array, dt: float) -> Array:
    """One exact step over dt [s]; shapes as in `transition` and `advance`."""
    return advance(state, transition(M_inv, K, D, dt), np.linalg.inv(K), D, u0, u1, dt)


@njit(cache=True)
def run(state: Array, M_inv: Array, K: Array, D: Array, forces: Array, dt: float) -> Array:
    """Many steps under forces (k + 1, n) given every dt [s]; returns the states (k + 1, 2n), the first as given."""
    Phi = transition(M_inv, K, D, dt)
    K_inv = np.linalg.inv(K)
    states = np.empty((forces.shape[0], state.shape[0]))
    states[0] = state
    for i in range(forces.shape[0] - 1):
        states[i + 1] = advance(states[i], Phi, K_inv, D, forces[i], forces[i + 1], dt)
    return states
