# SPDX-License-Identifier: BSD-3-Clause
"""What a disturbance is: hooks into the physics and the sensors, places, parameters with bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...core.base.types import Array
from ...errors import ConfigError
from ..motors import MotorOptions
from ..robot_table import SIDES, RobotTable
from ..sensors import Signals
from ..spring_laws import SpringLaw


@dataclass
class Disturbance:
    """One hidden effect: a dataclass whose fields are `par`s, by the names that configuration and verdicts use.

    It overrides the hooks that it needs; the others do nothing and cost nothing. Joint arrays are in the order of
    `RobotTable.joint_names`. Several disturbances are edited in the order in which they are given.

    Raises:
        ConfigError: a parameter is of the wrong type or out of its range.
    """

    name: ClassVar[str] = ""
    catalogued: ClassVar[bool] = True  # False: no effect of the catalogue describes it

    def __post_init__(self) -> None:
        for f in fields(self):
            parameter = replace(f.metadata["parameter"], name=f.name)
            setattr(self, f.name, parameter.check(getattr(self, f.name), self.name))

    def to_dict(self) -> dict[str, Any]:
        """Name, place and parameters, as a verdict has them."""
        values = asdict(self)
        return {"name": self.name, "where": values.pop("where", ""), "parameters": values}

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """Changes the physical model before it is compiled: masses, springs, floor, more bodies."""

    def motor_loop(self, motors: MotorOptions | None) -> MotorOptions | None:
        """The motors' position loops; None: they follow exactly."""
        return motors

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Once, when the robot is set on its feet: draw random numbers, empty buffers."""

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        """What the motors make of their references.

        Args:
            t: (n,) [s] consecutive physics steps.
            theta: (n, nj) [rad] references.
            theta_rate: (n, nj) [rad/s].
        """
        return theta, theta_rate

    def spring_laws(self) -> Sequence[SpringLaw]:
        """Laws of springs that are not linear, after `start`: torque beside k deflection + d rate."""
        return ()

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Adds forces to `data.qfrc_applied` and `data.xfrc_applied`, which are zero before every physics step."""

    def bear(self, foot: int, data: mujoco.MjData) -> Array:
        """What the ground exerts on a foot (0 left, 1 right) beside the contacts: (6,) in and about its sole frame."""
        return np.zeros(6)

    def sense(self, t: float, signals: Signals) -> None:
        """Changes the true signals in place before quantisation and noise."""


class Later(Disturbance):
    """A disturbance that begins in mid-walk, such as a cable that comes loose; its own time begins then."""

    def __init__(self, effect: Disturbance, after: float) -> None:
        """Args: what begins; after how long [s].

        Raises:
            ConfigError: it is built into the robot and cannot begin.
        """
        if built := overrides([effect], "edit_model") + overrides([effect], "motor_loop"):
            raise ConfigError(f"{built[0].name}: after: it is built into the robot and cannot begin in mid-walk")
        self.effect, self.after = effect, after

    def __repr__(self) -> str:
        return f"Later({self.effect!r}, {self.after:g} s)"

    def to_dict(self) -> dict[str, Any]:
        return {**self.effect.to_dict(), "after": self.after}

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        self.effect.start(table, model, rng)

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        return self.effect.move_motors(t, theta, theta_rate) if t[0] >= self.after else (theta, theta_rate)

    def spring_laws(self) -> Sequence[SpringLaw]:
        return [replace(law, since=self.after) for law in self.effect.spring_laws()]

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if t >= self.after:
            self.effect.apply(t - self.after, model, data)

    def bear(self, foot: int, data: mujoco.MjData) -> Array:
        return self.effect.bear(foot, data)

    def sense(self, t: float, signals: Signals) -> None:
        if t >= self.after:
            self.effect.sense(t - self.after, signals)


def overrides(disturbances: Sequence[Disturbance], hook: str) -> list[Disturbance]:
    """Those that override a hook."""
    return [d for d in disturbances if getattr(type(d), hook) is not getattr(Disturbance, hook)]


def joint_indices(table: RobotTable, where: str) -> list[int]:
    """Joints of the legs that a place names: a joint (LKneeSag), a kind (KneeSag: both sides), left, right, "" for all.

    Raises:
        ConfigError: no joint has that name.
    """
    legs = [joint.name for joint in table.leg_joints()]
    side = {"left": "L", "right": "R"}.get(where)
    found = [i for i, name in enumerate(legs) if where in ("", name, name[1:]) or name[0] == side]
    if not found:
        places = ", ".join((*table.links, *legs))
        raise ConfigError(f"where = {where!r}: allowed: left, right, {places}, or nothing for all")
    return found


def feet(where: str) -> list[int]:
    """Feet that a place names: 0 left, 1 right.

    Raises:
        ConfigError: it names none.
    """
    found = {"left": [0], "right": [1], "": [0, 1]}.get(where)
    if found is None:
        raise ConfigError(f"where = {where!r}: allowed: left, right, or nothing for both")
    return found


def foot_body(foot: int) -> str:
    """Name of the body of a foot."""
    return f"{SIDES[foot][1]}foot"


class TooHeavyError(ConfigError):
    """A load is as heavy as the body that it is taken from."""


def take_mass(body: mujoco.MjsBody, mass: float, position: ArrayLike) -> None:
    """Takes a point mass [kg] at a position [m] out of a body, so that a new body there changes no static figure.

    Raises:
        TooHeavyError: the body has not that much.
    """
    if mass >= 0.9 * body.mass:
        raise TooHeavyError(f"{body.name}: {mass:g} kg of its {body.mass:g} kg: allowed: below {0.9 * body.mass:g} kg")
    body.ipos = (body.mass * body.ipos - mass * np.asarray(position)) / (body.mass - mass)
    body.mass -= mass
