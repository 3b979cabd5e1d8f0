# SPDX-License-Identifier: BSD-3-Clause
"""The catalogue of effects: what can be added to the paper's model, by name.

An effect is one file with one small class; adding it here makes it a configuration key, a ROS parameter and a
candidate of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...errors import ConfigError
from ..base.stream_names import IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from .backlash import Backlash
from .base import Effect
from .com_offset import ComOffset
from .encoder_bias import EncoderBias
from .encoder_delay import EncoderDelay
from .external_force import ExternalForce
from .foot_slip import FootSlip
from .gravity_stiffness import GravityStiffness
from .ground_compliance import GroundCompliance
from .ground_slope import GroundSlope
from .joint_damping import JointDamping
from .joint_friction import JointFriction
from .joint_stiffness import JointStiffness
from .lateral_compliance import LateralCompliance
from .motor_compliance import MotorCompliance
from .motor_lag import MotorLag
from .payload import Payload
from .spring_nonlinearity import SpringNonlinearity
from .swing_momentum import SwingMomentum
from .touchdown_impact import TouchdownImpact
from .transport_delay import TransportDelay
from .trunk_rotation import TrunkRotation
from .wrench_bias import WrenchBias
from .wrench_delay import WrenchDelay
from .wrench_scale import WrenchScale

if TYPE_CHECKING:
    from ..robot.robot import Robot
    from .base import EffectConfig

# In the order in which they act, whatever the order in a configuration. Sensors come first (they say scale * truth +
# bias), then loads, then springs from the inside out: after the spring what is in series with it, then what is beside.
CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        EncoderDelay,
        EncoderBias,
        WrenchDelay,
        WrenchBias,
        WrenchScale,
        TransportDelay,
        MotorLag,
        Payload,
        ComOffset,
        FootSlip,
        JointStiffness,
        JointDamping,
        SpringNonlinearity,
        Backlash,
        MotorCompliance,
        JointFriction,
        GroundCompliance,
        GravityStiffness,
        TrunkRotation,
        SwingMomentum,
        LateralCompliance,
        GroundSlope,
        ExternalForce,
        TouchdownImpact,
    )
}


def active_effects(configured: Sequence[EffectConfig], robot: Robot) -> list[Effect]:
    """The effects of a configuration, each at its place in the robot, in the order of the catalogue.

    Raises:
        ConfigError: one names a joint that the legs do not have.
    """
    effects = [CATALOGUE[each.name](each.where, each.values) for each in configured]
    effects.sort(key=lambda effect: list(CATALOGUE).index(effect.name))
    for effect in effects:
        effect.bind(robot)
    return effects


def stream_delays(configured: Sequence[EffectConfig], robot: Robot) -> dict[str, float]:
    """By input stream, by how much its stamps are later than the truth by the effects of a configuration [s].

    Raises:
        ConfigError: an effect names a joint that the legs do not have.
    """
    effects = active_effects(configured, robot)
    streams = (JOINTS, MOTORS, REFERENCE, IMU, *WRENCHES.values())
    return {stream: sum(effect.late(stream) for effect in effects) for stream in streams}


def loaded(robot: Robot, configured: Sequence[EffectConfig]) -> Robot:
    """The robot with the loads that the effects of a configuration give it; the same object if they give none.

    Raises:
        ConfigError: an effect names a joint that the legs do not have, or takes more mass away than there is.
    """
    effects = [effect for effect in active_effects(configured, robot) if type(effect).load is not Effect.load]
    if not effects:
        return robot
    result = robot.copy()
    for effect in effects:
        effect.load(result)
    trunk = result.model.inertias[result.model.frames[result.base_id].parentJoint].mass
    if not trunk > 0.0:
        raise ConfigError(f"effects.payload.mass: leaves the trunk a mass of {trunk:g} kg")
    return result


__all__ = ["CATALOGUE", "Effect", "active_effects", "loaded", "stream_delays"]
