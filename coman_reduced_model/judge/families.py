# SPDX-License-Identifier: BSD-3-Clause
"""The hidden effects of the judge, and their sizes: weak, medium and strong.

The sizes were chosen before any diagnosis was tried on them, and do not change: weak is what a careful user just
accepts as tolerance, medium what a user wants repaired, strong what is visible without measuring. They are for COMAN
(17.3 kg, COM at 0.38 m); on another robot forces scale with its weight, torques with weight times COM height.
The effects themselves are those of sim/disturbances, which knows nothing of the models and the diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..sim.disturbances import DISTURBANCES
from ..sim.robot_table import COMAN, RobotTable

LEVELS = ("weak", "medium", "strong")
CLASSES = {  # effects that a walk alone cannot distinguish; the judge's own, independent of the diagnosis
    **dict.fromkeys(("motor_lag", "transport_delay"), "drive_delay"),
    **dict.fromkeys(("ground_slope", "external_force"), "constant_force"),
}
Draw = Callable[[np.random.Generator, float, RobotTable], dict[str, Any]]
_DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class Family:
    """One kind of hidden effect, with the sizes of its three levels."""

    effect: str  # name in sim/disturbances
    sizes: tuple[float, float, float]  # weak, medium, strong
    unit: str
    why: str
    draw: Draw  # parameters for a size: place and sign are drawn
    scaled: str = ""  # how the size scales with the robot: mass, torque, length, 1/mass, 1/torque

    @property
    def catalogued(self) -> bool:
        """Whether the diagnosis can name it."""
        return DISTURBANCES[self.effect].catalogued

    def parameters(self, rng: np.random.Generator, level: int, table: RobotTable) -> dict[str, Any]:
        """Parameters of `sim.disturbances.make` for a level 0, 1, 2 on a robot."""
        mass, length = table.mass / COMAN.mass, com_height(table) / com_height(COMAN)
        factor = {"": 1.0, "mass": mass, "torque": mass * length, "length": length}
        factor |= {"1/mass": 1.0 / mass, "1/torque": 1.0 / (mass * length)}
        values = self.draw(rng, self.sizes[level] * factor[self.scaled], table)
        return {key: round(v, 12) if isinstance(v, float) else v for key, v in values.items()}


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
    return _side(rng) + str(rng.choice(kinds or ("HipSag", "HipLat", "KneeSag", "AnkSag", "AnkLat")))


def _joints(rng: np.random.Generator) -> str:
    """One soft joint (half of the draws), a side, or all joints."""
    return str(rng.choice([_joint(rng, "KneeSag", "AnkSag"), _joint(rng, "KneeSag", "AnkSag"), _foot(rng, False), ""]))


def _axis(rng: np.random.Generator, size: float, *axes: str) -> dict[str, Any]:
    return {str(rng.choice(axes)): _sign(rng) * size}


def _bend(rng: np.random.Generator, change: float, table: RobotTable) -> dict[str, Any]:
    """The secant stiffness changes by `change` at the joint's largest deflection in a plain walk (measured, clean)."""
    where = _joint(rng, "KneeSag", "AnkSag")
    torque = {"KneeSag": 0.14, "AnkSag": 0.065}[where[1:]] * 9.81 * table.mass * com_height(table)
    return {"where": where, "cubic": change / (torque / table.stiffness[where[1:]]) ** 2}


def _wrench_bias(rng: np.random.Generator, size: float, table: RobotTable) -> dict[str, Any]:
    """A vertical bias of `size` [N], a shear bias of half of it, or a moment of it at 6 cm on COMAN."""
    kind = str(rng.choice(["fz", "fx", "fy", "tx", "ty"]))
    lever = 0.06 * com_height(table) / com_height(COMAN)
    return {"where": _foot(rng, False), kind: _sign(rng) * size * {"z": 1.0, "f": 0.5, "t": lever}[_which(kind)]}


def _which(kind: str) -> str:
    return "z" if kind == "fz" else kind[0]


def _factor(rng: np.random.Generator, change: float) -> float:
    """1 - change in two draws of three, else 1 + change."""
    return 1.0 - change if rng.random() < 2.0 / 3.0 else 1.0 + change


FAMILIES: dict[str, Family] = {
    "backlash": Family(
        "backlash",
        (0.3 * _DEGREE, 0.7 * _DEGREE, 1.5 * _DEGREE),
        "rad",
        "0.3 degrees is a new gear train, 0.7 one that needs adjusting, 1.5 rattles",
        lambda rng, s, table: {"where": _joint(rng), "width": s},
    ),
    "hardening": Family(
        "spring_nonlinearity",
        (0.10, 0.25, 0.50),
        "1",
        "share by which a spring is stiffer at its full working load: wire, elastomer, bumper",
        _bend,
    ),
    "softening": Family(
        "spring_nonlinearity",
        (-0.08, -0.15, -0.25),
        "1",
        "the same, softer; at -0.33 the tangent would be zero there",
        _bend,
    ),
    "joint_friction": Family(
        "joint_friction",
        (0.5, 1.5, 3.5),
        "Nm",
        "1, 3 and 6 % of the drive's 55 Nm: a bearing, a tight seal, a damaged one",
        lambda rng, s, table: {"where": _joint(rng), "coulomb": s},
        "torque",
    ),
    "joint_stiffness": Family(
        "joint_stiffness",
        (0.10, 0.20, 0.40),
        "1",
        "share by which a spring, the springs of a leg, or all differ: beyond the tolerance of 4 %",
        lambda rng, s, table: {"where": _joints(rng), "scale": _factor(rng, s)},
    ),
    "soft_roll": Family(
        "joint_stiffness",
        (0.25, 0.50, 0.75),
        "1",
        "share by which a hip or ankle roll drive is softer than the data sheet: worn flexspline, soft mount",
        lambda rng, s, table: {"where": _joint(rng, "HipLat", "AnkLat"), "scale": 1.0 - s},
    ),
    "joint_damping": Family(
        "joint_damping",
        (1.5, 2.5, 4.0),
        "1",
        "factor: damping is the least certain value of a data sheet",
        lambda rng, s, table: {"where": _joints(rng), "scale": s if rng.random() < 0.5 else 1.0 / s},
    ),
    "motor_lag": Family(
        "motor_lag",
        (0.005, 0.015, 0.030),
        "s",
        "position loops of 32, 11 and 5 Hz",
        lambda rng, s, table: {"time_constant": s},
    ),
    "transport_delay": Family(
        "transport_delay",
        (0.005, 0.015, 0.030),
        "s",
        "one, three and six cycles of a 200 Hz bus",
        lambda rng, s, table: {"delay": s},
    ),
    "motor_compliance": Family(
        "motor_compliance",
        (0.0002, 0.0005, 0.001),
        "rad/Nm",
        "loops of 5000, 2000 and 1000 Nm/rad, where good ones have 20000; 4, 9 and 18 % of the knee's spring",
        lambda rng, s, table: {"compliance": s},
        "1/torque",
    ),
    "payload": Family(
        "payload",
        (0.3, 0.7, 1.5),
        "kg",
        "2, 4 and 9 % of the robot: a computer, a battery, a bag",
        lambda rng, s, table: {
            "mass": s,
            "x": float(rng.uniform(-0.05, 0.05)),
            "y": float(rng.uniform(-0.05, 0.05)),
            "z": float(rng.uniform(0.0, 0.15)),
        },
        "mass",
    ),
    "com_offset": Family(
        "com_offset",
        (0.005, 0.012, 0.025),
        "m",
        "of the trunk's COM: a cable tray, a moved board, a moved battery",
        lambda rng, s, table: _axis(rng, s, "x", "y"),
        "length",
    ),
    "ground_compliance": Family(
        "ground_compliance",
        (1.0, 2.5, 5.0),
        "2e-6 m/N",
        "under the whole weight a foot sinks in 0.3, 0.8, 1.7 mm: rubber, carpet, mat; 1e-4 rad/Nm each of tilting",
        lambda rng, s, table: {
            "vertical": 2e-6 * s,
            "rotational": 1e-4 * s / (com_height(table) / com_height(COMAN)),
        },
        "1/mass",
    ),
    "ground_slope": Family(
        "ground_slope",
        (0.5 * _DEGREE, 1.0 * _DEGREE, 2.0 * _DEGREE),
        "rad",
        "an old floor, a bad floor, a drain",
        lambda rng, s, table: _axis(rng, s, "roll", "pitch"),
    ),
    "external_force": Family(
        "external_force",
        (2.0, 4.0, 8.0),
        "N",
        "1, 2.5 and 5 % of the weight: a cable that hangs, a cable that pulls, a hand",
        lambda rng, s, table: _axis(rng, s, "x", "y"),
        "mass",
    ),
    "foot_slip": Family(
        "foot_slip",
        (0.003, 0.006, 0.012),
        "m",
        "a step: a tenth, a fifth and four tenths of the paper's short step",
        lambda rng, s, table: {"where": _foot(rng, False), "distance": s},
        "length",
    ),
    "touchdown_impact": Family(
        "touchdown_impact",
        (0.3, 0.7, 1.5),
        "Ns",
        "a foot of 1.4 kg that lands with 0.2, 0.5 and 1 m/s",
        lambda rng, s, table: {"impulse": s},
        "mass",
    ),
    "encoder_bias": Family(
        "encoder_bias",
        (0.3 * _DEGREE, 0.7 * _DEGREE, 1.5 * _DEGREE),
        "rad",
        "calibrated with care, by eye, and not at all",
        lambda rng, s, table: {"where": _joint(rng), "bias": _sign(rng) * s},
    ),
    "encoder_delay": Family(
        "encoder_delay",
        (0.005, 0.015, 0.030),
        "s",
        "one, three and six cycles of a 200 Hz bus",
        lambda rng, s, table: {"delay": s},
    ),
    "wrench_delay": Family(
        "wrench_delay",
        (0.005, 0.015, 0.030),
        "s",
        "the same; a real iCub has 30 to 60 ms",
        lambda rng, s, table: {"where": _foot(rng), "delay": s},
    ),
    "wrench_scale": Family(
        "wrench_scale",
        (0.03, 0.07, 0.15),
        "1",
        "a real iCub has 2.5 %; 15 % is a wrong calibration matrix",
        lambda rng, s, table: {"where": _foot(rng), "scale": 1.0 + _sign(rng) * s},
    ),
    "wrench_bias": Family(
        "wrench_bias",
        (5.0, 12.0, 25.0),
        "N",
        "3, 7 and 15 % of the weight on top of a drift of 1 %: not zeroed since yesterday, since it was built, broken",
        _wrench_bias,
        "mass",
    ),
    "sloshing_load": Family(
        "sloshing_load",
        (0.7, 1.5, 2.5),
        "kg",
        "of the trunk's 5.5 kg",
        lambda rng, s, table: {"mass": s, "frequency": float(rng.uniform(1.0, 2.0))},
        "mass",
    ),
    "swinging_arms": Family(
        "swinging_arms",
        (0.3, 0.6, 1.0),
        "kg",
        "each arm, swinging by 30 degrees, in step or against each other",
        lambda rng, s, table: {
            "mass": s,
            "length": 0.25 * com_height(table) / com_height(COMAN),
            "frequency": float(rng.uniform(0.6, 1.0)),
            "phase": float(rng.choice([0.0, 3.1415926])),
        },
        "mass",
    ),
    "periodic_push": Family(
        "periodic_push",
        (3.0, 6.0, 10.0),
        "N",
        "2, 3.5 and 6 % of the weight",
        lambda rng, s, table: {
            "amplitude": s,
            "frequency": float(rng.uniform(0.8, 2.5)),
            "direction": float(rng.choice([0.0, np.pi / 2.0])),
            "phase": float(rng.uniform(-3.0, 3.0)),
        },
        "mass",
    ),
    "eccentric_encoder": Family(
        "eccentric_encoder",
        (0.3 * _DEGREE, 0.7 * _DEGREE, 1.5 * _DEGREE),
        "rad",
        "amplitude of the error: as encoder_bias",
        lambda rng, s, table: {
            "where": _joint(rng, "HipSag", "KneeSag", "AnkSag"),
            "amplitude": s,
            "per_turn": int(rng.choice([8, 16, 32])),
            "phase": float(rng.uniform(-3.0, 3.0)),
        },
    ),
    "twisted_sensor": Family(
        "twisted_sensor",
        (5.0 * _DEGREE, 10.0 * _DEGREE, 20.0 * _DEGREE),
        "rad",
        "a slack bolt pattern, a hole missed, a sensor put in wrongly",
        lambda rng, s, table: {
            "where": _foot(rng, False),
            "axis": str(rng.choice(["x", "z"])),
            "angle": _sign(rng) * s,
        },
    ),
}
CATALOGUED = tuple(name for name, family in FAMILIES.items() if family.catalogued)
OUTSIDE = tuple(name for name, family in FAMILIES.items() if not family.catalogued)


def class_of(effect: str) -> str:
    """The class of an effect, or its name if it has none."""
    return CLASSES.get(effect, effect)
