# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor of the wrong sensitivity."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect

if TYPE_CHECKING:
    from ..base.types import Sample


class WrenchScale(Effect):
    """The sensor reads scale * truth, all six values alike, and is divided by it."""

    name: ClassVar[str] = "wrench_scale"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", "float", 1.0, "1", "what the sensor reads over the truth", 0.2, 5.0),
    )

    def correct(self, sample: Sample) -> None:
        for wrench in self.wrenches(sample):
            wrench /= self.values["scale"]
