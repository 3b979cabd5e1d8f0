# SPDX-License-Identifier: BSD-3-Clause
"""What a diagnosis fits of an effect: its unknowns, each with its prior and what it does to a measurement or the world.

The diagnosis owns recordings and worlds; an effect sees of them what the protocols here say.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeVar, cast

import numpy as np
import pinocchio as pin

from ..base.delays import apart
from ..base.nominal import Nominal
from ..base.types import Array, Foot, Integers
from ..robot.limits import leg_length
from ..robot.robot import Robot

PLAN, LINKS = "plan", "all"  # a second way for the same effect to show itself, not a place
ROBOT, FOOT_SENSORS = "robot", "foot sensors"
OF_FOOT_SENSORS = ("wrench_scale", "wrench_delay", "wrench_bias", "sensor_rotation")
FEET = {"left": (Foot.LEFT,), "right": (Foot.RIGHT,), "": (Foot.LEFT, Foot.RIGHT)}


class Measured(Protocol):
    """A recording on a uniform grid of n times; joints in the order of `Robot.joint_names`.

    Attributes:
        rate: of the grid [Hz].
        q, tau, motor_q: (n, nj) link side [rad], torques [Nm], motor side [rad].
        plan: (n, 2) x, y of the planned COM in the stance sole [m].
        wrench: by foot (n, 6) in the sole frame [N, Nm].
    """

    @property
    def rate(self) -> float: ...
    @property
    def q(self) -> Array: ...
    @property
    def tau(self) -> Array | None: ...
    @property
    def motor_q(self) -> Array | None: ...
    @property
    def plan(self) -> Array | None: ...
    @property
    def wrench(self) -> dict[Foot, Array]: ...

    def changed(self, **fields: object) -> Measured:
        """A copy with other arrays."""


class World(Protocol):
    """What the robot and its surroundings are believed to be; its fields are described in `diagnose/data/world.py`."""

    robot: Robot
    model: pin.Model

    def changed(self, **fields: object) -> World:
        """A copy with other fields."""

    def add_mass(self, mass: float, position: Array, frame: int) -> World:
        """A copy with a point mass [kg] at a position (3,) [m] in a frame of the URDF."""


Change = Callable[[Any, Any, float], tuple[Any, Any]]
_R = TypeVar("_R", bound=Measured)
_W = TypeVar("_W", bound=World)


@dataclass(frozen=True)
class Unknown:
    """One unknown (parameter) of a hypothesis.

    It has two widths: `spread`, how much it varies from one nominal robot to the next (springs and masses scatter by
    some percent, sensors have small biases), and `reach`, how large it may be if the effect is there. An unknown
    without spread is absent from nominal robots. The evidence for an effect is what its unknowns gain by being let out
    of their spread.

    Attributes:
        effect, where, key: as in the configuration; effect "" for what only nominal scatter has.
        unit: of the value.
        change: recording and world (`Measured`, `World`) under the hypothesis that the value is nominal + x.
        reach, spread: standard deviations of x with and without the effect.
        precise: spread over robots on which all of its `part` is precise; None: as over all others.
        usual: what nominal robots have of it, beyond nominal: deviations count from there.
        nominal: value when there is no such effect.
        step: for the difference quotient; default: a tenth of the reach.
        low: least physical deviation from nominal.
        own: each recording has its own value: sensors' zeros change from one day to the next.
        offered: as a candidate; else it is too fine for this recording.
        shape: it does nothing without the other unknowns of its effect.
        logarithmic: the value is nominal * exp(x) instead of nominal + x.
        widths: names in `Nominal.widths` of the widths, by kind; relative: what they are multiplied by.
    """

    effect: str
    where: str
    key: str
    unit: str
    change: Change
    reach: float
    spread: float = 0.0
    precise: float | None = None
    usual: float = 0.0
    nominal: float = 0.0
    step: float = 0.0
    low: float = -np.inf
    own: bool = False
    offered: bool = True
    shape: bool = False
    logarithmic: bool = False
    widths: Mapping[str, str] = field(default_factory=dict, compare=False)
    relative: float = 1.0

    def __post_init__(self) -> None:
        if not self.step:
            object.__setattr__(self, "step", 0.1 * self.reach)

    @property
    def part(self) -> str:
        """Of a robot, that is precise as a whole or is not: its foot sensors, or all else."""
        return FOOT_SENSORS if self.effect in OF_FOOT_SENSORS else ROBOT

    @property
    def name(self) -> str:
        return f"{self.effect}@{self.where}.{self.key}" if self.effect else f"{self.key}@{self.where}"

    def value(self, x: float) -> float:
        """The parameter at a deviation x from nominal; infinite where its logarithm is open at the top."""
        if not self.logarithmic:
            return self.nominal + x
        with np.errstate(over="ignore"):
            return self.nominal * float(np.exp(x))

    def deviation(self, value: float) -> float:
        """Of the parameter from nominal: the inverse of `value`."""
        return float(np.log(value / self.nominal)) if self.logarithmic else value - self.nominal

    def apply(self, recording: _R, world: _W, x: float) -> tuple[_R, _W]:
        """Recording and world under the hypothesis that the value differs from nominal by x."""
        return cast("tuple[_R, _W]", self.change(recording, world, x))


@dataclass(frozen=True)
class About:
    """What an effect may know of a recording before it says what could be found of it.

    Attributes:
        gravity: [m/s^2].
        motors, efforts, plan: whether there are motor states, joint torques, a planned COM.
        stretch: (nj,) a large stretch of each joint's spring in this recording [rad].
        count: (nj,) resolution of the link encoders [rad]; 0 where none shows.
        nominal: how nominal robots vary.
    """

    robot: Robot
    gravity: float
    motors: bool
    efforts: bool
    plan: bool
    stretch: Array
    count: Array
    nominal: Nominal

    def widths(self, of: str = "", *kinds: str, **more: Any) -> dict[str, Any]:
        """Widths for an `Unknown`, by `Nominal.width`."""
        return self.nominal.width(of, *kinds, **more)

    @property
    def joints(self) -> dict[str, Integers]:
        """By name of a leg's joint, its index (1,) in `Robot.joint_names`."""
        return {self.robot.joint_names[j]: np.array([j]) for foot in FEET[""] for j in self.robot.legs[foot]}

    @property
    def joints_and_legs(self) -> dict[str, Integers]:
        """By place, indices of joints: each alone, all of a leg, all ("")."""
        legs = {where: np.concatenate([self.robot.legs[foot] for foot in feet]) for where, feet in FEET.items()}
        return {**self.joints, **legs}

    @property
    def weight(self) -> float:
        """[N]."""
        return self.robot.mass * self.gravity

    @cached_property
    def leg(self) -> float:
        """[m] of a stretched leg."""
        return leg_length(self.robot)

    @property
    def edge(self) -> float:
        """[Nm] of a foot that bears the weight at its front edge."""
        return self.weight * 0.5 * self.robot.sole_length


def applied(known: Sequence[Unknown], at: Array, recording: _R, world: _W) -> tuple[_R, _W]:
    """Recording and world under the hypothesis of deviations `at` (P,) from nominal, of each beyond what is usual."""
    for unknown, value in zip(known, at, strict=True):
        if value:
            recording, world = unknown.apply(recording, world, float(value) + unknown.usual)
    return recording, world


# --- what unknowns do ---


def world_plus(name: str, which: Integers | int | None = None) -> Change:
    """Adds to a field of the world, or to some of its elements."""
    if which is None:
        return lambda r, w, x: (r, w.changed(**{name: getattr(w, name) + x}))
    return world_elements(name, which, lambda values, x: values + x)


def world_elements(name: str, which: Integers | int, change: Callable[[Array, float], Array]) -> Change:
    """Changes some elements of a field of the world."""

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        values = getattr(w, name).copy()
        values[which] = change(values[which], x)
        return r, w.changed(**{name: values})

    return apply


def arrays_changed(names: Sequence[str], change: Callable[[Array, float, float], Array]) -> Change:
    """Changes arrays of the measurement, by themselves, x and the rate of the grid [Hz]; a plan in one frame."""

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        changed = {}
        for name in names:
            values, jumps = apart(getattr(r, name), r.rate) if name == PLAN else (getattr(r, name), 0.0)
            changed[name] = change(values, x, r.rate) + jumps
        return r.changed(**changed), w

    return apply


def columns_minus(name: str, which: Integers) -> Change:
    """Takes an error off some columns of an array of the measurement."""

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        values = getattr(r, name).copy()
        values[:, which] -= x
        return r.changed(**{name: values}), w

    return apply


def wrenches_changed(feet: tuple[Foot, ...], change: Callable[[Array, float, float], Array]) -> Change:
    """Changes the wrenches (n, 6) of some feet, by themselves, x and the rate of the grid [Hz]."""

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        return r.changed(wrench={f: change(v, x, r.rate) if f in feet else v for f, v in r.wrench.items()}), w

    return apply
