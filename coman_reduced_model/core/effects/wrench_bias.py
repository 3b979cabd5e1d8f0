# SPDX-License-Identifier: BSD-3-Clause
"""A foot sensor whose zero is off."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..base.parameter import Parameter
from .base import Effect
from .unknown import FEET, About, Change, Unknown, wrenches_changed

if TYPE_CHECKING:
    from ..base.types import Sample

_FORCES, _MOMENTS = ("fx", "fy", "fz"), ("tx", "ty", "tz")


class WrenchBias(Effect):
    """The sensor reads truth + bias, expressed about the sole and in its axes, which is taken off again."""

    name: ClassVar[str] = "wrench_bias"
    place: ClassVar[str] = "foot"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(Parameter(f, "float", 0.0, "N", f"force {f[1]} of the sole, too much", -500.0, 500.0) for f in _FORCES),
        *(Parameter(t, "float", 0.0, "Nm", f"moment {t[1]} of the sole, too much", -100.0, 100.0) for t in _MOMENTS),
    )
    sentence: ClassVar[str] = "the force sensor of {at} has an offset, along the axes of its sole ({listed})"
    experiment: ClassVar[str] = "the robot lifted off the ground: the sensors must read the weight of the feet alone"
    exact: ClassVar[bool] = True

    def __init__(self, where: str, values: Mapping[str, float]) -> None:
        super().__init__(where, values)
        self._bias = np.array([values[key] for key in (*_FORCES, *_MOMENTS)])

    def correct(self, sample: Sample) -> None:
        for wrench in self.wrenches(sample):
            wrench -= self._bias

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        out = []
        for where in ("left", "right"):
            for k, key in enumerate((*_FORCES, *_MOMENTS)):
                prior = about.widths("wrench_bias.force" if k < 3 else "wrench_bias.moment", "reach")
                out.append(cls.unknown(key, wrench_minus(where, k), where, **prior))
        return out


def wrench_minus(where: str, k: int) -> Change:
    """Takes an error off the k-th value of a foot's wrenches."""
    unit = np.eye(6)[k]
    return wrenches_changed(FEET[where], lambda wrench, x, _: wrench - x * unit)
