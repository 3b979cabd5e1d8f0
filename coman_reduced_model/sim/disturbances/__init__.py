# SPDX-License-Identifier: BSD-3-Clause
"""What the robot's description does not say: effects hidden in the physics or in the sensors, one class each.

robot = VirtualRobot(COMAN, disturbances=[Backlash("LKneeSag", 0.012), parse("payload:mass=0.7,x=0.03")])
"""

from __future__ import annotations

from dataclasses import fields
from difflib import get_close_matches
from typing import Any

from ...errors import ConfigError
from .base import Disturbance, Later, TooHeavyError, feet, joint_indices, overrides
from .floor import ExternalForce, FootSlip, GroundCompliance, GroundSlope, TouchdownImpact
from .imperfections import Imperfections
from .masses import BodyMass, ComOffset, Payload, Scatter
from .motors import MotorCompliance, MotorLag, TransportDelay
from .outside import (
    CableDrag,
    Cogging,
    EccentricEncoder,
    LateClock,
    PeriodicPush,
    SloshingLoad,
    StaleStream,
    SwingingArms,
    ThermalDrift,
)
from .sensors import (
    EncoderBias,
    EncoderDelay,
    SensorRotation,
    WrenchBias,
    WrenchCrossTalk,
    WrenchDelay,
    WrenchScale,
)
from .springs import (
    Backlash,
    Hysteresis,
    JointDamping,
    JointFriction,
    JointStiffness,
    SpringNonlinearity,
    StiffnessDrift,
)

_ALL: tuple[type[Disturbance], ...] = (
    *(SpringNonlinearity, Backlash, Hysteresis, JointFriction, JointStiffness, StiffnessDrift, JointDamping),
    *(MotorLag, TransportDelay, MotorCompliance),
    *(Payload, ComOffset, BodyMass),
    *(GroundCompliance, GroundSlope, ExternalForce, FootSlip, TouchdownImpact),
    *(EncoderBias, EncoderDelay, WrenchDelay, WrenchScale, WrenchBias, SensorRotation, WrenchCrossTalk),
    *(SloshingLoad, SwingingArms, PeriodicPush, CableDrag),
    *(EccentricEncoder, ThermalDrift, Cogging, StaleStream, LateClock),
    *(Scatter, Imperfections),
)
DISTURBANCES: dict[str, type[Disturbance]] = {kind.name: kind for kind in _ALL}

__all__ = [*(kind.__name__ for kind in _ALL), "DISTURBANCES", "Disturbance", "Later", "TooHeavyError", "feet",
           "joint_indices", "make", "overrides", "parse"]  # fmt: skip


def make(name: str, values: dict[str, Any]) -> Disturbance:
    """A disturbance by its name, with some parameters given.

    Raises:
        ConfigError: there is no such disturbance or parameter, or a value is not allowed.
    """
    if name not in DISTURBANCES:
        near = get_close_matches(name, DISTURBANCES, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ConfigError(f"{name!r} cannot be hidden (allowed: {', '.join(DISTURBANCES)}{hint})")
    kind = DISTURBANCES[name]
    allowed = [f.name for f in fields(kind)]
    for key in values:
        if key not in allowed:
            raise ConfigError(f"{name}: {key}: unknown parameter (allowed: {', '.join(allowed)})")
    return kind(**values)


def parse(text: str) -> Disturbance:
    """A disturbance from a text such as `backlash:where=LKneeSag,width=0.012`; with `after=6` it begins after 6 s.

    Raises:
        ConfigError: as `make`, or it is not of that form.
    """
    name, _, rest = text.partition(":")
    values: dict[str, Any] = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or key in values:
            raise ConfigError(f"{text!r}: {item!r}: wanted: NAME:KEY=VALUE,KEY=VALUE, each key once")
        values[key] = value if key in ("where", "axis") else _number(value)
    after = values.pop("after", None)
    effect = make(name.strip(), values)
    if after is None:
        return effect
    if isinstance(after, str) or not after >= 0.0:
        raise ConfigError(f"{text!r}: after = {after!r}: allowed: seconds, not negative")
    return Later(effect, after)


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text  # the parameter says what it wants instead
