# SPDX-License-Identifier: BSD-3-Clause
"""How much clean robots of a world vary: the true standard deviations, by which rank.py and sizes.py measure."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..sim.disturbances import imperfections as made
from ..sim.disturbances.masses import Scatter
from ..sim.robot_table import RobotTable
from ..sim.worlds import World

SPREADS = {  # effects whose size varies as another figure of `true_deviations`
    "hysteresis": "backlash.width",
    "stiffness_drift": "joint_stiffness.scale",
    "ground_slope": "ground_slope",
    "wrench_bias": "zero_fz",
    "sensor_rotation": "sensor_rotation.angle",
    "wrench_cross_talk": "wrench_cross_talk",
}
# [m] Measured on walks of clean robots, 16 each, in Drake 5: slide of a step where friction is hardly stiffer than the
# contact; by how much more than others soft soles sink under the weight.
CREEP, SOFT = 0.7e-3, {"mujoco": 1.0e-3, "drake": 0.3e-3}
TILE = 1.0 / np.sqrt(6.0)  # deviation of the step between two tiles over the largest height of a tile
EVEN = 1.0 / np.sqrt(12.0)  # standard deviation of an even distribution over its width


def true_deviations(world: World) -> dict[str, float]:
    """Standard deviations over clean robots of this world, by the names of config/nominal.yaml.

    What is not named keeps the width of the diagnosis, which has none of cross-talk. Sensors' zeros are those of the
    sensors of this world.
    """
    scatter, a, s = Scatter(), world.imperfections, world.sensors
    tilt = TILE * world.floor.tile_height / world.floor.tile_size
    noise = {
        "joint_stiffness.scale.spread": scatter.spring,
        "joint_damping.scale.spread": scatter.spring,
        "mass.spread": scatter.mass,
        "com.spread": scatter.com,
        "torque_zero.spread": max(s.torque_bias, 1e-3) / edge(world.table),
        "wrench_scale.scale.spread": float(np.hypot(a * made.WRENCH_GAIN, s.wrench_gain)) + 1e-4,
        "imu.spread": s.tilt_bias,
        **_zeros(s),
        **_soles(world),
    }
    cross_talk = float(np.hypot(a * made.CROSS_TALK, s.cross_talk))
    return noise | {
        "encoder_bias.bias.spread": float(np.hypot(a * made.ENCODER_ZERO, a * made.ECCENTRICITY / 2.0)),
        "backlash.width.spread": a * made.PLAY * 0.65,
        "joint_friction.coulomb.spread": a * made.FRICTION * made.torque_of(world.table) * 0.65 / edge(world.table),
        "transport_delay.delay.spread": a * (made.DELAY + made.LINK_LATE) * EVEN,
        "motor_lag.time_constant.spread": a * made.LAG * EVEN,
        "wrench_delay.delay.spread": a * made.WRENCH_LATE * EVEN,
        "encoder_delay.delay.spread": a * made.LINK_LATE * EVEN,
        "ground_slope.spread": float(np.hypot(a * made.SLOPE, tilt)),
        "wrench_cross_talk.spread": cross_talk,
        "sensor_rotation.angle.spread": float(np.hypot(a * made.WRENCH_TURN, cross_talk)),  # they look alike
    }


def deviation_of(effect: str, parameter: str, world: World) -> float:
    """Standard deviation of the size of an effect over clean robots of this world; 0: nothing is known of it."""
    name = SPREADS.get(effect, f"{effect}.{parameter}")
    deviation = true_deviations(world).get(f"{name}.spread", 0.0)
    if effect == "ground_compliance":
        return deviation / (9.81 * world.table.mass)  # [m] under the weight
    return deviation * edge(world.table) if effect == "joint_friction" else deviation


def edge(table: RobotTable) -> float:
    """[Nm] of a foot of a robot that bears the weight at its front edge."""
    return 9.81 * table.mass * 0.5 * (table.foot_back + table.foot_front)


def _soles(world: World) -> dict[str, float]:
    """Of soles that creep, and of soft ones."""
    contact, mujoco, out = world.contact, world.engine == "mujoco", {}
    if mujoco and contact.impratio <= 2.0:
        out["foot_slip.distance.spread"] = CREEP
    soft = contact.solimp[0] < 0.9 if mujoco else contact.modulus < 1e6
    if soft:
        out["ground_compliance.vertical.spread"] = SOFT[world.engine]
    return out


def _zeros(sensors: Any) -> dict[str, float]:
    """Deviations of the zeros of the foot sensors."""
    out: dict[str, float] = {}
    for k, axis in enumerate("xyz"):
        force = np.hypot(sensors.force_bias[k], 2.0 * sensors.wrench_zero * EVEN)
        moment = np.hypot(sensors.moment_bias[k], 0.1 * sensors.wrench_zero * EVEN)
        out |= {f"zero_f{axis}.spread": float(force), f"zero_t{axis}.spread": float(moment)}
    return out
