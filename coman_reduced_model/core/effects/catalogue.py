# SPDX-License-Identifier: BSD-3-Clause
"""The catalogue of effects: what can be added to the paper's model, by name.

An effect is one file with one small class; adding it here makes it a configuration key, a ROS parameter and a
candidate of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...errors import ConfigError
from ..base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from .backlash import Backlash
from .base import Effect
from .body_mass import BodyMass
from .com_offset import ComOffset
from .encoder_bias import EncoderBias
from .encoder_delay import EncoderDelay
from .external_force import ExternalForce
from .foot_slip import FootSlip
from .ground_compliance import GroundCompliance
from .ground_slope import GroundSlope
from .hysteresis import Hysteresis
from .joint_damping import JointDamping
from .joint_friction import JointFriction
from .joint_stiffness import JointStiffness
from .motor_compliance import MotorCompliance
from .motor_lag import MotorLag
from .payload import Payload
from .sensor_rotation import SensorRotation
from .spring_nonlinearity import SpringNonlinearity
from .stiffness_drift import StiffnessDrift
from .touchdown_impact import TouchdownImpact
from .transport_delay import TransportDelay
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
        SensorRotation,
        TransportDelay,
        MotorLag,
        BodyMass,
        Payload,
        ComOffset,
        FootSlip,
        JointStiffness,
        StiffnessDrift,
        JointDamping,
        SpringNonlinearity,
        Backlash,
        Hysteresis,
        MotorCompliance,
        JointFriction,
        GroundCompliance,
        GroundSlope,
        ExternalForce,
        TouchdownImpact,
    )
}


def build_effects(configured: Sequence[EffectConfig], robot: Robot) -> tuple[list[Effect], Robot]:
    """The effects of a configuration, in the order of the catalogue, and the robot with the loads that they give it.

    Each is built once, at its place in the loaded robot; the robot is the same object if there are no loads.

    Raises:
        ConfigError: one names a joint that the legs do not have, or takes more mass away than there is.
    """
    effects = [CATALOGUE[each.name](each.where, each.values) for each in configured]
    effects.sort(key=lambda effect: list(CATALOGUE).index(effect.name))
    loads = [effect for effect in effects if type(effect).load is not Effect.load]
    if loads:
        robot = robot.copy()
        for effect in loads:
            effect.bind(robot)
            effect.load(robot)
        trunk = robot.model.inertias[robot.model.frames[robot.base_id].parentJoint].mass
        if not trunk > 0.0:
            raise ConfigError(f"effects.payload.mass: leaves the trunk a mass of {trunk:g} kg")
    for effect in effects:
        effect.bind(robot)
    return effects, robot


def stream_delays(effects: Sequence[Effect]) -> dict[str, float]:
    """By input stream, by how much its stamps are later than the truth by these effects [s]."""
    streams = (JOINTS, MOTORS, REFERENCE, IMU, CONTACTS, *WRENCHES.values())
    return {stream: sum(effect.late(stream) for effect in effects) for stream in streams}


__all__ = ["CATALOGUE", "Effect", "build_effects", "stream_delays"]
