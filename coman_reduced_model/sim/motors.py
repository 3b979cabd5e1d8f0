# SPDX-License-Identifier: BSD-3-Clause
"""Motors with inertia and a position loop: equation (1), for when assumption (A1) shall not hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.base.types import Array


@dataclass(frozen=True)
class MotorOptions:
    """Position loops tau = kp (reference - theta) + kd (reference' - theta'), reflected to the link side."""

    inertia: float = 0.139  # [kg m^2]
    kp: float = 20_000.0  # [Nm/rad]
    kd: float = 75.0  # [Nms/rad]


class Motors:
    """State of twelve motors that yield under the load of their springs."""

    def __init__(self, options: MotorOptions, theta: Array):
        """Args: options; positions (nj,) [rad] to start from, at rest."""
        self._options = options
        self.theta, self.rate = theta.copy(), np.zeros_like(theta)

    def step(self, reference: Array, reference_rate: Array, spring_torque: Array, dt: float) -> None:
        """One semi-implicit Euler step [s], with references (nj,) [rad, rad/s] and the springs' torques (nj,) [Nm]."""
        o = self._options
        torque = o.kp * (reference - self.theta) + o.kd * (reference_rate - self.rate)
        self.rate = self.rate + dt / o.inertia * (torque - spring_torque)
        self.theta = self.theta + dt * self.rate
