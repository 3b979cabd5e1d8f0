# SPDX-License-Identifier: BSD-3-Clause
"""From a plan (COM and soles) to the positions of the motors: exact inverse kinematics, then the springs' sag.

An open-loop walk on springs needs three things: joint angles that put the soles exactly where they are planned; a COM
whose reaction, all links counted, comes from under the feet (the plan counts a point mass only); and motors that lead
the joints by what the springs give under the load. `plan_motion` does all three; `follow` does the first and the
last, for a live stream of references, whose future it cannot know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline, PPoly
from scipy.linalg import solve_banded

from ..core.base.types import Array, Reference
from ..core.gait.gait import WalkPlan
from ..core.gait.load_share import share_load, support_height, zmp_of
from ..errors import ConfigError
from .contact import Floor
from .describe import urdf
from .robot_table import RobotTable
from .upper_motion import UpperMotion

GRID = 0.005  # [s] interval at which a motion is computed; the motors get a C2 spline through it


@dataclass(frozen=True)
class Posture:
    """Joint and trunk positions at n times."""

    q: Array  # (n, nj) [rad], in the order of RobotTable.joint_names
    base: Array  # (n, 3) [m] origin of base_link in odom
    yaw: Array  # (n,) [rad] of the trunk, which is level

    def stacked(self) -> Array:
        """(n, 4 + nj): base, yaw, joints."""
        return np.column_stack([self.base, self.yaw, self.q])


class MotorMotion:
    """Motor positions over time: a spline; still before its start and after its end."""

    def __init__(self, t: Array, theta: Array, start: Posture):
        """Args: times (n,) [s]; motor positions (n, nj) [rad]; where the robot stands at the start (n = 1)."""
        spline = CubicSpline(t, theta, bc_type="clamped")
        rate = np.concatenate([np.zeros_like(spline.c[:1]), spline.derivative().c])
        self._both = PPoly(np.stack([spline.c, rate], axis=2), spline.x)  # one evaluation gives both
        self.start = start
        self.end = float(t[-1])

    def __call__(self, t: Array) -> tuple[Array, Array]:
        """Motor positions [rad] and velocities [rad/s], each (n, nj), at times (n,) [s]."""
        both = self._both(np.minimum(np.maximum(t, self._both.x[0]), self.end))
        return both[:, 0], both[:, 1]


class LegKinematics:
    """Inverse kinematics and dynamics of the robot of a table; the trunk is kept level."""

    def __init__(self, table: RobotTable):
        self.table = table
        self.model = pin.buildModelFromXML(urdf(table), pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        self.stiffness = np.array([joint.stiffness for joint in table.joints()])
        self._longest = table.thigh + table.shank
        self._ankles = [self.model.getJointId(name) for name in ("LAnkLat", "RAnkLat")]
        # Pinocchio sorts the joints by name among brothers; here as everywhere: left leg, right leg.
        index = [self.model.joints[self.model.getJointId(name)].idx_v for name in table.joint_names]
        self._v = np.array(index)
        self._limits = np.array([joint.limits for joint in table.joints()]).T

    def inverse(self, com: Array, T_left: Array, T_right: Array, upper: Array | None = None) -> Posture:
        """Joint angles for COM (n, 3) [m] and soles (n, 4, 4) in one frame with z up.

        Args:
            com, T_left, T_right: where they have to be.
            upper: (n, nj - 12) [rad] joints of the upper body; default: all zero.

        Raises:
            ConfigError: a leg is too short or too long for it, or a joint beyond its limit.
        """
        x_left, x_right = T_left[:, :2, 0], T_right[:, :2, 0]
        forward = x_left + x_right
        yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
        offset = np.zeros_like(com)
        if upper is None:
            upper = np.zeros((len(com), len(self.table.upper)))
        for _ in range(30):
            legs, reach = self._legs(com + offset, yaw, T_left, T_right)
            posture = Posture(np.column_stack([legs, upper]), com + offset, yaw)
            error = com - self._com(posture)
            if reached := np.abs(error).max() < 1e-7:
                break
            offset += 1.4 * error  # the COM moves by some 0.7 of what the trunk does: the legs stay behind
        if not reached or reach.max() > self._longest:
            raise ConfigError(
                f"the legs cannot put the COM there: ankle to hip {reach.min():.3f} to {reach.max():.3f} m;"
                f" allowed: below {self._longest:.3f} m (shorter steps, or another com_height_m)"
            )
        low, high = self._limits
        if np.any(beyond := (posture.q < low) | (posture.q > high)):
            row, joint = np.argwhere(beyond)[0]
            raise ConfigError(
                f"{self.table.joint_names[joint]} would turn to {posture.q[row, joint]:.2f} rad;"
                f" allowed: {low[joint]:g} to {high[joint]:g} (smaller steps, or another com_height_m)"
            )
        return posture

    def _legs(self, base: Array, yaw: Array, T_left: Array, T_right: Array) -> tuple[Array, Array]:
        """Both legs in closed form: the hip's axes meet in one point, and so do the ankle's.

        Joints (n, 12) of the legs, and the distances (n, 2) from ankle to hip; legs that are too short are straight.
        """
        table = self.table
        R_base = _rz(yaw)
        q, reach = np.empty((len(yaw), 12)), np.empty((len(yaw), 2))
        for k, (T, side) in enumerate(((T_left, 1.0), (T_right, -1.0))):
            R_foot = T[:, :3, :3]
            ankle = T[:, :3, 3] + table.ankle_height * R_foot[:, :, 2]
            hip = base + R_base @ np.array([0.0, side * table.hip_width / 2.0, 0.0])
            r = np.einsum("nji,nj->ni", R_foot, hip - ankle)  # ankle to hip, seen from the foot
            a, b, d2 = table.thigh, table.shank, np.sum(r * r, axis=1)
            cos_knee = (d2 - a * a - b * b) / (2.0 * a * b)
            reach[:, k] = np.sqrt(d2)
            knee = np.arccos(np.clip(cos_knee, -1.0, 1.0))
            roll = np.arctan2(r[:, 1], r[:, 2])  # Rx(roll) r has no y: the plane of thigh and shank
            height = np.hypot(r[:, 1], r[:, 2])
            lean = np.arctan2(r[:, 0], height)
            pitch = -lean - np.arctan2(a * np.sin(knee), b + a * np.cos(knee))
            # R_foot = R_base Ry(hip) Rx(lat) Rz(yaw) Ry(knee + pitch) Rx(roll)
            R = np.einsum("nji,njk->nik", R_base, R_foot) @ _rx(-roll) @ _ry(-knee - pitch)
            hip_lat = np.arcsin(np.clip(-R[:, 1, 2], -1.0, 1.0))
            hip_sag = np.arctan2(R[:, 0, 2], R[:, 2, 2])
            hip_yaw = np.arctan2(R[:, 1, 0], R[:, 1, 1])
            q[:, 6 * k : 6 * k + 6] = np.stack([hip_sag, hip_lat, hip_yaw, knee, pitch, roll], axis=1)
        return q, reach

    def configuration(self, posture: Posture) -> Array:
        """Pinocchio's (n, 7 + nj): position of the trunk, its quaternion x y z w, joints."""
        n = len(posture.yaw)
        q = np.zeros((n, self.model.nq))
        q[:, :3] = posture.base
        q[:, 5], q[:, 6] = np.sin(posture.yaw / 2.0), np.cos(posture.yaw / 2.0)
        q[:, self._v + 1] = posture.q
        return q

    def _com(self, posture: Posture) -> Array:
        return np.array([pin.centerOfMass(self.model, self.data, q).copy() for q in self.configuration(posture)])

    def derivatives(self, t: Array, posture: Posture) -> tuple[Array, Array]:
        """Velocity and acceleration (n, 6 + nj) of a motion sampled at t (n,), for Pinocchio's free-flyer."""
        spline = CubicSpline(t, posture.stacked(), bc_type="clamped")
        return self.twist(posture, spline(t, 1), spline(t, 2))

    def twist(self, posture: Posture, rate: Array, rate2: Array) -> tuple[Array, Array]:
        """The same from the first and second derivatives (n, 4 + nj) of `posture.stacked()`."""
        n = len(rate)
        v, a = np.zeros((n, self.model.nv)), np.zeros((n, self.model.nv))
        R_T = _rz(-posture.yaw)
        v[:, :3], v[:, 5] = np.einsum("nij,nj->ni", R_T, rate[:, :3]), rate[:, 3]
        # The derivative of R^T p' along the turning axes.
        a[:, :3] = np.einsum("nij,nj->ni", R_T, rate2[:, :3]) - np.cross(v[:, 3:6], v[:, :3])
        a[:, 5] = rate2[:, 3]
        v[:, self._v], a[:, self._v] = rate[:, 4:], rate2[:, 4:]
        return v, a

    def ground_wrench(self, posture: Posture, v: Array, a: Array) -> Array:
        """(n, 6) force and moment about the origin of odom that the ground has to exert."""
        wrench = np.empty((len(v), 6))
        for k, q in enumerate(self.configuration(posture)):
            tau = pin.rnea(self.model, self.data, q, v[k], a[k])
            wrench[k] = pin.XYZQUATToSE3(q[:7]).act(pin.Force(tau[:6])).vector
        return wrench

    def joint_torques(self, posture: Posture, v: Array, a: Array, left: Array, right: Array) -> Array:
        """(n, nj) torques of the joints when the ground exerts left, right (n, 6) about the origin of odom."""
        model, data = self.model, self.data
        tau = np.empty((len(v), len(self._v)))
        external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        for k, q in enumerate(self.configuration(posture)):
            pin.forwardKinematics(model, data, q)
            for joint, wrench in zip(self._ankles, (left[k], right[k]), strict=True):
                external[joint] = data.oMi[joint].actInv(pin.Force(wrench))
            tau[k] = pin.rnea(model, data, q, v[k], a[k], external)[self._v]
        return tau

    def planned_torques(
        self, posture: Posture, v: Array, a: Array, T_left: Array, T_right: Array, phase: Array
    ) -> Array:
        """(n, nj) torques of the joints in a motion, the load shared as `share_load` does."""
        wrench = self.ground_wrench(posture, v, a)
        return self.joint_torques(posture, v, a, *share_load(wrench, T_left, T_right, phase))


def _rx(angle: Array) -> Array:
    """(n, 3, 3) turns about x."""
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    return np.array([[o + 1, o, o], [o, c, -s], [o, s, c]]).transpose(2, 0, 1)


def _ry(angle: Array) -> Array:
    """(n, 3, 3) turns about y."""
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    return np.array([[c, o, s], [o, o + 1, o], [-s, o, c]]).transpose(2, 0, 1)


def _rz(angle: Array) -> Array:
    """(n, 3, 3) turns about z."""
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    return np.array([[c, -s, o], [s, c, o], [o, o, o + 1]]).transpose(2, 0, 1)


def plan_motion(
    table: RobotTable,
    plan: WalkPlan,
    sag: float = 0.8,
    passes: int = 3,
    upper: UpperMotion | None = None,
    floor: Floor | None = None,
) -> tuple[MotorMotion, WalkPlan]:
    """Motor positions that walk a plan, and the plan with the COM that they were made for.

    Args:
        table: the robot.
        plan: the walk.
        sag: share of the springs' deflection under the planned load by which the motors lead; 0: none, 1: all.
        passes: corrections of the COM for the mass distribution; each leaves a small part of the error of the ZMP.
            With 0 the COM is followed as it is, whatever ZMP that takes.
        upper: how the upper body moves, if the robot has one; default: it does not.
        floor: its slope, which the corrected COM leans against; default: level.

    Raises:
        ConfigError: the legs cannot do it.
    """
    legs = LegKinematics(table)
    if floor is not None:
        legs.model.gravity.linear = 9.81 * floor.down
    t = np.linspace(0.0, plan.duration_s, int(np.ceil(plan.duration_s / GRID)) + 1)
    above = (upper or UpperMotion()).angles(table, plan, t)
    for _ in range(passes):
        point = plan.sample_many(t)
        posture = legs.inverse(point.com, point.T_odom_left, point.T_odom_right, above)
        wrench = legs.ground_wrench(posture, *legs.derivatives(t, posture))
        com = point.com.copy()
        height = support_height(point.T_odom_left, point.T_odom_right, point.phase)
        com[:, :2] += _pendulum(point.zmp[:, :2] - zmp_of(wrench, height), t[1] - t[0], plan.parameters.omega)
        plan = plan.with_com(t, com)
    point = plan.sample_many(t)
    posture = legs.inverse(point.com, point.T_odom_left, point.T_odom_right, above)
    v, a = legs.derivatives(t, posture)
    tau = legs.planned_torques(posture, v, a, point.T_odom_left, point.T_odom_right, point.phase)
    theta = posture.q + sag * tau / legs.stiffness
    start = Posture(posture.q[:1], posture.base[:1], posture.yaw[:1])
    return MotorMotion(t, theta, start), plan


def _pendulum(zmp: Array, dt: float, omega: float) -> Array:
    """The bounded COM (n, 2) of the linear pendulum for a ZMP (n, 2), at rest at both ends: y - y''/omega^2 = zmp."""
    r = 1.0 / (omega * dt) ** 2
    n = len(zmp)
    bands = np.empty((3, n))
    bands[0], bands[1], bands[2] = -r, 1.0 + 2.0 * r, -r
    bands[0, 1] = bands[2, -2] = -2.0 * r  # mirrored at the ends: no velocity there
    return solve_banded((1, 1), bands, zmp)


def follow(
    legs: LegKinematics, references: Sequence[Reference], sag: float = 0.8, upper: Array | None = None
) -> tuple[Array, Posture]:
    """Motor positions (nj,) and posture for a live stream of references.

    Args:
        legs: the robot.
        references: three consecutive ones, equally spaced in time: the result is for the middle one, and the sag counts
            the inertia of all links. Or a single one, for a robot that stands.
        sag: as in plan_motion.
        upper: joints of the upper body at each reference (n, nj - 12) [rad]; default: all zero.

    Raises:
        ConfigError: the legs cannot do it.
    """
    n, middle = len(references), len(references) // 2

    def stack(name: str) -> Array:
        return np.array([getattr(reference, name) for reference in references])

    T_left, T_right = stack("T_odom_left"), stack("T_odom_right")
    posture = legs.inverse(stack("com"), T_left, T_right, upper)
    state = posture.stacked()
    rate = rate2 = np.zeros((1, state.shape[1]))
    if n == 3:
        dt = 0.5e-9 * (references[2].stamp_ns - references[0].stamp_ns)
        rate, rate2 = (state[2:] - state[:1]) / (2.0 * dt), (state[2:] - 2.0 * state[1:2] + state[:1]) / dt**2
    now = Posture(posture.q[middle : middle + 1], posture.base[middle : middle + 1], posture.yaw[middle : middle + 1])
    reference = references[middle]
    tau = legs.planned_torques(
        now,
        *legs.twist(now, rate, rate2),
        reference.T_odom_left[None],
        reference.T_odom_right[None],
        np.array([int(reference.phase)]),
    )
    return now.q[0] + sag * tau[0] / legs.stiffness, now
