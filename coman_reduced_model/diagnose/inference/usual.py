# SPDX-License-Identifier: BSD-3-Clause
"""What nominal robots leave, for a robot of a given weight: the part of `Nominal` that the evidence of a case needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ...core.base.nominal import Nominal, load_nominal
from ..data.world import World
from .floor import unit_of


@dataclass(frozen=True)
class Usual:
    """By default nothing repeats, every law is trusted, and sensors are those of the shipped population.

    Attributes:
        misfit: by law, what repeats with each stride at least [SI].
        trust: by law, the share of its information that counts; 1 without an entry.
        floor, sensors: of `Nominal`.
    """

    misfit: Mapping[str, float] = field(default_factory=dict)
    trust: Mapping[str, float] = field(default_factory=dict)
    floor: Mapping[str, float] = field(default_factory=lambda: load_nominal().floor)
    sensors: Mapping[str, float] = field(default_factory=lambda: load_nominal().sensors)

    @classmethod
    def of(cls, nominal: Nominal, world: World) -> Usual:
        """Of nominal robots as heavy as this one."""
        weight = world.robot.mass * world.gravity
        misfit = {law: value * unit_of(law, weight, world.gravity) for law, value in nominal.repeats.items()}
        return cls(misfit, nominal.trust, nominal.floor, nominal.sensors)
