# SPDX-License-Identifier: BSD-3-Clause
"""Motors with inertia and a position loop: equation (1), for when assumption (A1) shall not hold."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotorOptions:
    """Position loops tau = kp (reference - theta) + kd (reference' - theta'), reflected to the link side."""

    inertia: float = 0.139  # [kg m^2]
    kp: float = 20_000.0  # [Nm/rad]
    kd: float = 75.0  # [Nms/rad]
