# SPDX-License-Identifier: BSD-3-Clause
"""What an effect is: a name, parameters, a place, and the terms that it adds to the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

from ...errors import ConfigError
from ..parameter import Parameter

if TYPE_CHECKING:
    from ..model import LegSprings, Terms
    from ..types import Sample


class Effect:
    """A piece of physics, or a fault of a sensor, that the paper's model lacks.

    A subclass overrides the hooks it needs; the others do nothing. One instance acts at one place.

    Attributes:
        name: the word for it in configurations and results (discrepancy.md).
        parameters: nominal, bounds, unit, description of each of its figures.
        place: what `where` names: "robot" (nothing), "axis", "joint", "side" or "foot".
        needs: other effects without which it does nothing.
        axes: coordinates of the COM (0, 1, 2) that it adds to the integrated ones, x and z.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    place: ClassVar[str] = "robot"
    needs: ClassVar[tuple[str, ...]] = ()
    axes: ClassVar[tuple[int, ...]] = ()

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        self.where = where
        self.values = dict(values)

    @classmethod
    def check_place(cls, where: str, source: str) -> None:
        """Refuse a place that makes no sense for this effect; joint names are checked against the robot later.

        Raises:
            ConfigError: says what is allowed.
        """
        allowed = {"robot": ("",), "axis": ("x", "y", "z"), "side": ("left", "right"), "foot": ("left", "right")}
        if cls.place in allowed and where not in allowed[cls.place]:
            raise ConfigError(
                f"{source}: {where!r} is not allowed (allowed: {', '.join(map(repr, allowed[cls.place]))})"
            )
        if cls.place == "joint" and not where:
            raise ConfigError(f"{source}: wanted the name of a joint")

    def correct(self, sample: Sample) -> None:
        """Undo a fault of a sensor in the sample, in place."""

    def springs(self, leg: LegSprings) -> None:
        """Change the joint-space stiffness and damping of a leg, in place."""

    def terms(self, terms: Terms) -> None:
        """Change the assembled equation of motion, in place."""
