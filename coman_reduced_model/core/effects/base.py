# SPDX-License-Identifier: BSD-3-Clause
"""What an effect is: a name, parameters, a place, and the terms that it adds to the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...errors import ConfigError
from ..base.parameter import Parameter
from ..base.types import Foot
from .ambiguity import Ambiguity
from .unknown import About, Change, Unknown

if TYPE_CHECKING:
    from ..base.types import Array, Sample, SupportState
    from ..robot.robot import Robot
    from .hooks import LegSprings, Now, Push

PLACES = {
    "robot": ("",),
    "axis": ("x", "y", "z"),
    "side": ("left", "right"),
    "foot": ("left", "right", ""),  # "": both
}


class Effect:
    """A piece of physics, or a fault of a sensor, that the paper's model lacks.

    A subclass overrides the hooks it needs; the others do nothing. One instance acts at one place. With nominal
    parameters it changes nothing.

    Attributes:
        name: the word for it in configurations and results.
        parameters: nominal, bounds, unit, description of each.
        place: what `where` may name: a key of `PLACES`; "joint": a leg's joint, all of one leg ("left", "right")
            or all (""); or "link": the joint that moves the link, "" for the trunk.
        sentence: what is wrong, of `{at}` (the place), parameters with their intervals (`{key}`, `{key_size}` without
            sign) or all of them (`{listed}`).
        opposite: the same where the first parameter is not above nominal; "": no other sentence.
        further: what follows where parameters are known that the sentence does not name (`{key}`, `{rest}`: all).
        experiment: what would decide between the effect and those that look like it.
        absent: whether that is another walk, in which the effect is not there; else it measures the parameters.
        ambiguity: the class of effects that walking hardly distinguishes from it.
        exact: whether real robots have it in the form that it has here; else a small part of it stays unexplained.
        clock: whether it shifts a stream in time: such effects look alike until they are compared closely.
        law: the joint's residual that it bends ("spring", "torque"), and what that is drawn against.
        together: keys of parameters that may be fitted together; (): all, and each alone.
        feet: the legs that `where` names or that its joints belong to.
        joints: the leg joints that `where` names, as indices in `Robot.joint_names`.
        leg_joints: the same by leg, as indices in the leg.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    place: ClassVar[str] = "robot"
    sentence: ClassVar[str]
    opposite: ClassVar[str] = ""
    further: ClassVar[str] = ""
    experiment: ClassVar[str]
    absent: ClassVar[bool] = False
    ambiguity: ClassVar[Ambiguity | None] = None
    exact: ClassVar[bool]
    clock: ClassVar[bool] = False
    law: ClassVar[tuple[str, str] | None] = None
    together: ClassVar[tuple[tuple[str, ...], ...]] = ()

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        self.where = where
        self.values = dict(values)

    @classmethod
    def check_place(cls, where: str, source: str) -> None:
        """Refuse a place that makes no sense for this effect; joint names are checked against the robot later.

        Raises:
            ConfigError: says what is allowed.
        """
        allowed = PLACES.get(cls.place)
        if allowed is not None and where not in allowed:
            raise ConfigError(f"{source}: {where!r} is not allowed (allowed: {', '.join(map(repr, allowed))})")

    def bind(self, robot: Robot) -> None:
        """Find what `where` names in the robot.

        Raises:
            ConfigError: the legs have no such joint.
        """
        sides = {"left": (Foot.LEFT,), "right": (Foot.RIGHT,)}.get(self.where, (Foot.LEFT, Foot.RIGHT))
        whole = self.place != "joint" or self.where in ("", "left", "right")
        names = {foot: [robot.joint_names[i] for i in robot.legs[foot]] for foot in sides}
        self.leg_joints: dict[Foot, Array] = {
            foot: np.array([i for i, name in enumerate(legs) if whole or name == self.where], dtype=np.intp)
            for foot, legs in names.items()
        }
        self.feet = tuple(foot for foot, found in self.leg_joints.items() if len(found))
        if not self.feet:
            every = ", ".join(name for legs in names.values() for name in legs)
            raise ConfigError(
                f"effects.{self.name}.where: no leg joint {self.where!r} (allowed: '', 'left', 'right', {every})"
            )
        self.joints = np.concatenate([robot.legs[foot][self.leg_joints[foot]] for foot in self.feet])

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        """What a diagnosis could find of it in a recording, each parameter at each place; none: it does not look."""
        return []

    @classmethod
    def unknown(cls, key: str, change: Change, where: str = "", **more: Any) -> Unknown:
        """One parameter at one place, its unit and nominal value as in `parameters`.

        Args:
            key, change, where, more: fields of `Unknown`.
        """
        parameter = next(each for each in cls.parameters if each.name == key)
        fields = {"unit": parameter.unit, "nominal": parameter.nominal, **more}
        return Unknown(cls.name, where, key, change=change, **fields)

    @classmethod
    def moves_com(cls) -> bool:
        """Whether it is physics that the predicted COM depends on, not what sensors or motors report."""
        return any(getattr(cls, hook) is not getattr(Effect, hook) for hook in ("load", "slide", "springs", "push"))

    def reset(self) -> None:
        """Forget the past: the next sample is the first one."""

    def begin(self, stamp_ns: int, support: SupportState) -> None:
        """Take the stamp and the support state of a sample, before any hook but `correct` is called for it."""

    def late(self, stream: str) -> float:
        """By how much the stamps of an input stream (`core/streams/stream.py`) are later than the truth [s]."""
        return 0.0

    def correct(self, sample: Sample) -> None:
        """Make of a sample what was really so, in place: what a sensor at fault says, what motors make of commands."""

    def load(self, robot: Robot) -> None:
        """Change the inertias in `robot.model` (a copy for this robot), in place."""

    def wrenches(self, sample: Sample) -> list[Array]:
        """The wrenches (6,) of a sample at the feet of this effect that are there, to be changed in place."""
        sides = {Foot.LEFT: sample.left_wrench, Foot.RIGHT: sample.right_wrench}
        return [wrench for foot in self.feet if (wrench := sides[foot]) is not None]

    def slide(self) -> float:
        """How far the support foot has slid along its x axis since the last sample [m]."""
        return 0.0

    def springs(self, leg: LegSprings) -> None:
        """Change the joint-space springs of a leg, in place."""

    def push(self, push: Push, now: Now) -> None:
        """Add to the force and moment that act on the robot besides gravity and springs, in place."""


@dataclass(frozen=True)
class EffectConfig:
    """One effect at one place, with the values of its parameters."""

    name: str
    where: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
