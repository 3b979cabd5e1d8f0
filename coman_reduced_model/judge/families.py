# SPDX-License-Identifier: BSD-3-Clause
"""The hidden effects of the judge, their places, and their sizes: weak, medium and strong.

A size is a multiple of what clean robots of the population vary by (sizes.yaml), of what those of its own world vary by
(variability.py), or of what the recording of this robot without the effect leaves open (sizes.py), whichever is most:
weak 2 to 4, medium 5 to 7, strong 10 to 14 standard deviations, at least 2, 5 and 10 of the recording's own. It is
given for COMAN (17.3 kg, COM at 0.38 m); on another robot forces scale with its weight, torques with weight times COM
height. Where a size would be beyond what a walking robot can have (`most`), the level is lower, and the result counts
that.

The effects themselves are those of sim/disturbances, which knows nothing of the models and the diagnosis.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..sim.disturbances import DISTURBANCES
from ..sim.robot_table import COMAN, RobotTable, UpperBody, with_upper_body
from ..sim.worlds import World
from .variability import deviation_of

LEVELS = ("weak", "medium", "strong")
MULTIPLES = ((2.0, 4.0), (5.0, 7.0), (10.0, 14.0))  # of the standard deviation, by level
SIZES = Path(__file__).with_name("sizes.yaml")
CLASSES = {  # effects that a walk alone cannot distinguish; the judge's own, independent of the diagnosis
    **dict.fromkeys(("motor_lag", "transport_delay"), "drive_delay"),
    **dict.fromkeys(("ground_slope", "external_force"), "constant_force"),
    **dict.fromkeys(("backlash", "hysteresis"), "lost_motion"),
    **dict.fromkeys(("sensor_rotation", "wrench_cross_talk"), "sensor_axes"),
}
Draw = Callable[[np.random.Generator, float, RobotTable], dict[str, Any]]
JOINTS = ("HipSag", "HipLat", "HipYaw", "KneeSag", "AnkSag", "AnkLat")  # each moves a link of a leg
ABOVE = {"", *(joint.name for joint in with_upper_body(COMAN, UpperBody(3, 6, 3)).upper)}  # trunk, waist, arms, head
SOFT = ("KneeSag", "AnkSag")
SPRINGS = ("HipSag", "HipYaw", *SOFT)  # whose spring or damper alone may differ; those of roll: soft_roll
BENT = {"HipSag": 0.41, "KneeSag": 0.14, "AnkSag": 0.065}  # springs that may be bent: torque / (weight * COM height)
FORMS = {  # that the diagnosis does not share: it has a cubic spring, looks for slides where smooth ones are, and
    # measures a landing by one pulse of three samples, as a half sine is
    "spring_nonlinearity": ("tanh", "steps"),
    "foot_slip": ("late", "sudden", "creep"),
    "touchdown_impact": ("decay", "double"),
}


@dataclass(frozen=True)
class Family:
    """One kind of hidden effect.

    Attributes:
        effect: name in sim/disturbances.
        unit: of the size.
        most: largest size, for COMAN.
        draw: parameters for a size on a robot; place and sign are drawn.
        scaled: how the size scales with the robot: mass, torque, length, 1/mass, 1/torque.
        parameter: of the diagnosis' unknown that the size is; empty: the diagnosis has none.
    """

    effect: str
    unit: str
    most: float
    draw: Draw
    scaled: str = ""
    parameter: str = ""

    @property
    def catalogued(self) -> bool:
        """Whether the diagnosis can name it."""
        return DISTURBANCES[self.effect].catalogued

    def factor(self, table: RobotTable) -> float:
        """Size on a robot over size on COMAN."""
        mass, length = table.mass / COMAN.mass, com_height(table) / com_height(COMAN)
        known = {"": 1.0, "mass": mass, "torque": mass * length, "length": length}
        return (known | {"1/mass": 1.0 / mass, "1/torque": 1.0 / (mass * length)})[self.scaled]


@functools.cache
def deviations() -> dict[str, float]:
    """By family, the standard deviation over clean robots, for COMAN."""
    read = yaml.safe_load(SIZES.read_text(encoding="utf-8"))
    return {name: float(entry["clean"]) for name, entry in read.items()}


def draw_effect(
    name: str, rng: np.random.Generator, level: int, world: World, times: float = 1.0
) -> tuple[dict[str, Any], int]:
    """Parameters of `sim.disturbances.make` for a family at a level, or at the next lower level that is possible.

    Args:
        name: of the family.
        rng: draws size, place and sign.
        level: 0, 1, 2.
        world: where the effect is hidden.
        times: larger than by what clean robots vary by: a recording leaves more open than that.

    Returns:
        The parameters, and the level that was reached.
    """
    family = FAMILIES[name]
    deviation = times * max(deviations()[name], _of_world(family, world))
    place, within = rng.integers(2**31), rng.random()
    while True:
        low, high = MULTIPLES[level]
        size = (low + (high - low) * within) * deviation
        if size <= family.most or level == 0:
            break
        level -= 1
    values = family.draw(np.random.default_rng(place), min(size, family.most) * family.factor(world.table), world.table)
    return {key: round(v, 12) if isinstance(v, float) else v for key, v in values.items()}, level


def _of_world(family: Family, world: World) -> float:
    """Standard deviation over clean robots of this world, for COMAN; 0: the world says nothing of its own."""
    deviation = deviation_of(family.effect, family.parameter, world)
    of_any_robot = family.effect in ("wrench_bias", "ground_compliance", "foot_slip", "joint_friction")
    return deviation / family.factor(world.table) if of_any_robot else deviation


def com_height(table: RobotTable) -> float:
    """Height of the COM in the robot's usual gait [m]."""
    return float(table.gait.get("com_height_m", 0.38))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _side(rng: np.random.Generator) -> str:
    return str(rng.choice(["L", "R"]))


def _foot(rng: np.random.Generator, both: bool = True) -> str:
    return str(rng.choice(["left", "right", ""] if both else ["left", "right"]))


def _joint(rng: np.random.Generator, *kinds: str) -> str:
    return _side(rng) + str(rng.choice(kinds or JOINTS))


def _joints(rng: np.random.Generator, *kinds: str) -> str:
    """One joint (half of the draws), a side, or all joints."""
    one = _joint(rng, *kinds)
    return str(rng.choice([one, one, _foot(rng, False), ""]))


def _form(rng: np.random.Generator, effect: str) -> str:
    return str(rng.choice(FORMS[effect]))


def _axis(rng: np.random.Generator, size: float, *axes: str) -> dict[str, Any]:
    return {str(rng.choice(axes)): _sign(rng) * size}


def working_stretch(joint: str, table: RobotTable) -> float:
    """Largest deflection of a joint's spring in a plain walk [rad], measured; joint without its side."""
    return BENT[joint] * 9.81 * table.mass * com_height(table) / table.stiffness[joint]


def _bend(rng: np.random.Generator, change: float, table: RobotTable) -> dict[str, Any]:
    """The secant stiffness changes by `change` at the largest deflection of these joints in a plain walk."""
    where = _joints(rng, *BENT)
    stretch = max(working_stretch(joint, table) for joint in ([where[1:]] if where[1:] in BENT else SOFT))
    return {"where": where, "cubic": change / stretch**2, "form": _form(rng, "spring_nonlinearity"), "at": stretch}


def _wrench_bias(rng: np.random.Generator, size: float, table: RobotTable) -> dict[str, Any]:
    """A vertical bias of `size` [N], a shear bias of half of it, or a moment of it at 6 cm on COMAN."""
    kind = str(rng.choice(["fz", "fx", "fy", "tx", "ty"]))
    lever = 0.06 * com_height(table) / com_height(COMAN)
    share = 1.0 if kind == "fz" else 0.5 if kind[0] == "f" else lever
    return {"where": _foot(rng, False), kind: _sign(rng) * size * share}


def _factor(rng: np.random.Generator, change: float) -> float:
    """1 - change in two draws of three, else 1 + change."""
    return 1.0 - change if rng.random() < 2.0 / 3.0 and change < 0.9 else 1.0 + change


def _payload(rng: np.random.Generator, mass: float, table: RobotTable) -> dict[str, Any]:
    length = com_height(table) / com_height(COMAN)
    x, y = (float(rng.uniform(-0.05, 0.05)) for _ in range(2))
    return {"mass": mass, "x": length * x, "y": length * y, "z": length * float(rng.uniform(0.0, 0.15))}


def _soft_ground(rng: np.random.Generator, size: float, table: RobotTable) -> dict[str, Any]:
    """`size` [m/N] of one foot under its load, and what a sole of that softness gives way in tilting."""
    return {"vertical": size, "rotational": 50.0 * size / (com_height(table) / com_height(COMAN))}


def _damping(rng: np.random.Generator, change: float, table: RobotTable) -> dict[str, Any]:
    factor = 1.0 + change
    return {"where": _joints(rng, *SPRINGS), "scale": factor if rng.random() < 0.5 else 1.0 / factor}


def link_mass(table: RobotTable, joint: str) -> float:
    """Mass [kg] of the link at a joint, of the trunk without one."""
    return next((each.link.mass for each in table.joints() if each.name == joint), table.trunk.mass)


def _body_mass(rng: np.random.Generator, mass: float, table: RobotTable) -> dict[str, Any]:
    """`mass` [kg] more, or less, of a link of a leg, of the trunk, or of an arm, the waist or the head."""
    upper = [joint.name for joint in table.upper if joint.link.mass > 0.01 * table.mass]
    where = str(rng.choice(["", _joint(rng), *([str(rng.choice(upper))] if upper else [])]))
    heavy, most = link_mass(table, where), 2.5 * table.mass / COMAN.mass  # that is ever hidden
    less = rng.random() < 0.5 and most < 0.7 * heavy  # whatever is hidden now: what grows keeps its sign
    return {"where": where, "scale": 1.0 - mass / heavy if less else 1.0 + mass / heavy}


def _arms(rng: np.random.Generator, mass: float, table: RobotTable) -> dict[str, Any]:
    return {
        "mass": mass,
        "length": 0.25 * com_height(table) / com_height(COMAN),
        "frequency": float(rng.uniform(0.6, 1.0)),
        "phase": float(rng.choice([0.0, 3.1415926])),
    }


def _push(rng: np.random.Generator, force: float, table: RobotTable) -> dict[str, Any]:
    return {
        "amplitude": force,
        "frequency": float(rng.uniform(0.8, 2.5)),
        "direction": float(rng.choice([0.0, np.pi / 2.0])),
        "phase": float(rng.uniform(-3.0, 3.0)),
    }


def _eccentric(rng: np.random.Generator, amplitude: float, table: RobotTable) -> dict[str, Any]:
    return {
        "where": _joint(rng, "HipSag", "KneeSag", "AnkSag"),
        "amplitude": amplitude,
        "per_turn": int(rng.choice([8, 16, 32])),
        "phase": float(rng.uniform(-3.0, 3.0)),
    }


# Streams in which a family shows: measured motor states have lags and yielding already; stabilisers leave the plan.
STREAMS = dict.fromkeys(("motor_lag", "transport_delay", "motor_compliance"), "commanded")
FAMILIES: dict[str, Family] = {
    "backlash": Family(
        "backlash", "rad", 0.03, lambda rng, s, table: {"where": _joints(rng), "width": s}, parameter="width"
    ),
    "hardening": Family("spring_nonlinearity", "1", 1.5, _bend, parameter="cubic"),
    "softening": Family(
        "spring_nonlinearity", "1", 0.28, lambda rng, s, table: _bend(rng, -s, table), parameter="cubic"
    ),
    "joint_friction": Family(
        "joint_friction", "Nm", 4.0, lambda rng, s, table: {"where": _joints(rng), "coulomb": s}, "torque", "coulomb"
    ),
    "joint_stiffness": Family(
        "joint_stiffness",
        "1",
        0.6,
        lambda rng, s, table: {"where": _joints(rng, *SPRINGS), "scale": _factor(rng, s)},
        parameter="scale",
    ),
    "soft_roll": Family(  # a worn flexspline, a soft mount
        "joint_stiffness",
        "1",
        0.93,
        lambda rng, s, table: {"where": _joint(rng, "HipLat", "AnkLat"), "scale": 1.0 - s},
        parameter="scale",
    ),
    "joint_damping": Family("joint_damping", "1", 4.0, _damping, parameter="scale"),
    "motor_lag": Family("motor_lag", "s", 0.035, lambda rng, s, table: {"time_constant": s}, parameter="time_constant"),
    "transport_delay": Family("transport_delay", "s", 0.04, lambda rng, s, table: {"delay": s}, parameter="delay"),
    "motor_compliance": Family(
        "motor_compliance", "rad/Nm", 0.0012, lambda rng, s, table: {"compliance": s}, "1/torque", "compliance"
    ),
    "payload": Family("payload", "kg", 3.0, _payload, "mass", "mass"),
    "com_offset": Family("com_offset", "m", 0.03, lambda rng, s, table: _axis(rng, s, "x", "y"), "length", "x"),
    "ground_compliance": Family("ground_compliance", "m/N", 1.5e-5, _soft_ground, "1/mass", "vertical"),
    "ground_slope": Family(
        "ground_slope", "rad", 0.045, lambda rng, s, table: _axis(rng, s, "roll", "pitch"), parameter="pitch"
    ),
    "external_force": Family("external_force", "N", 12.0, lambda rng, s, table: _axis(rng, s, "x", "y"), "mass", "x"),
    "foot_slip": Family(
        "foot_slip",
        "m",
        0.015,
        lambda rng, s, table: {
            "where": _foot(rng, False),
            "distance": s,
            "form": _form(rng, "foot_slip"),
        },
        "length",
        "distance",
    ),
    "touchdown_impact": Family(
        "touchdown_impact",
        "Ns",
        2.0,
        lambda rng, s, table: {"impulse": s, "form": _form(rng, "touchdown_impact")},
        "mass",
        "impulse",
    ),
    "encoder_bias": Family(
        "encoder_bias",
        "rad",
        0.04,
        lambda rng, s, table: {"where": _joint(rng), "bias": _sign(rng) * s},
        parameter="bias",
    ),
    "encoder_delay": Family("encoder_delay", "s", 0.04, lambda rng, s, table: {"delay": s}, parameter="delay"),
    "wrench_delay": Family(
        "wrench_delay", "s", 0.06, lambda rng, s, table: {"where": _foot(rng), "delay": s}, parameter="delay"
    ),
    "wrench_scale": Family(
        "wrench_scale",
        "1",
        0.4,
        lambda rng, s, table: {"where": _foot(rng), "scale": 1.0 + _sign(rng) * s},
        parameter="scale",
    ),
    "wrench_bias": Family("wrench_bias", "N", 80.0, _wrench_bias, "mass", "fz"),
    "hysteresis": Family(
        "hysteresis",
        "rad",
        0.02,
        lambda rng, s, table: {
            "where": _joints(rng, "HipSag", *SOFT),
            "width": s,
            "friction": float(rng.uniform(0.2, 1.0)),
            "form": "several",
        },
        parameter="width",
    ),
    "sensor_rotation": Family(
        "sensor_rotation",
        "rad",
        0.5,
        lambda rng, s, table: {"where": _foot(rng), "axis": str(rng.choice(["x", "y", "z"])), "angle": _sign(rng) * s},
        parameter="pitch",
    ),
    "wrench_cross_talk": Family(
        "wrench_cross_talk", "1", 0.4, lambda rng, s, table: {"where": _foot(rng), **_axis(rng, s, "fx", "fy")}
    ),
    "body_mass": Family("body_mass", "kg", 2.5, lambda rng, s, table: _body_mass(rng, s, table), "mass", "scale"),
    "stiffness_drift": Family(
        "stiffness_drift",
        "1",
        0.6,
        lambda rng, s, table: {
            "where": _joints(rng, *SOFT),
            "change": -s,
            "time": float(rng.uniform(3.0, 10.0)),
            "form": "ramp",
        },
        parameter="change",
    ),
    "sloshing_load": Family(
        "sloshing_load",
        "kg",
        3.0,
        lambda rng, s, table: {"mass": s, "frequency": float(rng.uniform(1.0, 2.0))},
        "mass",
    ),
    "swinging_arms": Family("swinging_arms", "kg", 1.2, _arms, "mass"),
    "periodic_push": Family("periodic_push", "N", 14.0, _push, "mass"),
    "cable_drag": Family(
        "cable_drag", "N", 12.0, lambda rng, s, table: {"friction": s, "spring": float(rng.uniform(0.0, 10.0))}, "mass"
    ),
    "eccentric_encoder": Family("eccentric_encoder", "rad", 0.04, _eccentric),
    "thermal_drift": Family(
        "thermal_drift", "rad/s", 0.004, lambda rng, s, table: {"where": _joint(rng), "rate": _sign(rng) * s}
    ),
    "cogging": Family(
        "cogging",
        "Nm",
        5.0,
        lambda rng, s, table: {"where": _joint(rng), "amplitude": s, "per_turn": int(rng.choice([24, 36, 60]))},
        "torque",
    ),
    "stale_stream": Family(
        "stale_stream", "s", 0.3, lambda rng, s, table: {"where": _foot(rng), "length": s, "every": 1.0}
    ),
    "late_clock": Family("late_clock", "1", 0.02, lambda rng, s, table: {"rate": s}),
}
CATALOGUED = tuple(name for name, family in FAMILIES.items() if family.catalogued)
OUTSIDE = tuple(name for name, family in FAMILIES.items() if not family.catalogued)


def class_of(effect: str, where: str | None = None) -> str:
    """The class of an effect, or its name if it has none; more mass above the legs is a payload, wherever that is."""
    if effect == "body_mass" and where in ABOVE:
        return "payload"
    return CLASSES.get(effect, effect)


def of_this_catalogue(answer: Mapping[str, Any]) -> dict[str, Any]:
    """An answer with the kind that it has now: an effect that was outside the catalogue at first may be in it."""
    inside = all(DISTURBANCES[effect["name"]].catalogued for effect in answer["effects"])
    return {**answer, "kind": "single" if answer["kind"] == "unknown" and inside else answer["kind"]}
