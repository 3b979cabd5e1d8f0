# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of a gait, and the named gaits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from ...errors import ConfigError
from ..base.parameter import par


@dataclass(frozen=True)
class GaitParameters:
    """One gait. Each field carries its `Parameter` (unit, bounds, description) in its metadata.

    Raises:
        ConfigError: a value is of the wrong type or out of its range.
    """

    step_length_m: float = par(0.03, "m", "the swing sole lands so far ahead of the stance sole", -1.0, 1.0)
    step_width_m: float = par(0.1452, "m", "distance of the sole origins in y", 0.02, 1.0)
    step_height_m: float = par(0.03, "m", "height of the sole in mid-swing", 0.0, 0.5)
    single_support_s: float = par(0.5, "s", "duration of a swing", 0.05, 60.0)
    double_support_s: float = par(0.2, "s", "duration of a load transfer, the first and the last included", 0.02, 60.0)
    com_height_m: float = par(0.38, "m", "height of the COM above the soles, constant", 0.05, 3.0)
    steps: int = par(14, "", "number of steps; the last brings the feet together; 0 stands", 0, 10_000)
    turn_rad: float = par(0.0, "rad", "yaw of a step, positive to the left", -0.5, 0.5)
    lateral_m: float = par(0.0, "m", "mean sideways advance of a step, positive to the left", -0.5, 0.5)
    variation: float = par(
        0.0, "1", "length, turn and sideways advance of a step vary by this share, over 8 steps", 0.0, 3.0
    )
    stand_before_s: float = par(1.0, "s", "standing before the first load transfer", 0.1, 1e6)
    stand_after_s: float = par(1.0, "s", "standing after the last load transfer", 0.1, 1e6)
    zmp_offset_x_m: float = par(0.0, "m", "ZMP ahead of the sole origin", -0.5, 0.5)
    zmp_offset_y_m: float = par(0.0, "m", "ZMP inwards of the sole origin while on one leg", -0.5, 0.5)
    gravity: float = par(9.81, "m/s^2", "acceleration of gravity", 0.1, 100.0)
    first_swing: str = par("left", "", "foot that steps first", choices=("left", "right"))

    def __post_init__(self) -> None:
        for f in fields(self):
            parameter = replace(f.metadata["parameter"], name=f.name)
            object.__setattr__(self, f.name, parameter.check(getattr(self, f.name), "gait"))

    @property
    def omega(self) -> float:
        """Natural frequency of the pendulum sqrt(g / z_c) [rad/s]."""
        return math.sqrt(self.gravity / self.com_height_m)


GAITS: Mapping[str, GaitParameters] = {
    "test1": GaitParameters(),  # the two validation gaits of the paper
    "test2": GaitParameters(step_length_m=0.06, single_support_s=0.6),
    "stand": GaitParameters(steps=0, stand_before_s=5.0, stand_after_s=5.0),
    "in_place": GaitParameters(step_length_m=0.0),
    "backwards": GaitParameters(step_length_m=-0.03),
    "turn": GaitParameters(step_length_m=0.02, turn_rad=0.1),
    "sideways": GaitParameters(step_length_m=0.0, lateral_m=0.015),
    "wide": GaitParameters(step_width_m=0.18),
    "changing": GaitParameters(turn_rad=0.05, variation=1.2),
}


def gait(name: str, **overrides: Any) -> GaitParameters:
    """A gait by its name in `GAITS`, with some parameters changed.

    Raises:
        ConfigError: the gait or a parameter does not exist, or a value is not allowed.
    """
    if name not in GAITS:
        raise ConfigError(f"gait: {name!r} is not allowed (allowed: {', '.join(GAITS)})")
    names = [f.name for f in fields(GaitParameters)]
    if unknown := set(overrides).difference(names):
        raise ConfigError(f"gait: {min(unknown)}: unknown key (allowed: {', '.join(names)})")
    return replace(GAITS[name], **overrides)
