# SPDX-License-Identifier: BSD-3-Clause
"""Stabilisers: what balance control adds to the planned motor positions, from what the sensors read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..core.base.types import Array
from ..errors import ConfigError
from .robot_table import RobotTable
from .sensors import Readings

KINDS = ("none", "imu", "feet")
LEARN_S = 0.8  # [s] of standing at the start, from which zeros are taken
SLOW_S, FILTER_S = 0.5, 0.02  # [s] time constants of what lasts, and of the derivative, of moments under the feet


@dataclass(frozen=True)
class Controller:
    """A stabiliser.

    `imu`: ankle and hip strategy. Ankles and hips turn against the trunk's tilt and its rate. `feet`: the same
    against changes of the moments under the feet, which show that the COM leans over them.

    Raises:
        ConfigError: a value is not possible.
    """

    kind: str = "none"
    ankle: float = 0.15  # [rad/rad] of the tilt; of `feet`: of the deflection of the ankle's spring under the moment
    hip: float = 0.15  # the same
    rate: float = 0.2  # [s] of the rate, relative to that of the tilt or moment
    smoothing_s: float = 0.03  # [s] time constant of the output
    limit: float = 0.05  # [rad] of each joint

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ConfigError(f"controller: kind = {self.kind!r}: allowed: {', '.join(KINDS)}")
        if not (self.smoothing_s > 0.0 and 0.0 <= self.limit <= 0.2 and self.ankle >= 0.0 and self.hip >= 0.0):
            raise ConfigError(
                "controller: allowed: smoothing_s above 0, limit 0 to 0.2 rad, ankle and hip not negative"
            )


class Stabiliser:
    """State of a controller: offsets of the motor references (nj,) [rad] and their rate, once a sensor period."""

    def __init__(self, options: Controller, table: RobotTable, period: float) -> None:
        """Args: options; the robot; period of the sensors [s]."""
        self._options, self._period, self._table = options, period, table
        names = table.joint_names
        self._joints = {
            kind: [names.index(side + kind) for side in "LR"] for kind in ("HipSag", "HipLat", "AnkSag", "AnkLat")
        }
        self._mount = table.imu_mount.as_matrix()
        self.offset = np.zeros(len(names))
        self.rate = np.zeros(len(names))
        self._zeros: list[Array] = []
        self._slow, self._fast, self._change = np.zeros(4), np.zeros(4), np.zeros(4)
        self._last = np.zeros(4)
        self._time = 0.0

    def update(self, readings: Readings) -> None:
        """Take what the sensors read; missing messages leave the last values."""
        self._time += self._period
        if self._options.kind == "none":
            return
        target = self._by_imu(readings) if self._options.kind == "imu" else self._by_feet(readings)
        limit = self._options.limit
        target = np.clip(target, -limit, limit)
        before = self.offset
        share = self._period / (self._options.smoothing_s + self._period)
        self.offset = before + share * (target - before)
        self.rate = (self.offset - before) / self._period

    def over(self, n: int, dt: float) -> tuple[Array, Array]:
        """Offsets and rates (n, nj) at the next n physics steps of dt [s]: a line from the last offset to this one."""
        behind = self._period - dt * np.arange(n)[:, None]
        return self.offset - behind * self.rate, np.tile(self.rate, (n, 1))

    def _by_imu(self, readings: Readings) -> Array:
        o, target = self._options, np.zeros_like(self.offset)
        if readings.imu is not None:
            R = pin.Quaternion(readings.imu.orientation).toRotationMatrix() @ self._mount.T  # world <- trunk
            rates = self._mount @ readings.imu.angular_velocity
            self._last = np.array([np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), *rates[:2]])
        if not self._zero_known(self._last):
            return target
        roll, pitch, roll_rate, pitch_rate = self._last - self._zero
        for axis, tilt, rate in (("Lat", roll, roll_rate), ("Sag", pitch, pitch_rate)):
            target[self._joints[f"Ank{axis}"]] = o.ankle * (tilt + o.rate * rate)
            target[self._joints[f"Hip{axis}"]] = o.hip * (tilt + o.rate * rate)
        return target

    def _by_feet(self, readings: Readings) -> Array:
        o, target = self._options, np.zeros_like(self.offset)
        for k, wrench in enumerate((readings.left_wrench, readings.right_wrench)):
            if wrench is not None:
                self._last[2 * k : 2 * k + 2] = wrench.torque[:2]
        if not self._zero_known(self._last):
            return target
        self._slow += self._period / SLOW_S * (self._last - self._slow)  # what lasts is no disturbance
        fast = self._last - self._slow
        self._change += self._period / (FILTER_S + self._period) * ((fast - self._fast) / self._period - self._change)
        self._fast = fast
        stiffness, moments = self._table.stiffness, fast + o.rate * self._change
        for k in (0, 1):
            for axis, moment in zip(("Lat", "Sag"), moments[2 * k : 2 * k + 2], strict=True):
                target[self._joints[f"Ank{axis}"][k]] = -o.ankle * moment / stiffness[f"Ank{axis}"]
                target[self._joints[f"Hip{axis}"][k]] = -o.hip * moment / stiffness[f"Ank{axis}"]
        return target

    def _zero_known(self, values: Array) -> bool:
        """Whether the robot has stood long enough; then the mean of the values is their zero."""
        if self._time < LEARN_S:
            self._zeros.append(values.copy())
            return False
        if self._zeros:
            self._zero = np.mean(self._zeros, axis=0)
            self._slow = self._zero.copy()
            self._zeros = []
        return True
