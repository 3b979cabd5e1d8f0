# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor of the wrong sensitivity."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect
from .unknown import FEET, About, Unknown, wrenches_changed

if TYPE_CHECKING:
    from ..base.types import Sample


class WrenchScale(Effect):
    """The sensor reads scale * truth, all six values alike, and is divided by it."""

    name: ClassVar[str] = "wrench_scale"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", "float", 1.0, "1", "what the sensor reads over the truth", 0.2, 5.0),
    )
    sentence: ClassVar[str] = "the force sensor of {at} reads {scale} of the truth"
    experiment: ClassVar[str] = "standing on each foot alone on a scale"
    exact: ClassVar[bool] = True

    def correct(self, sample: Sample) -> None:
        for wrench in self.wrenches(sample):
            wrench /= self.values["scale"]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        both = about.widths("wrench_scale.scale", "reach", spread="wrench_scale.together.spread")
        one = about.widths("wrench_scale.scale", "spread", "reach")
        out = []
        for where, feet in FEET.items():
            less = wrenches_changed(feet, lambda wrench, x, _: wrench / (1.0 + x))
            out.append(cls.unknown("scale", less, where, **(one if where else both)))
        return out
