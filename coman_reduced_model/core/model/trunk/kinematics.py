# SPDX-License-Identifier: BSD-3-Clause
"""Kinematics and inertia of the trunk on its legs, with all six freedoms; `trunk_model` has the physics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.compiled import compiled, mul
from ...base.types import Array
from ...robot.leg import add_gravity_stiffness
from ...robot.robot import tilt
from .contact import Linear, Sole, contacts


@compiled
def trunk_twist(J_joints: Array, columns: Array) -> Array:
    """(6, n) twist of the trunk against a sole at rest, in base axes at the base origin, by the joints of the leg.

    Args:
        J_joints: (6, nv) of `Posture`: what the joints carry moves so against the trunk, the trunk the other way.
        columns: (n,) of the leg's joints.
    """
    V = np.empty((6, columns.shape[0]))
    for i in range(6):
        for j in range(columns.shape[0]):
            V[i, j] = -J_joints[i, columns[j]]
    return V


@compiled
def com_jacobian(V: Array, columns: Array, J_com: Array, com: Array, R: Array) -> Array:
    """(6, n) velocity of the COM and angular velocity of the trunk, in sole axes, by the joints of a leg.

    Unlike (8) the COM is that of all links: the links of the leg itself move less than the trunk.

    Args:
        V: from `trunk_twist`.
        columns: (n,) of the leg's joints.
        J_com: (3, nv) of the COM against the trunk, base axes.
        com: (3,) in the base frame [m].
        R: (3, 3) orientation of the sole in the base frame.
    """
    n = columns.shape[0]
    J = np.empty((6, n))
    for i in range(n):
        c = columns[i]
        a0 = V[0, i] + V[4, i] * com[2] - V[5, i] * com[1] + J_com[0, c]
        a1 = V[1, i] + V[5, i] * com[0] - V[3, i] * com[2] + J_com[1, c]
        a2 = V[2, i] + V[3, i] * com[1] - V[4, i] * com[0] + J_com[2, c]
        for k in range(3):
            J[k, i] = R[0, k] * a0 + R[1, k] * a1 + R[2, k] * a2
            J[3 + k, i] = R[0, k] * V[3, i] + R[1, k] * V[4, i] + R[2, k] * V[5, i]
    return J


class Pose(NamedTuple):
    """The robot at a posture, in base axes: the support leg and the other one."""

    mass: float  # [kg]
    com: Array  # (3,) in the base frame [m]
    inertia: Array  # (nv, nv) joint-space inertia with a free base, upper triangle
    J: Array  # (6, nv) of `Posture`
    R: Array  # (3, 3) orientation of the support sole in the base frame
    p: Array  # (3,) its position [m]
    columns: Array  # (n,) of the support leg's joints in the velocities of the model
    edges: Array  # (4,) of the support sole, as in `contact.Sole`
    R_other: Array
    p_other: Array
    columns_other: Array
    edges_other: Array
    ground_other: Array  # (3,) as in `contact.Sole`


class Geometry(NamedTuple):
    """How trunk, COM and soles move with the m joints of both legs, the support leg's n first, and the support sole."""

    V: Array  # (6, n) twist of the trunk by the joints of the support leg, base axes
    A: Array  # (6, 6) the same by the displacement of the support sole
    C: Array  # (14, m + 6) as in `contact.Linear`
    height: Array  # (14,)
    J: Array  # (6, m) velocity of the COM and angular velocity of the trunk, axes of the support sole
    J_other: Array  # (6, m - n) the same by the joints of the other leg if its sole stands, in its axes
    com: Array  # (3,) in the support sole [m]
    down: Array  # (3,) downward direction in base axes


class TrunkTerms(NamedTuple):
    """The equation of motion at one sample: `linear` with the inertia M, the joints of the support leg first."""

    foot: int  # the support foot
    double: bool  # whether the other foot may touch the ground
    theta: Array  # (m,) motor positions [rad]
    M: Array  # (m + 6, m + 6)
    linear: Linear
    geometry: Geometry


@compiled
def geometry(pose: Pose, s: Array) -> Geometry:
    """The geometry at a posture, the support sole displaced by s (6,) from level ground [m], [rad]."""
    n, k = pose.columns.shape[0], pose.columns_other.shape[0]
    R, p = pose.R, pose.p
    J_com = pose.inertia[:3] / pose.mass  # the base is the origin of the axes in which the momentum is expressed
    V, V_o = trunk_twist(pose.J, pose.columns), trunk_twist(pose.J, pose.columns_other)
    other = Sole(pose.R_other, pose.p_other, V_o, pose.edges_other, pose.ground_other)
    A, C, height = contacts(Sole(R, p, V, pose.edges, np.zeros(3)), other, s)
    J = np.zeros((6, n + k))
    J[:, :n] = com_jacobian(V, pose.columns, J_com, pose.com, R)
    com, down = np.zeros(3), np.zeros(3)
    for i in range(3):
        down[i] = s[4] * R[i, 0] - s[3] * R[i, 1] - R[i, 2]
        for j in range(3):
            com[i] += R[j, i] * (pose.com[j] - p[j])
            for c in range(k):
                J[i, n + c] += R[j, i] * J_com[j, pose.columns_other[c]]
    J_other = com_jacobian(V_o, pose.columns_other, J_com, pose.com, pose.R_other)
    return Geometry(V, A, C, height, J, J_other, com, down)


@compiled
def base_motion(V: Array, A: Array, V_before: Array, A_before: Array, w: Array, dt: float, v: Array, a: Array) -> None:
    """Velocity and acceleration of the base into v and a (nv,), in place; the joints do not accelerate.

    Args:
        V, A: of `Geometry`; V_before, A_before: of the sample before.
        w: (m + 6,) rates of joints and support sole.
        dt: since the sample before [s]; 0: there is none.
    """
    n, m = V.shape[1], w.shape[0] - 6
    for i in range(6):
        v[i] = a[i] = 0.0
        for j in range(n):
            v[i] += V[i, j] * w[j]
            a[i] += (V[i, j] - V_before[i, j]) * w[j]
        for j in range(6):
            v[i] += A[i, j] * w[m + j]
            a[i] += (A[i, j] - A_before[i, j]) * w[m + j]
        a[i] = a[i] / dt if dt > 0.0 else 0.0


@compiled
def add_gravity(J: Array, J_o: Array, load: float, load_o: float, at: Array, K: Array, f: Array) -> None:
    """`stiffness.add_gravity_stiffness` of both legs: stiffness K (m, m) and forces f (m + 6,), in place.

    The forces hold gravity at the deflected posture. With both K and f changed, gravity follows the deflection; with f
    alone it is taken where the springs are not deflected.

    Args:
        J, J_o: J and J_other of `Geometry`.
        load, load_o: weight on the support leg and on the other one [N].
        at: (m,) deflections [rad].
    """
    n, m = at.shape[0] - J_o.shape[1], at.shape[0]
    torque = np.zeros(m)
    add_gravity_stiffness(J[:, :n], load, at[:n], K[:n, :n], torque[:n])
    add_gravity_stiffness(J_o, load_o, at[n:], K[n:, n:], torque[n:])
    for i in range(m):
        f[i] -= torque[i]


@compiled
def com_and_tilt(com: Array, J: Array, R: Array, up: Array, off: Array, w: Array) -> Array:
    """COM and its velocity, roll and pitch of the trunk (8,) [m], [m/s], [rad] of a state.

    Args:
        com, J: of `Geometry`.
        R, up: orientation (3, 3) of the support sole and z (3,) of the trunk in the base frame.
        off: (m + 6,) coordinates less those of that posture.
        w: (m + 6,) their rates.
    """
    out, m = np.zeros(8), J.shape[1]
    for i in range(3):
        out[i] = com[i]
        for j in range(m):
            out[i] += J[i, j] * off[j]
            out[3 + i] += J[i, j] * w[j]
    out[6], out[7] = tilt(R, up)
    for i in range(2):
        for j in range(m):
            out[6 + i] += J[3 + i, j] * off[j]
    return out


@compiled
def project_dynamics(
    inertia: Array, tau: Array, down: Array, V: Array, A: Array, columns: Array, columns_other: Array
) -> tuple[Array, Array]:
    """Inertia (m + 6, m + 6) of the coordinates, and the forces (m + 6,) of weight and motion on them.

    Args:
        inertia: (nv, nv) joint-space inertia with a free base, upper triangle.
        tau: (nv,) generalised forces of the motion without gravity.
        down: (3,) gravity in base axes [m/s^2].
        V, A: of `Geometry`.
        columns, columns_other: (n,), (m - n,) of the support leg and of the other one.
    """
    n, k = columns.shape[0], columns_other.shape[0]
    m = n + k
    index = np.empty(6 + m, dtype=np.int64)
    for i in range(6):
        index[i] = i
    for i in range(n):
        index[6 + i] = columns[i]
    for i in range(k):
        index[6 + n + i] = columns_other[i]
    base = np.zeros((6, m + 6))  # twist of the trunk by all coordinates
    for i in range(6):
        for j in range(n):
            base[i, j] = V[i, j]
        for j in range(6):
            base[i, m + j] = A[i, j]
    S, f = np.empty((6 + m, 6 + m)), np.zeros(m + 6)
    for i in range(6 + m):
        for j in range(6 + m):
            a, b = index[i], index[j]
            S[i, j] = inertia[a, b] if a <= b else inertia[b, a]
    for i in range(m):
        f[i] = -tau[index[6 + i]]
        for j in range(3):
            f[i] += S[j, 6 + i] * down[j]
    for i in range(6):
        pull = -tau[i]
        for j in range(3):
            pull += S[j, i] * down[j]
        for j in range(m + 6):
            f[j] += base[i, j] * pull
    # N^T S N with N = [base; 1 0].
    SN = mul(S[:, :6].copy(), base)
    for i in range(6 + m):
        for j in range(m):
            SN[i, j] += S[i, 6 + j]
    M = mul(base.T, SN[:6])
    for i in range(m):
        for j in range(m + 6):
            M[i, j] += SN[6 + i, j]
    return M, f
