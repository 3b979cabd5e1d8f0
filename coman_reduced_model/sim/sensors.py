# SPDX-License-Identifier: BSD-3-Clause
"""The sensors of the virtual robot: from true signals to the messages of core/base/types, seeded.

Every stream has its own clock phase: it is sampled at its own physics step of the period and stamped with that time,
up to a jitter; a mean of foot forces with the middle of its period. Joint and motor states come from one driver and
share their stamps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..core.base.compiled import compiled
from ..core.base.types import Array, ContactMessage, ImuMessage, JointMessage, WrenchMessage
from ..errors import ConfigError
from .robot_table import RobotTable

SWITCH = 8.0  # [N] that closes a switch under a foot
STREAMS = ("joints", "left_wrench", "right_wrench", "imu")


@dataclass(frozen=True)
class SensorOptions:
    """How good the sensors are. The defaults are those of a well-kept robot; zero switches an imperfection off.

    Noise is white, one standard deviation a sample. A bias is drawn once, with that standard deviation; a walk lets
    it wander, by that standard deviation after one second.
    """

    rate_hz: float = 200.0  # of every stream; 1000 at most, and a whole number of physics steps apart
    encoder_bits: int = 12  # link side; 0: exact
    motor_counts: int = 819_200  # motor encoder: counts a turn after the reduction (2048 x 4 x 100); 0: exact
    encoder_noise: float = 0.0  # [rad] white, beside the rounding
    velocity: str = "filtered"  # link velocity: filtered (counts at each physics step, low-pass), exact, none (empty)
    velocity_cutoff_hz: float = 15.0
    motor_velocity_noise: float = 0.001  # [rad/s]
    motor_states: bool = True  # False: a robot without motor encoders
    motor_source: str = "measured"  # of motor states: what the encoder reads, or the command (commanded)
    effort: bool = True  # False: a robot without torques
    torque_source: str = "measured"  # by a sensor, or from the springs' deflection (deflection)
    torque_gain: float = 0.0  # relative error of the gain of each torque sensor
    torque_noise: float = 0.05  # [Nm]
    torque_bias: float = 0.1  # [Nm]
    joints_every: int = 1  # periods between two messages of joint and motor states
    wrench_every: int = 1  # of both wrenches
    imu_every: int = 1  # of the IMU
    wrenches: bool = True  # False: a robot without foot force sensors
    contact_switches: bool = False  # True: foot_contacts, by a switch under each foot
    wrench_average: bool = False  # True: the mean over the robot's last period; False: of the step that is sampled
    wrench_frame: str = "sole"  # frame that wrenches are expressed in: sole or sensor
    wrench_zero: float = 0.0  # [N] largest zero of a force, drawn evenly; of a moment 0.05 m times that
    wrench_gain: float = 0.0  # relative error of the gain of each component
    cross_talk: float = 0.0  # share of each component that shows in each other one (moments count at 0.1 m)
    gains_seed: int = 0  # of gains and cross-talk, the same in all recordings of a robot; 0: others in each recording
    force_noise: tuple[float, float, float] = (1.0, 1.0, 1.5)  # [N]
    force_bias: tuple[float, float, float] = (0.7, 0.7, 1.5)  # [N]
    force_walk: float = 0.1  # [N]
    moment_noise: tuple[float, float, float] = (0.04, 0.04, 0.03)  # [Nm]
    moment_bias: tuple[float, float, float] = (0.03, 0.03, 0.02)  # [Nm]
    moment_walk: float = 0.003  # [Nm]
    imu: bool = True  # False: nothing is published of the IMU; a stabiliser still has it
    tilt_noise: float = 0.0005  # [rad] orientation, white
    tilt_bias: float = 0.002  # [rad]
    yaw_walk: float = 0.0005  # [rad]
    gyro_noise: float = 0.005  # [rad/s]
    gyro_bias: float = 0.002  # [rad/s]
    acceleration_noise: float = 0.05  # [m/s^2]
    acceleration_bias: float = 0.03  # [m/s^2]
    phase_spread: bool = True  # False: all streams are sampled at the same instant
    stamp_jitter_s: float = 0.0001  # [s] error of the stamps, white, three standard deviations at most
    latency_s: float = 0.0003  # [s] from the stamp to the bag
    drop: float = 0.002  # share of messages that never arrive

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not isinstance(value, (bool, str)) and not np.all(np.asarray(value, dtype=float) >= 0.0):
                raise ConfigError(f"sensors: {f.name} = {value!r}: allowed: not negative")
        for name, allowed in (
            ("velocity", ("filtered", "exact", "none")),
            ("motor_source", ("measured", "commanded")),
            ("wrench_frame", ("sole", "sensor")),
            ("torque_source", ("measured", "deflection")),
        ):
            if getattr(self, name) not in allowed:
                raise ConfigError(f"sensors: {name} = {getattr(self, name)!r}: allowed: {', '.join(allowed)}")
        if not 1.0 <= self.rate_hz <= 1000.0:
            raise ConfigError(f"sensors: rate_hz = {self.rate_hz:g}: allowed: 1 to 1000")
        for name in ("joints_every", "wrench_every", "imu_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"sensors: {name} = {getattr(self, name)}: allowed: 1 and more")
        if self.drop >= 1.0:
            raise ConfigError(f"sensors: drop = {self.drop:g}: allowed: 0 to below 1")

    @classmethod
    def exact(cls, **overrides: object) -> SensorOptions:
        """No imperfection at all, all streams in step."""
        zeros: dict[str, Any] = {
            f.name: (0.0, 0.0, 0.0) if isinstance(f.default, tuple) else type(f.default)(0)
            for f in fields(cls)
            if isinstance(f.default, (int, float, tuple)) and not isinstance(f.default, bool)
        }
        keep: dict[str, Any] = dict.fromkeys(("joints_every", "wrench_every", "imu_every"), 1)
        keep |= {"rate_hz": 200.0, "velocity_cutoff_hz": 15.0, "velocity": "exact", "phase_spread": False}
        return replace(cls(), **(zeros | keep | overrides))


_ZERO = np.array([1.0, 1.0, 1.0, 0.05, 0.05, 0.05])  # moments at 0.05 m
_UNITS = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # moments at 0.1 m
_CROSS = np.outer(_UNITS, 1.0 / _UNITS) * (1.0 - np.eye(6))


@dataclass
class Signals:
    """True signals at one sampling instant; each stream's part is filled at that stream's own instant."""

    q: Array  # (m, nj) [rad] link positions at the last m physics steps, newest last
    qd: Array  # (nj,) [rad/s]
    tau: Array  # (nj,) [Nm] that the transmissions pass on
    motor_q: Array  # (nj,) [rad]
    motor_qd: Array  # (nj,) [rad/s]
    left_wrench: Array  # (6,) of the ground on the foot, in the sole frame [N, Nm]
    right_wrench: Array  # (6,)
    orientation: Array  # (4,) quaternion x y z w, world <- imu
    gyro: Array  # (3,) [rad/s] in the imu frame
    acceleration: Array  # (3,) [m/s^2] in the imu frame, gravity's reaction included
    hanging: tuple[str, ...] = ()  # foot sensors whose driver repeats its last value


@dataclass(slots=True)
class Readings:
    """What one period brings; None: dropped, or the robot lacks that sensor."""

    t: float  # [s] true time of the joint sample
    joint_states: JointMessage | None
    motor_states: JointMessage | None
    left_wrench: WrenchMessage | None
    right_wrench: WrenchMessage | None
    imu: ImuMessage | None
    contacts: ContactMessage | None = None


def cross(a: Sequence[float] | Array, b: Array) -> Array:
    """Return a x b of two (3,) vectors, ten times as fast as numpy.cross."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class Sensors:
    """Turns signals into messages; keeps biases, filters and the random numbers."""

    def __init__(self, options: SensorOptions, table: RobotTable, dt: float, start_ns: int, seed: int):
        """Args: options; the robot; physics step [s]; stamp at t = 0 [ns]; seed."""
        steps = 1.0 / (options.rate_hz * dt)
        if abs(steps - round(steps)) > 1e-6:
            raise ConfigError(
                f"sensors: rate_hz = {options.rate_hz:g}: allowed: {1.0 / dt:g} Hz divided by a whole number"
            )
        self.options, self.steps, self._dt, self._start_ns = options, round(steps), dt, start_ns
        self._names = table.joint_names
        # Each stream has its own random numbers: to switch one imperfection leaves the others as they were.
        keys = ("bias", "joints", "motors", "left_wrench", "right_wrench", "imu", "stamps", "drop", "gains", "encoders")
        seeds = np.random.SeedSequence(seed).spawn(len(keys))
        self._rng = {key: np.random.default_rng(each) for key, each in zip(keys, seeds, strict=True)}
        o, rng, nj = options, self._rng["bias"], len(self._names)
        phases = rng.integers(0, self.steps, len(STREAMS)) if o.phase_spread else np.zeros(len(STREAMS), dtype=int)
        phases[0] = 0  # the joints' clock is the robot's
        self.phase = dict(zip(STREAMS, (int(p) for p in phases), strict=True))  # physics steps into the period
        middle = 0.5 * (self.steps - 1) * dt if o.wrench_average else 0.0
        self._behind = (0.0, middle, middle, 0.0)  # [s] of STREAMS: a mean over a period is that of its middle
        self._count = 2.0 * np.pi / (1 << o.encoder_bits) if o.encoder_bits else 0.0
        self._motor_count = 2.0 * np.pi / o.motor_counts if o.motor_counts else 0.0
        # The encoder's zero is nowhere special: the grid of counts lies shifted by a part of a count.
        self._grid = self._count * rng.uniform(-0.5, 0.5, nj)
        self._torque_bias = o.torque_bias * rng.standard_normal(nj)
        self._wrench_noise = np.array([*o.force_noise, *o.moment_noise])
        self._wrench_walk = np.repeat([o.force_walk, o.moment_walk], 3) * np.sqrt(self.steps * dt)
        bias = np.array([*o.force_bias, *o.moment_bias])
        feet, zeros = ("left_wrench", "right_wrench"), self._rng["gains"]
        gains = np.random.default_rng([43, o.gains_seed]) if o.gains_seed else zeros
        self._wrench_bias = {foot: bias * rng.standard_normal(6) for foot in feet}
        self._wrench_gain = {}
        for foot in feet:
            self._wrench_bias[foot] += o.wrench_zero * _ZERO * zeros.uniform(-1.0, 1.0, 6)
            self._wrench_gain[foot] = np.diag(
                1.0 + o.wrench_gain * gains.standard_normal(6)
            ) + o.cross_talk * _CROSS * (gains.standard_normal((6, 6)))
        self._exact_gain = o.wrench_gain == 0.0 and o.cross_talk == 0.0
        self._torque_gain = 1.0 + o.torque_gain * gains.standard_normal(nj)
        self._stiffness, self._damping = (
            np.array([getattr(joint, name) for joint in table.joints()]) for name in ("stiffness", "damping")
        )
        self._last_wrench: dict[str, Array] = {}
        self._period = 0
        self._tilt = np.array([o.tilt_bias, o.tilt_bias, 0.0]) * rng.standard_normal(3)
        self._gyro_bias = o.gyro_bias * rng.standard_normal(3)
        self._acceleration_bias = o.acceleration_bias * rng.standard_normal(3)
        self._smooth = np.exp(-2.0 * np.pi * o.velocity_cutoff_hz * dt)
        self._last_count = np.full(nj, np.nan)
        self._velocity_state = np.zeros(nj)
        below = table.ankle_height - table.sensor_below_ankle
        self._lever = (0.0, 0.0, below) if o.wrench_frame == "sensor" else None
        self._frame = "ft" if o.wrench_frame == "sensor" else "sole"

    def read(self, t: float, s: Signals) -> Readings:
        """Messages of the period that begins at time t [s]."""
        o = self.options
        drop = self._rng["drop"].random(5) < o.drop
        jitter = np.clip(self._rng["stamps"].standard_normal(4), -3.0, 3.0) * o.stamp_jitter_s
        stamps = {
            name: self._start_ns + round(1e9 * (t + self.phase[name] * self._dt - self._behind[i] + jitter[i]))
            for i, name in enumerate(STREAMS)
        }
        q, qd = self._link(s)
        noise = self._rng["motors"].standard_normal(len(s.tau))
        motor_q = self._motor_count * np.round(s.motor_q / self._motor_count) if self._motor_count else s.motor_q.copy()
        motor_qd = s.motor_qd + o.motor_velocity_noise * noise
        effort = self._effort(s, motor_q - q, motor_qd, qd)
        joints = JointMessage(stamps["joints"], self._names, q, qd, effort if o.effort else None)
        motors = JointMessage(stamps["joints"], self._names, motor_q, motor_qd, None)
        left = self._wrench("left_wrench", f"l_{self._frame}", stamps, s)
        right = self._wrench("right_wrench", f"r_{self._frame}", stamps, s)
        imu = self._imu(stamps["imu"], s)
        contacts = ContactMessage(
            stamps["left_wrench"], bool(s.left_wrench[2] > SWITCH), bool(s.right_wrench[2] > SWITCH)
        )
        due = {name: self._period % getattr(o, f"{name}_every") == 0 for name in ("joints", "wrench", "imu")}
        self._period += 1
        return Readings(
            t,
            joints if due["joints"] and not drop[0] else None,
            motors if due["joints"] and not drop[1] and o.motor_states else None,
            left if due["wrench"] and not drop[2] and o.wrenches else None,
            right if due["wrench"] and not drop[3] and o.wrenches else None,
            imu if due["imu"] and not drop[4] else None,
            contacts if due["wrench"] and o.contact_switches else None,
        )

    def _effort(self, s: Signals, deflection: Array, motor_qd: Array, qd: Array | None) -> Array:
        """Joint torques (nj,) [Nm], by a sensor or from what the encoders of both sides read."""
        noise = self.options.torque_noise * self._rng["joints"].standard_normal(len(s.tau))
        if self.options.torque_source == "measured":
            return self._torque_gain * s.tau + self._torque_bias + noise
        tau = self._stiffness * deflection
        return tau if qd is None else tau + self._damping * (motor_qd - qd)

    def _link(self, s: Signals) -> tuple[Array, Array | None]:
        """Position and velocity as the joint boards make them from the counts."""
        q = s.q
        if self.options.encoder_noise:
            q = q + self.options.encoder_noise * self._rng["encoders"].standard_normal(q.shape)
        last, state = self._last_count, self._velocity_state
        filtered = _read_encoders(q, self._count, self._grid, last, state, self._smooth, self._dt)
        if self.options.velocity == "none":
            return last.copy(), None
        return last.copy(), filtered if self.options.velocity == "filtered" else s.qd.copy()

    def _wrench(self, foot: str, frame: str, stamps: dict[str, int], s: Signals) -> WrenchMessage:
        rng, wrench = self._rng[foot], getattr(s, foot)
        self._wrench_bias[foot] = self._wrench_bias[foot] + self._wrench_walk * rng.standard_normal(6)
        force, moment = wrench[:3], wrench[3:]
        if self._lever is not None:
            moment = moment - cross(self._lever, force)
        # The errors are the sensor's own, in whichever frame its values are expressed.
        values = np.concatenate([force, moment])
        if not self._exact_gain:
            values = self._wrench_gain[foot] @ values
        values = values + self._wrench_bias[foot]
        values += self._wrench_noise * rng.standard_normal(6)
        if foot in s.hanging:
            values = self._last_wrench.get(foot, values)
        self._last_wrench[foot] = values
        return WrenchMessage(stamps[foot], frame, values[:3], values[3:])

    def _imu(self, stamp: int, s: Signals) -> ImuMessage:
        o, noise = self.options, self._rng["imu"].standard_normal((4, 3))
        self._tilt[2] += o.yaw_walk * np.sqrt(self.steps * self._dt) * noise[3, 2]
        x, y, z = 0.5 * (self._tilt + o.tilt_noise * noise[0])
        qx, qy, qz, qw = s.orientation
        turned = np.array(  # (x, y, z, 1) * orientation: a small turn about the axes of the world
            [
                qx + x * qw + y * qz - z * qy,
                qy + y * qw + z * qx - x * qz,
                qz + z * qw + x * qy - y * qx,
                qw - x * qx - y * qy - z * qz,
            ]
        )
        gyro = s.gyro + self._gyro_bias + o.gyro_noise * noise[1]
        acceleration = s.acceleration + self._acceleration_bias + o.acceleration_noise * noise[2]
        return ImuMessage(stamp, "imu_link", turned / math.sqrt(turned @ turned), gyro, acceleration)


@compiled
def _read_encoders(q: Array, count: float, grid: Array, last: Array, state: Array, smooth: float, dt: float) -> Array:
    """Velocities (nj,) [rad/s] of positions (m, nj) [rad] at consecutive physics steps dt [s], counted and low-passed.

    Args:
        q: positions.
        count: one count of the encoders [rad]; 0: exact.
        grid: (nj,) [rad] where their counts lie.
        last: (nj,) [rad] the last count, NaN before the first one; becomes that of the newest position.
        state: (nj,) of the filter.
        smooth: its factor a step.
        dt: see above.
    """
    velocity = np.empty_like(last)
    for j in range(len(last)):
        for i in range(len(q)):
            x = count * np.rint((q[i, j] - grid[j]) / count) + grid[j] if count > 0.0 else q[i, j]
            rate = 0.0 if np.isnan(last[j]) else (x - last[j]) / dt
            velocity[j] = (1.0 - smooth) * rate + state[j]
            state[j] = smooth * velocity[j]
            last[j] = x
    return velocity
