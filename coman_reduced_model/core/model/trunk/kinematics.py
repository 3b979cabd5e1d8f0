# SPDX-License-Identifier: BSD-3-Clause
"""Kinematics and inertia of the trunk on its legs, with all six freedoms; `model.py` has the physics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...base.compiled import Held, compiled
from ...base.types import Array, Foot, Integers
from ...robot.leg import add_gravity_stiffness
from .contact import Linear, Sole, contacts, track
from .published import Seen, publish


@compiled
def trunk_twist(V: Array, J_joints: Array, columns: Integers) -> None:
    """Fill in V (6, n): twist of the trunk against a sole at rest, in base axes at the base origin, by a leg's joints.

    Args:
        V: filled in.
        J_joints: (6, nv) of `Posture`: what the joints carry moves so against the trunk, the trunk the other way.
        columns: (n,) of the leg's joints.
    """
    for i in range(6):
        for j in range(columns.shape[0]):
            V[i, j] = -J_joints[i, columns[j]]


@compiled
def com_jacobian(J: Array, V: Array, columns: Integers, J_com: Array, com: Array, R: Array) -> None:
    """Fill in J (6, n): velocity of the COM and angular velocity of the trunk, in sole axes, by the joints of a leg.

    Unlike (8) the COM is that of all links: the links of the leg itself move less than the trunk.

    Args:
        J: filled in.
        V: from `trunk_twist`.
        columns: (n,) of the leg's joints.
        J_com: (3, nv) of the COM against the trunk, base axes.
        com: (3,) in the base frame [m].
        R: (3, 3) orientation of the sole in the base frame.
    """
    for i in range(columns.shape[0]):
        c = columns[i]
        a0 = V[0, i] + V[4, i] * com[2] - V[5, i] * com[1] + J_com[0, c]
        a1 = V[1, i] + V[5, i] * com[0] - V[3, i] * com[2] + J_com[1, c]
        a2 = V[2, i] + V[3, i] * com[1] - V[4, i] * com[0] + J_com[2, c]
        for k in range(3):
            J[k, i] = R[0, k] * a0 + R[1, k] * a1 + R[2, k] * a2
            J[3 + k, i] = R[0, k] * V[3, i] + R[1, k] * V[4, i] + R[2, k] * V[5, i]


class Pose(NamedTuple):
    """The robot at a posture, in base axes, the support leg and the other one: views that follow a `Posture`."""

    com: Array  # (3,) in the base frame [m]
    J: Array  # (6, nv) of `Posture`
    J_com: Array  # (3, nv) of `Posture`
    R: Array  # (3, 3) orientation of the support sole in the base frame
    p: Array  # (3,) its position [m]
    R_other: Array
    p_other: Array
    columns: Integers  # (m,) of the legs' joints in the velocities of the model
    edges: Array  # (2, 4) of both soles, as in `contact.Sole`


class Geometry(NamedTuple):
    """How trunk, COM and soles move with the m joints of both legs, the support leg's n first, and the support sole."""

    V: Array  # (6, n) twist of the trunk by the joints of the support leg, base axes
    A: Array  # (6, 6) the same by the displacement of the support sole
    J: Array  # (6, m) velocity of the COM and angular velocity of the trunk, axes of the support sole
    J_other: Array  # (6, m - n) the same by the joints of the other leg if its sole stands, in its axes
    com: Array  # (3,) in the support sole [m]
    down: Array  # (3,) downward direction in base axes


class TrunkTerms(NamedTuple):
    """The equation of motion at one sample: `linear` with the inertia M, the joints of the support leg first."""

    theta: Array  # (m,) motor positions [rad]
    M: Array  # (m + 6, m + 6)
    linear: Linear
    geometry: Geometry


@dataclass(slots=True)
class Assembled:
    """`TrunkTerms` at one sample; all arrays are views of one, by which samples are remembered."""

    block: Array  # of `terms_size`
    terms: TrunkTerms  # views of it by `terms_of`
    held: Any  # these terms and those of the sample before, for compiled functions
    foot: Foot = Foot.NONE  # the support foot
    double: bool = False  # whether the other foot may touch the ground


def terms_size(m: int) -> int:
    """Length of the array that holds the terms of m joints."""
    d, n = m + 6, m // 2
    return m + d * d + (2 * d + 2 * m * m + 14 * d + 14 + 2) + (6 * n + 36 + 6 * m + 6 * n + 3 + 3)


@compiled
def terms_of(block: Array, m: int) -> TrunkTerms:
    """The terms of m joints in an array of `terms_size`."""
    d = m + 6
    return TrunkTerms(block[:m], block[m : m + d * d].reshape(d, d), linear_of(block, m), geometry_of(block, m))


@compiled
def linear_of(block: Array, m: int) -> Linear:
    """`linear` of these terms: all views at once would take longer than what is done with them."""
    d = m + 6
    at = m + d * d
    y, f, at = block[at : at + d], block[at + d : at + 2 * d], at + 2 * d
    K, at = block[at : at + m * m].reshape(m, m), at + m * m
    D, at = block[at : at + m * m].reshape(m, m), at + m * m
    C, at = block[at : at + 14 * d].reshape(14, d), at + 14 * d
    return Linear(y, K, D, f, C, block[at : at + 14], block[at + 14 : at + 15], block[at + 15 : at + 16])


@compiled
def geometry_of(block: Array, m: int) -> Geometry:
    """`geometry` of these terms."""
    n = m // 2
    at = block.shape[0] - (12 * n + 36 + 6 * m + 6)
    V, at = block[at : at + 6 * n].reshape(6, n), at + 6 * n
    J_other, at = block[at : at + 6 * n].reshape(6, n), at + 6 * n
    A, at = block[at : at + 36].reshape(6, 6), at + 36
    J, at = block[at : at + 6 * m].reshape(6, m), at + 6 * m
    return Geometry(V, A, J, J_other, block[at : at + 3], block[at + 3 : at + 6])


@compiled
def pose_legs(
    theta: Array, y: Array, w: Array, order: Integers, motor_q: Array, motor_qd: Array, idx_v: Integers, q: Array,
    rates: Array, v: Array,
) -> None:  # fmt: skip
    """Set the joints of the model: those of the legs by a state, the others by their motors.

    Args:
        theta: (m,) of the terms, filled in.
        y, w: (m + 6,) coordinates and their rates.
        order: (m,) indices of the legs' joints, the support leg's first.
        motor_q, motor_qd: (nj,) [rad], [rad/s].
        idx_v: (nj,) columns of the joints in the velocities of the model.
        q: (nj,) positions, filled in.
        rates: (nj,) of the joints outside the legs, zero for those in them; filled in.
        v: (nv,) velocities of the model, filled in but for the base.
    """
    m = order.shape[0]
    for j in range(q.shape[0]):
        q[j], rates[j], v[idx_v[j]] = motor_q[j], motor_qd[j], motor_qd[j]
    for i in range(m):
        j = order[i]
        theta[i], q[j], rates[j], v[idx_v[j]] = motor_q[j], y[i], 0.0, w[i]


@compiled
def take_posture(held: Held, posture: Held, ground: Array, y: Array, w: Array, dt: float, v: Array, a: Array) -> None:
    """Fill in geometry and contact of terms, and the motion of the base, the joints not accelerating.

    Args:
        held: the terms, filled in, and those of the sample before.
        posture: `Pose`.
        ground: (3,) under the other sole, as in `contact.Sole`.
        y: (m + 6,) coordinates, of which the last six displace the support sole from level ground.
        w: (m + 6,) their rates.
        dt: since the sample before [s]; 0: there is none.
        v, a: (nv,) of the model, of which the first six are filled in, in base axes.
    """
    (terms, before), pose = held.value, posture.value
    m = pose.columns.shape[0]
    n, s = m // 2, y[m:]
    g, linear, R, p, columns, others = terms.geometry, terms.linear, pose.R, pose.p, pose.columns[:n], pose.columns[n:]
    linear.y[:] = y
    edges = pose.edges[1]
    linear.reach[0] = 0.5 * min(edges[1] - edges[0], edges[3] - edges[2])
    V_other = np.empty((6, n))
    trunk_twist(g.V, pose.J, columns)
    trunk_twist(V_other, pose.J, others)
    other = Sole(pose.R_other, pose.p_other, V_other, edges, ground)
    contacts(Sole(R, p, g.V, pose.edges[0], np.zeros(3)), other, s, g.A, linear.C, linear.height)
    com_jacobian(g.J, g.V, columns, pose.J_com, pose.com, R)
    com_jacobian(g.J_other, V_other, others, pose.J_com, pose.com, pose.R_other)
    for i in range(3):
        g.down[i] = s[4] * R[i, 0] - s[3] * R[i, 1] - R[i, 2]
        g.com[i] = 0.0
        for j in range(3):
            g.com[i] += R[j, i] * (pose.com[j] - p[j])
        for c in range(n):
            g.J[i, n + c] = g.J[3 + i, n + c] = 0.0
            for j in range(3):
                g.J[i, n + c] += R[j, i] * pose.J_com[j, others[c]]
    _move_base(g, before.geometry, w, dt, v, a)


@compiled
def _move_base(g: Geometry, before: Geometry, w: Array, dt: float, v: Array, a: Array) -> None:
    """Velocity and acceleration of the base into v and a (nv,), in place; arguments as in `take_posture`."""
    n, m = g.V.shape[1], w.shape[0] - 6
    for i in range(6):
        v[i] = a[i] = 0.0
        for j in range(n):
            v[i] += g.V[i, j] * w[j]
            a[i] += (g.V[i, j] - before.V[i, j]) * w[j]
        for j in range(6):
            v[i] += g.A[i, j] * w[m + j]
            a[i] += (g.A[i, j] - before.A[i, j]) * w[m + j]
        a[i] = a[i] / dt if dt > 0.0 else 0.0


@compiled
def project_dynamics(terms: TrunkTerms, inertia: Array, tau: Array, gravity: float, columns: Integers) -> None:
    """Fill in inertia M of terms, and the forces f of weight and motion.

    Args:
        terms: with their geometry.
        inertia: (nv, nv) joint-space inertia with a free base, upper triangle.
        tau: (nv,) generalised forces of the motion without gravity.
        gravity: [m/s^2].
        columns: (m,) of the support leg and of the other one.
    """
    g, M, f, m = terms.geometry, terms.M, terms.linear.f, columns.shape[0]
    n, size = m // 2, m + 6
    base = np.zeros((6, size))  # twist of the trunk by all coordinates
    moved = np.empty((6, size))  # momentum of the robot by them
    across = np.empty((6, m))  # inertia between trunk and joints
    for i in range(6):
        for j in range(n):
            base[i, j] = g.V[i, j]
        for j in range(6):
            base[i, m + j] = g.A[i, j]
        for j in range(m):
            across[i, j] = inertia[i, columns[j]]
    for i in range(m):
        f[i] = -tau[columns[i]]
        for j in range(3):
            f[i] += across[j, i] * gravity * g.down[j]
    for i in range(6):
        f[m + i] = 0.0
    for i in range(6):
        pull = -tau[i]
        for j in range(3):
            pull += (inertia[i, j] if i <= j else inertia[j, i]) * gravity * g.down[j]
        for j in range(size):
            f[j] += base[i, j] * pull
    # N^T S N with N = [base; 1 0] and S = [inertia of all; across].
    for i in range(6):
        for j in range(size):
            moved[i, j] = across[i, j] if j < m else 0.0
        for k in range(6):
            a = inertia[i, k] if i <= k else inertia[k, i]
            for j in range(size):
                moved[i, j] += a * base[k, j]
    for i in range(size):
        for j in range(i + 1):
            M[i, j] = 0.0
            if i < m:
                a, b = columns[i], columns[j]
                M[i, j] = inertia[a, b] if a <= b else inertia[b, a]
        for k in range(6):
            for j in range(i + 1):
                M[i, j] += base[k, i] * moved[k, j]
            if i < m:
                for j in range(i + 1):
                    M[i, j] += across[k, i] * base[k, j]
        for j in range(i):
            M[j, i] = M[i, j]


@compiled
def add_gravity(g: Geometry, loads: tuple[float, float], at: Array, K: Array, f: Array) -> None:
    """`stiffness.add_gravity_stiffness` of both legs: stiffness K (m, m) and forces f (m + 6,), in place.

    The forces hold gravity at the deflected posture. With both K and f changed, gravity follows the deflection; with f
    alone it is taken where the springs are not deflected.

    Args:
        g: the geometry.
        loads: weight on the support leg and on the other one [N].
        at: (m,) deflections [rad].
        K, f: to be changed.
    """
    m = at.shape[0]
    n = m // 2
    torque = np.zeros(m)
    add_gravity_stiffness(g.J[:, :n], loads[0], at[:n], K[:n, :n], torque[:n])
    add_gravity_stiffness(g.J_other, loads[1], at[n:], K[n:, n:], torque[n:])
    for i in range(m):
        f[i] -= torque[i]


@compiled
def assemble(
    held: Held, inertia: Array, tau: Array, gravity: float, columns: Integers, K: Array, D: Array, torque: Array,
    loads: tuple[float, float], stiffness: bool,
) -> None:  # fmt: skip
    """Fill in inertia, springs and forces of terms whose geometry there is.

    Args:
        held: the terms.
        inertia, tau, gravity, columns: as in `project_dynamics`.
        K, D, torque: (m, m), (m, m), (m,) of the springs, without gravity.
        loads: weight on the support leg and on the other one [N].
        stiffness: whether gravity changes it (`gravity_stiffness`).
    """
    m, terms = columns.shape[0], held.value[0]
    linear = terms.linear
    project_dynamics(terms, inertia, tau, gravity, columns)
    linear.D[:] = D
    for i in range(m):
        linear.f[i] -= torque[i]
    deflection = linear.y[:m] - terms.theta
    if stiffness:
        linear.K[:] = K
        add_gravity(terms.geometry, loads, deflection, linear.K, linear.f)
    else:
        add_gravity(terms.geometry, loads, deflection, linear.K, linear.f)
        linear.K[:] = K


@compiled
def advance(
    held: Held, same: bool, states: Held, q: Array, order: Integers, double: bool, dt: float, seen: Seen,
    published: Array,
) -> bool:  # fmt: skip
    """`contact.track` of both states, the filter's first, by terms and those of the sample before; then `publish`.

    Args:
        held: these terms, and those before.
        same: they are of the same support foot.
        states: both, in place, and `Options` of the model.
        q: (nj,) measured link positions [rad].
        order: (m,) as in `pose_legs`.
        double: whether the other foot may touch the ground.
        dt: since the sample before [s].
        seen, published: as in `publish`, which fills the latter in.

    Returns:
        Whether the filter is finite.
    """
    m, (terms, before), (both, options) = order.shape[0], held.value, states.value
    theta, measured = np.empty(m), np.empty(m)
    for i in range(m):
        theta[i], measured[i] = before.theta[i if same else (i + m // 2) % m], q[order[i]]
    finite = track(both, terms.linear, terms.M, double, theta, terms.theta, measured, dt, options)
    publish(published, held, states, q, order, seen)
    return finite
