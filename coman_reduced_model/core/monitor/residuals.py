# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of one sample, compiled, and their sums over a support phase; `Laws` turns the sums into channels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import Held, Record, Records, apply, compiled
from ..base.types import Array
from .channels import COMMON
from .forces import Feet, take_forces, take_wrenches

_EDGE = 0.004  # [m] from the edge of a sole: nearer, the sole stands on its edge
_MOMENT, _FEET, _SLIDE, _TILT, _UNLOADED_LEFT, _UNLOADED_RIGHT, _PLAN = (
    COMMON.index(name)
    for name in ("moment/x", "feet/z", "feet/slide_x", "tilt/roll", "unloaded/left/fx", "unloaded/right/fx", "plan/x")
)

# One leg joint. "Needed" is the torque that balances ground forces and weight, the static deflection torque / k.
JOINT = np.dtype(
    [
        ("index", np.int64),  # in vectors of joint positions
        ("column", np.int64),  # in Jacobians
        ("left", np.bool_),
        ("stiffness", np.float64),  # [Nm/rad]
        ("time_constant", np.float64),  # damping / stiffness [s]
        # At the last look, and at the one before it.
        ("position", np.float64),  # of the link [rad]
        ("position_before", np.float64),
        ("needed", np.float64),  # [Nm]
        ("needed_before", np.float64),
        ("torque_residual", np.float64),  # measured - needed [Nm]
        ("static_deflection", np.float64),  # by the measured torque [rad]
        ("deflection", np.float64),  # the same of a spring with its damper [rad]
    ],
    align=True,
)
# Sums over the looks of a phase, one a leg joint.
JOINT_SUMS = np.dtype(
    [
        ("static_deflection", np.float64),  # by the measured torque, else by the needed one [rad]
        ("posture", np.float64),  # motor position, else link position [rad]
        ("posture_first", np.float64),  # no sums, but the values at the first and the last look
        ("posture_last", np.float64),
        # drag
        ("work", np.float64),  # of the torque residual along the displacement [J]
        ("distance", np.float64),  # both ways together [rad]
        # stiffness: deflection of the spring with its damper, residual of the spring law, and rate of the deflection
        ("deflection", np.float64),
        ("deflection_2", np.float64),
        ("spring_residual", np.float64),
        ("deflection_residual", np.float64),  # product
        ("rate", np.float64),
        ("rate_2", np.float64),
        # late: torque residual, needed torque and its rate, at looks with one before and one after
        ("delay_looks", np.float64),
        ("residual", np.float64),
        ("residual_2", np.float64),
        ("needed_rate", np.float64),
        ("needed_rate_2", np.float64),
        ("residual_rate", np.float64),  # product
        ("needed", np.float64),
        ("needed_2", np.float64),
    ]
)
# Channels as far as they are means: their residual at the last look, its sum over the phase, and at the first and last
# look the quantity of which the change counts.
RESIDUAL = np.dtype([("now", np.float64), ("sum", np.float64), ("first", np.float64), ("last", np.float64)])


class Look(NamedTuple):
    """One sample and the posture and prediction made of it."""

    on_left: bool  # the left foot is the support foot
    q: Array  # (n,) link positions [rad]
    motor: Array  # (n,) motor positions, or NaN [rad]
    torque: Array  # (n,) measured, or NaN [Nm]
    J: Array  # of the soles, as in `Posture`
    J_com: Array  # of the COM, as in `Posture`
    com: Array  # (3,) by the motor positions, in the support sole frame [m]
    plan: Array  # (3,) COM of com/reference in odom, or NaN [m]
    T_odom_sole: Array  # (4, 4) support sole in com/reference


class Sums(NamedTuple):
    """What is updated at a look."""

    joints: Records  # `JOINT` (nl,)
    sums: Records  # `JOINT_SUMS` (nl,)
    residuals: Records  # `RESIDUAL` (n,)


@compiled
def take_look(
    held: Held,
    posture: Held,
    on_left: bool,
    wrenches: tuple[Array, Array],
    joints: tuple[Array, Array, Array],
    planned: tuple[Array, Array, Array],
    imu: tuple[Array, Array],
    stamp: int,
    looks: int,
    interval: tuple[float, float],
) -> bool:
    """Add one look to the balance of forces and to the sums of the phase: one call, for calls cost as much as the work.

    Args:
        held: balance of forces and `Sums`, updated.
        posture: `Posture.views`.
        on_left: the left foot is the support foot.
        wrenches: on the left and the right sole, as in `Feet`.
        joints: q, motor and torque, as in `Look`.
        planned: com, plan and T_odom_sole, as in `Look`.
        imu: orientation (4,) of the IMU against the ground, quaternion x y z w, NaN: not known; and its rotation (3, 3)
            in the base frame.
        stamp: [ns].
        looks: before this one in the phase.
        interval: time since the last look, and of that one since the one before it; 0: not known [s].

    Returns:
        Whether the support foot stands on its edge.
    """
    (memory, sums), at, (dt, dt_before) = held.value, posture.value, interval
    feet = Feet(at.R_left, at.p_left, at.R_right, at.p_right, at.com, *wrenches)
    look = Look(on_left, *joints, at.J, at.J_com, *planned)
    R_ground_base = _mul_transposed(_rotation(imu[0]), imu[1])
    take_forces(memory, stamp, on_left, feet, R_ground_base)
    return _add_look(sums, memory.soles, memory.weight, feet, look, R_ground_base[2], looks, dt, dt_before)


@compiled
def feel(held: Held, stamp: int, left: Array, right: Array) -> None:
    """`ForceBalance.feel`; held as for `take_look`, stamp in ns."""
    take_wrenches(held.value[0], stamp, left, right)


@compiled
def _rotation(q: Array) -> Array:
    """(3, 3) of a unit quaternion x y z w."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)
    return R


@compiled
def _mul_transposed(A: Array, B: Array) -> Array:
    """A (3, 3) by the transpose of B (3, 3)."""
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]
    return C


@compiled
def _add_look(
    memory: Sums,
    soles: Array,
    weight: float,
    feet: Feet,
    look: Look,
    up: Array,
    looks: int,
    dt: float,
    dt_before: float,
) -> bool:
    """The sums of the phase; `up` (3,): vertical in the base frame by the IMU, or NaN."""
    joints, sums, residuals = memory.joints, memory.sums, memory.residuals
    left, right = _about_base(feet.R_left, feet.p_left, feet.left), _about_base(feet.R_right, feet.p_right, feet.right)
    R = feet.R_left if look.on_left else feet.R_right
    nl = joints.shape[0]
    measured = False  # some drivers fill the field with zeros for lack of a sensor
    for i in range(nl):
        measured |= look.torque[joints[i].index] != 0.0
    for i in range(nl):
        joint, total = joints[i], sums[i]
        q, motor = look.q[joint.index], look.motor[joint.index]
        torque, deflection = look.torque[joint.index] if measured else np.nan, motor - q
        needed = _needed_torque(joint, look, weight, R, left if joint.left else right)
        if looks > 1:
            _add_drag(joint, total, q)
            if dt > 0.0 and dt_before > 0.0:
                _add_delay(joint, total, (needed - joint.needed_before) / (dt + dt_before))
        static = (needed if np.isnan(torque) else torque) / joint.stiffness
        residuals[i].now, residuals[nl + i].now = deflection - static, torque - needed
        residuals[i].last = joint.time_constant * deflection
        joint.torque_residual = torque - needed
        joint.position_before, joint.position = joint.position, q
        joint.needed_before, joint.needed = joint.needed, needed
        _add_spring(joint, total, torque / joint.stiffness, deflection, dt)
        total.static_deflection += static
        total.posture_last = q if np.isnan(motor) else motor
        total.posture += total.posture_last
        if looks == 0:
            total.posture_first = total.posture_last
    _common_residuals(residuals[2 * nl :], feet, look, up, R, left, right)
    for i in range(residuals.shape[0]):
        residuals[i].sum += residuals[i].now
        if looks == 0:
            residuals[i].first = residuals[i].last
    stance, edges = (feet.left, soles[0]) if look.on_left else (feet.right, soles[1])
    return _on_edge(stance, edges, 0.01 * weight)


@compiled
def _about_base(R: Array, p: Array, wrench: Array) -> Array:
    """A wrench (6,) on a sole in its own frame, expressed in base axes about the base origin."""
    force, moment = apply(R, wrench[:3]), apply(R, wrench[3:])
    out = np.empty(6)
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        out[k] = force[k]
        out[3 + k] = moment[k] + (p[a] * force[b] - p[b] * force[a])
    return out


@compiled
def _needed_torque(joint: Record, look: Look, weight: float, R: Array, wrench: Array) -> float:
    """Torque [Nm] that balances the weight [N], z up along the sole R, and the wrench (6,) on the leg's foot."""
    needed, c = 0.0, joint.column
    for k in range(3):
        needed += weight * R[k, 2] * look.J_com[k, c]
        needed -= look.J[k, c] * wrench[k] + look.J[3 + k, c] * wrench[3 + k]
    return needed


@compiled
def _add_drag(joint: Record, total: Record, q: float) -> None:
    """Work of the torque residual at the last look, along the displacement of the link around it."""
    displacement = 0.5 * (q - joint.position_before)
    total.work += joint.torque_residual * displacement
    total.distance += abs(displacement)


@compiled
def _add_delay(joint: Record, total: Record, rate: float) -> None:
    """Torque residual at the last look and rate of the needed torque around it, which its noise does not enter."""
    residual, needed = joint.torque_residual, joint.needed
    total.delay_looks += 1.0
    total.residual += residual
    total.residual_2 += residual * residual
    total.needed_rate += rate
    total.needed_rate_2 += rate * rate
    total.residual_rate += residual * rate
    total.needed += needed
    total.needed_2 += needed * needed


@compiled
def _add_spring(joint: Record, total: Record, static: float, measured: float, dt: float) -> None:
    """Residual of the spring law against the deflection [rad] of a spring with its damper by the measured torque."""
    deflection, rate = static, 0.0
    if dt > 0.0 and not np.isnan(joint.deflection):  # exact for torques that are linear between looks
        tau = joint.time_constant
        kept = np.exp(-dt / tau) if tau > 0.0 else 0.0
        lag = tau * (1.0 - kept) / dt
        deflection = kept * joint.deflection + (1.0 - lag) * static + (lag - kept) * joint.static_deflection
        rate = (deflection - joint.deflection) / dt
    joint.static_deflection, joint.deflection = static, deflection
    residual = measured - deflection
    total.deflection += deflection
    total.deflection_2 += deflection * deflection
    total.spring_residual += residual
    total.deflection_residual += deflection * residual
    total.rate += rate
    total.rate_2 += rate * rate


@compiled
def _common_residuals(
    out: Records, feet: Feet, look: Look, vertical: Array, R: Array, left: Array, right: Array
) -> None:
    """Residuals of the channels `COMMON`; left and right wrenches (6,) in base axes about the base origin."""
    force, moment = left[:3] + right[:3], left[3:] + right[3:]
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        moment[k] -= feet.com[a] * force[b] - feet.com[b] * force[a]
    moment = apply(R.T, moment)
    for k in range(3):
        out[_MOMENT + k].now = moment[k]
    gap, up = apply(feet.R_left.T, feet.p_right - feet.p_left), apply(feet.R_right.T, feet.R_left[:, 2])
    out[_FEET].now, out[_FEET + 1].now = gap[2], np.arctan2(up[1], up[2])
    out[_FEET + 2].now = -np.arcsin(min(1.0, max(-1.0, up[0])))
    out[_SLIDE].last, out[_SLIDE + 1].last = gap[0], gap[1]
    out[_TILT].now, out[_TILT + 1].now = (R[:, 1] * vertical).sum(), -(R[:, 0] * vertical).sum()
    for k in range(6):
        out[_UNLOADED_LEFT + k].now, out[_UNLOADED_RIGHT + k].now = feet.left[k], feet.right[k]
    for k in range(2):
        planned = 0.0
        for i in range(3):
            planned += look.T_odom_sole[i, k] * (look.plan[i] - look.T_odom_sole[i, 3])
        out[_PLAN + k].now = look.com[k] - planned


@compiled
def _on_edge(wrench: Array, edges: Array, least: float) -> bool:
    """Whether the centre of pressure of a wrench (6,) is at the edge of its sole, of a load of at least `least` [N]."""
    load = max(wrench[2], least)
    x, y = -wrench[4] / load, wrench[3] / load
    inside_x = edges[0] + _EDGE <= x <= edges[1] - _EDGE
    return not (inside_x and edges[2] + _EDGE <= y <= edges[3] - _EDGE)
