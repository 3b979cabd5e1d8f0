# SPDX-License-Identifier: BSD-3-Clause
"""Motors that do not follow their references, against (A1).

A motor encoder shows where the motor really is: then these effects show between `com/reference` and the motors, not
in the springs. On robots whose `/motor_states` echoes the command (`SensorOptions.motor_source`) they show there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lfilter

from ...core.base.parameter import par
from ...core.base.types import Array
from ..motors import MotorOptions
from ..robot_table import RobotTable
from .base import Disturbance


@dataclass
class MotorLag(Disturbance):
    """First-order position loops: time_constant theta' = reference - theta."""

    name: ClassVar[str] = "motor_lag"
    time_constant: float = par(0.0, "s", "of the closed position loop", 0.0, 0.5)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        # The trapezoidal rule: exact to (dt / time_constant)^2 for references that are smooth over a step.
        half, constant = model.opt.timestep / 2.0, self.time_constant
        gain = half / (constant + half)
        self._b, self._a = [gain, gain], [1.0, (half - constant) / (constant + half)]
        self._state: Array | None = None

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        """See Disturbance."""
        if self.time_constant == 0.0:
            return theta, theta_rate
        if self._state is None:  # at rest at the reference: y = x makes the filter's state (1 - b0) x
            self._state = (1.0 - self._b[0]) * theta[:1]
        moved, self._state = lfilter(self._b, self._a, theta, axis=0, zi=self._state)
        return moved, (theta - moved) / self.time_constant


@dataclass
class TransportDelay(Disturbance):
    """The references arrive late, to the nearest physics step."""

    name: ClassVar[str] = "transport_delay"
    delay: float = par(0.0, "s", "between reference and motion", 0.0, 0.5)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._steps = round(self.delay / model.opt.timestep)
        self._past: tuple[Array, Array] | None = None

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        """See Disturbance."""
        if self._past is None:
            self._past = np.tile(theta[0], (self._steps, 1)), np.zeros((self._steps, theta.shape[1]))
        known = [np.concatenate(pair) for pair in zip(self._past, (theta, theta_rate), strict=True)]
        n = len(theta)
        self._past = known[0][n:], known[1][n:]
        return known[0][:n], known[1][:n]


@dataclass
class MotorCompliance(Disturbance):
    """Position loops that yield: at rest motor = reference - compliance * torque of the spring.

    Each motor has its reflected inertia (MotorOptions) and a loop damped by 0.7, so that it yields without ringing.
    """

    name: ClassVar[str] = "motor_compliance"
    compliance: float = par(0.0, "rad/Nm", "of the position loop", 0.0, 0.02)

    def motor_loop(self, motors: MotorOptions | None) -> MotorOptions | None:
        """See Disturbance."""
        if self.compliance == 0.0:
            return motors
        inertia, kp = (motors or MotorOptions()).inertia, 1.0 / self.compliance
        return MotorOptions(inertia, kp, 1.4 * np.sqrt(kp * inertia))
