# SPDX-License-Identifier: BSD-3-Clause
"""Widths of the priors by name: how much the parameters of effects vary on nominal robots, and where an effect is.

`spread` is a standard deviation over nominal robots, `reach` one where the effect is there, `slack` one that is not
worth a name. Those that are relative say to what. What is common on real robots and in data sheets sets them; those of
clocks, soles, slides and landings also what nominal virtual robots do; none comes from the cases that are reported.
"""

from __future__ import annotations

from typing import Any

WIDTHS: dict[str, float] = {
    # Joints.
    "joint_stiffness.scale.spread": 0.045,  # of nominal, each joint
    "joint_stiffness.scale.slack": 0.02,  # of nominal, all joints of a leg or of both alike
    "joint_stiffness.scale.reach": 0.3,
    "joint_damping.scale.spread": 0.10,  # as of stiffness
    "joint_damping.scale.slack": 0.15,
    "joint_damping.scale.reach": 1.0,
    "encoder_bias.bias.spread": 0.001,  # [rad] zero of a link encoder
    "encoder_bias.bias.reach": 0.02,
    "spring_nonlinearity.cubic.spread": 0.025,  # of the torque, at the stretch under a typical load
    "spring_nonlinearity.cubic.reach": 0.4,
    "backlash.width.slack": 0.001,  # [rad] of any gear
    "backlash.width.reach": 0.01,
    "joint_friction.coulomb.spread": 0.10,  # [Nm]
    "joint_friction.coulomb.reach": 2.0,
    "joint_friction.creep.spread": 0.02,  # [rad/s]
    "joint_friction.creep.reach": 0.1,
    "torque_zero.spread": 0.15,  # [Nm] zero of a joint torque sensor
    # Motors.
    "transport_delay.delay.spread": 0.0012,  # [s] between what one driver reads
    "transport_delay.delay.slack": 0.002,
    "transport_delay.delay.reach": 0.03,
    "transport_delay.plan.slack": 0.003,  # [s] against the plan
    "motor_lag.time_constant.slack": 0.003,  # [s] of a good position loop
    "motor_lag.time_constant.reach": 0.03,
    "motor_compliance.compliance.spread": 3e-5,  # [rad/Nm] of a position loop
    "motor_compliance.compliance.reach": 3e-4,
    "lead.spread": 0.004,  # [m] of references planned ahead of the springs' sag
    "sag.spread": 0.5,  # of the springs' sag under the planned torques, by which motors are commanded ahead
    "settling.spread": 0.01,  # [s] with which a position loop yields
    "rotor.spread": 0.15,  # [kg m^2] reflected, that it carries (by its data, COMAN's is 0.139): of no effect by itself
    # Masses.
    "payload.mass.reach": 0.06,  # of the robot's mass
    "payload.x.reach": 0.06,  # [kg m] first moments until the mass is known
    "payload.y.reach": 0.04,
    "payload.z.reach": 0.03,
    "com_offset.reach": 0.03,  # [m]
    "com_offset.z.reach": 0.012,  # [m] of the trunk: cables, covers, and walking hardly shows it
    "mass.spread": 0.03,  # of nominal
    "com.spread": 0.0025,  # [m]
    "com_z.spread": 0.012,  # [m] of the trunk, as an offset
    # Foot sensors and clocks.
    "wrench_scale.scale.spread": 0.01,
    "wrench_scale.scale.reach": 0.15,
    "wrench_delay.delay.spread": 0.0015,  # [s] between streams
    "wrench_delay.delay.reach": 0.03,
    "wrench_bias.force.reach": 15.0,  # [N]
    "wrench_bias.moment.reach": 1.0,  # [Nm]
    "zero_fx.spread": 1.0,  # [N] zeros of a foot sensor
    "zero_fy.spread": 1.0,
    "zero_fz.spread": 2.2,
    "zero_tx.spread": 0.045,  # [Nm]
    "zero_ty.spread": 0.045,
    "zero_tz.spread": 0.035,
    "encoder_delay.delay.spread": 0.0012,  # [s] between what one driver reads
    "encoder_delay.delay.reach": 0.03,
    # Ground and surroundings.
    "ground_slope.spread": 0.002,  # [rad] no floor is quite level
    "ground_slope.reach": 0.05,
    "imu.spread": 0.004,  # [rad] zero of the tilt
    "external_force.spread": 0.5,  # [N] cables
    "external_force.reach": 10.0,
    "foot_slip.distance.spread": 0.0007,  # [m] that soles creep while the load passes
    "foot_slip.distance.reach": 0.02,
    "touchdown_impact.impulse.reach": 0.05,  # [m/s] a hard landing, by the robot's mass
    "landings.spread": 0.005,  # [m/s] by which landings differ in how they stop the robot, by its mass
    # [rad], [m] that sole and floor give way under a foot that bears the weight at its edge: usually, by how much that
    # differs, and on a soft floor.
    "ground_compliance.rotational.usual": 0.0027,
    "ground_compliance.rotational.spread": 0.0012,
    "ground_compliance.rotational.reach": 0.012,
    "ground_compliance.vertical.usual": 1.6e-4,
    "ground_compliance.vertical.spread": 1.2e-4,
    "ground_compliance.vertical.reach": 2e-3,
}


def widths(of: str = "", *kinds: str, times: float = 1.0, per: float = 1.0, **names: str) -> dict[str, Any]:
    """Widths for an `Unknown`, with the names by which they were taken.

    Args:
        of: a name in `WIDTHS` without its kind.
        kinds: spread, reach, slack, usual: all that it is to have.
        times, per: what those that are relative are multiplied, and divided, by.
        names: by kind, the whole name of a width that is called otherwise.
    """
    used = {kind: f"{of}.{kind}" for kind in kinds} | names
    return {kind: WIDTHS[name] * times / per for kind, name in used.items()} | {"widths": used}
