# SPDX-License-Identifier: BSD-3-Clause
"""How much clean robots of a world vary: the true standard deviations, by which rank.py and sizes.py measure."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..sim.disturbances import imperfections as made
from ..sim.disturbances.masses import Scatter
from ..sim.worlds import World

TILE = 1.0 / np.sqrt(6.0)  # deviation of the step between two tiles over the largest height of a tile
EVEN = 1.0 / np.sqrt(12.0)  # standard deviation of an even distribution over its width


def true_deviations(world: World) -> dict[str, float]:
    """Standard deviations over clean robots of this world, by the names of config/nominal.yaml.

    What is not named keeps the width of the diagnosis. Sensors' zeros are those of the sensors of this world.
    """
    scatter, a, s = Scatter(), world.imperfections, world.sensors
    tilt = TILE * world.floor.tile_height / world.floor.tile_size
    noise = {
        "joint_stiffness.scale.spread": scatter.spring,
        "joint_damping.scale.spread": scatter.spring,
        "mass.spread": scatter.mass,
        "com.spread": scatter.com,
        "torque_zero.spread": max(s.torque_bias, 1e-3),
        "wrench_scale.scale.spread": float(np.hypot(a * made.WRENCH_GAIN, s.wrench_gain)) + 1e-4,
        "imu.spread": s.tilt_bias,
        **_zeros(s),
    }
    return noise | {
        "encoder_bias.bias.spread": float(np.hypot(a * made.ENCODER_ZERO, a * made.ECCENTRICITY / 2.0)),
        "backlash.width.spread": a * made.PLAY * 0.65,
        "joint_friction.coulomb.spread": a * made.FRICTION * 0.65,
        "transport_delay.delay.spread": a * (made.DELAY + made.LINK_LATE) * EVEN,
        "motor_lag.time_constant.spread": a * made.LAG * EVEN,
        "wrench_delay.delay.spread": a * made.WRENCH_LATE * EVEN,
        "encoder_delay.delay.spread": a * made.LINK_LATE * EVEN,
        "ground_slope.spread": float(np.hypot(a * made.SLOPE, tilt)),
    }


def _zeros(sensors: Any) -> dict[str, float]:
    """Deviations of the zeros of the foot sensors."""
    out: dict[str, float] = {}
    for k, axis in enumerate("xyz"):
        force = np.hypot(sensors.force_bias[k], 2.0 * sensors.wrench_zero * EVEN)
        moment = np.hypot(sensors.moment_bias[k], 0.1 * sensors.wrench_zero * EVEN)
        out |= {f"zero_f{axis}.spread": float(force), f"zero_t{axis}.spread": float(moment)}
    return out
