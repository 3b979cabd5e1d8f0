# SPDX-License-Identifier: BSD-3-Clause
"""Exact steps of M x'' + D x' + K x = u(t) with u linear over the step: stable for any step, whatever the stiffness.

With z = [x; x'] and z' = A z + B u the step is z1 = e^(A dt) z0 + dt phi_1 B u0 + dt phi_2 B (u1 - u0), where
phi_1(Z) = (e^Z - 1) / Z and phi_2(Z) = (phi_1(Z) - 1) / Z (exponential integrators; Hochbruck and Ostermann, 2010).
No term of the step size is dropped, so that the sample rate does not matter; K may be singular or negative.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import apply, compiled, inverse, mul, mul_into
from ..base.types import Array, Integers


@compiled
def phi_functions(Z: Array) -> tuple[Array, Array, Array]:
    """e^Z, phi_1(Z), phi_2(Z) of a small matrix (n, n), by scaling and squaring with a Taylor series of degree 12."""
    n = Z.shape[0]
    norm = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(Z[i, j])
        norm = max(norm, row)
    squarings = 0
    while norm > 0.5 and squarings < 60:
        norm *= 0.5
        squarings += 1
    part, other = np.empty((n, n)), np.empty((n, n))
    phi_2 = np.zeros((n, n))
    for i in range(n):
        phi_2[i, i] = 1.0 / 14.0
        for j in range(n):
            part[i, j] = Z[i, j] / 2.0**squarings
    for k in range(13, 1, -1):  # Horner: 1/2 (1 + Z/3 (1 + Z/4 (...)))
        mul_into(other, part, phi_2)
        phi_2, other = other, phi_2
        for i in range(n):
            phi_2[i, i] += 1.0
            for j in range(n):
                phi_2[i, j] /= k
    phi_1 = mul(part, phi_2)
    for i in range(n):
        phi_1[i, i] += 1.0
    E = mul(part, phi_1)
    for i in range(n):
        E[i, i] += 1.0
    square, shifted = np.empty((n, n)), np.empty((n, n))
    for _ in range(squarings):
        mul_into(square, phi_1, phi_1)
        mul_into(shifted, E, phi_1)
        for i in range(n):
            for j in range(n):
                phi_2[i, j] = 0.25 * square[i, j] + 0.5 * phi_2[i, j]
                phi_1[i, j] = 0.5 * (phi_1[i, j] + shifted[i, j])
        mul_into(other, E, E)
        E, other = other, E
    return E, phi_1, phi_2


@compiled
def transition(M_inv: Array, K: Array, D: Array, dt: float) -> tuple[Array, Array, Array]:
    """What one step of dt [s] does: [x; x'] -> E [x; x'] + G_0 u_0 + G_1 u_1.

    Args:
        M_inv, K, D: (n, n).
        dt: [s].

    Returns:
        E (2n, 2n), G_0 and G_1 (2n, n).
    """
    n = K.shape[0]
    MK, MD = mul(M_inv, K), mul(M_inv, D)
    # Velocities are measured in units of the fastest frequency, which balances the matrix and saves squarings.
    omega = 1.0
    for i in range(n):
        omega = max(omega, np.sqrt(abs(MK[i, i])))
    Z = np.zeros((2 * n, 2 * n))
    for i in range(n):
        Z[i, n + i] = omega * dt
        for j in range(n):
            Z[n + i, j] = -MK[i, j] * dt / omega
            Z[n + i, n + j] = -MD[i, j] * dt
    E, phi_1, phi_2 = phi_functions(Z)
    G_0, G_1 = np.zeros((2 * n, n)), np.zeros((2 * n, n))
    for i in range(2 * n):
        scale = dt / omega if i < n else dt
        for j in range(n):
            for k in range(n):
                G_1[i, j] += scale * phi_2[i, n + k] * M_inv[k, j]
                G_0[i, j] += scale * (phi_1[i, n + k] - phi_2[i, n + k]) * M_inv[k, j]
    for i in range(n):
        for j in range(n):
            E[i, n + j] /= omega
            E[n + i, j] *= omega
    return E, G_0, G_1


@compiled
def advance(z: Array, E: Array, G_0: Array, G_1: Array, u_0: Array, u_1: Array) -> Array:
    """[x; x'] (2n,) after one step of `transition` under a force that goes linearly from u_0 to u_1 (n,)."""
    out = np.empty(z.shape[0])
    advance_into(out, z, E, G_0, G_1, u_0, u_1)
    return out


@compiled
def advance_into(out: Array, z: Array, E: Array, G_0: Array, G_1: Array, u_0: Array, u_1: Array) -> None:
    """`advance` into an array that there is already."""
    for i in range(z.shape[0]):
        out[i] = 0.0
        for j in range(z.shape[0]):
            out[i] += E[i, j] * z[j]
        for j in range(u_0.shape[0]):
            out[i] += G_0[i, j] * u_0[j] + G_1[i, j] * u_1[j]


@compiled
def select(A: Array, axes: Integers) -> Array:
    """Rows and columns `axes` (n,) of A (d, d): (n, n)."""
    n = axes.shape[0]
    B = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            B[i, j] = A[axes[i], axes[j]]
    return B


class Forcing(NamedTuple):
    """What drives M x'' = f + K (p - x) + D (p' - x') at one instant, in d coordinates."""

    K: Array  # (d, d)
    D: Array  # (d, d)
    force: Array  # (d,) f + K p + D p'
    p: Array  # (d,) what pulls
    v: Array  # (d,) its velocity


@compiled
def step(state: Array, M: Array, axes: Integers, start: Forcing, end: Forcing, dt: float) -> Array:
    """One step over dt [s] of M x'' = f + K (p - x) + D (p' - x'), where f, K, D, p and p' go from start to end.

    Exact where K and D stay and p' is constant. Changing K and D count with their mean, which is of second order in dt.
    Where p bends, the force is linear in time with the mean that the cubic p(t) through both ends gives it: p' linear
    between noisy or distant samples would not add up to the way that p has gone.

    Args:
        state: (2d,) all coordinates and their velocities; those not in `axes` are returned as they are.
        M: (d, d).
        axes: (n,) indices of the integrated coordinates.
        start, end: what drives it at the beginning and the end.
        dt: [s].

    Returns:
        The state at the end (2d,).
    """
    K_0, D_0, force_0, p_0, v_0 = start
    K_1, D_1, force_1, p_1, v_1 = end
    d, n = M.shape[0], axes.shape[0]
    K, D, u_0, u_1 = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n)
    z = np.empty(2 * n)
    # Mean of the cubic less that of the straight line, for p and for p'.
    bend, lag = np.zeros(d), np.zeros(d)
    if dt > 0.0:
        for j in range(d):
            bend[j] = dt / 12.0 * (v_0[j] - v_1[j])
            lag[j] = (p_1[j] - p_0[j]) / dt - 0.5 * (v_0[j] + v_1[j])
    for i in range(n):
        a = axes[i]
        z[i], z[n + i] = state[a], state[d + a]
        u_0[i], u_1[i] = force_0[a], force_1[a]
        for j in range(d):
            # Half the change of K and D acts on p - x: written for p it belongs to the force.
            dK, dD = 0.5 * (K_1[a, j] - K_0[a, j]), 0.5 * (D_1[a, j] - D_0[a, j])
            u_0[i] += dK * p_0[j] + dD * v_0[j]
            u_1[i] -= dK * p_1[j] + dD * v_1[j]
            more = 0.5 * (K_0[a, j] + K_1[a, j]) * bend[j] + 0.5 * (D_0[a, j] + D_1[a, j]) * lag[j]
            u_0[i] += more
            u_1[i] += more
        for j in range(n):
            K[i, j], D[i, j] = 0.5 * (K_0[a, axes[j]] + K_1[a, axes[j]]), 0.5 * (D_0[a, axes[j]] + D_1[a, axes[j]])
    E, G_0, G_1 = transition(inverse(select(M, axes)), K, D, dt)
    z = advance(z, E, G_0, G_1, u_0, u_1)
    out = state.copy()
    for i in range(n):
        out[axes[i]], out[d + axes[i]] = z[i], z[n + i]
    return out


@compiled
def extrapolate(forcing: Forcing, dt: float) -> Forcing:
    """The forcing dt [s] later (or earlier), if the reference goes on at its velocity and all else stays."""
    way = forcing.v * dt
    return Forcing(forcing.K, forcing.D, forcing.force + apply(forcing.K, way), forcing.p + way, forcing.v)


@compiled
def free_run_step(
    state: Array, M: Array, axes: Integers, following: Integers, start: Forcing, end: Forcing, dt: float
) -> Array:
    """One step of the free run of the point mass.

    Arguments and result as in `step`, with d = 3; the coordinates `following` (k,) are those of the reference.
    """
    out = step(state, M, axes, start, end, dt)
    for axis in following:
        out[axis], out[3 + axis] = end.p[axis], end.v[axis]
    return out


@compiled
def free_run_switch(
    state: Array,
    M: Array,
    axes: Integers,
    following: Integers,
    forcing: Forcing,
    dt: float,
    R: Array,
    moved: Array,
) -> Array:
    """The state (6,) of the free run when the support changes, in the frame of the new sole.

    Args:
        state, forcing: of the last sample before the change, in the frame of the old sole.
        M, axes, following: as in `free_run_step`.
        dt: from that sample to the change [s].
        R, moved: pose (3, 3), (3,) [m] of the old sole in the new one.
    """
    state = free_run_step(state, M, axes, following, forcing, extrapolate(forcing, dt), dt)
    out = np.empty(6)
    for i in range(3):
        out[i], out[3 + i] = moved[i], 0.0
        for j in range(3):
            out[i] += R[i, j] * state[j]
            out[3 + i] += R[i, j] * state[3 + j]
    return out
