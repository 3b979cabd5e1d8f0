# SPDX-License-Identifier: BSD-3-Clause
"""What effects that scale something by a parameter `scale` have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .unknown import About, Unknown, world_elements

if TYPE_CHECKING:
    from .base import Effect


def scaled_joints(effect: type[Effect], about: About, field: str) -> list[Unknown]:
    """The scale of a field of the world: at each joint, at those of a leg together, at all.

    Args:
        effect: that scales it.
        about: the recording.
        field: of `World`, one value a joint.
    """
    out, low = [], float(np.log(max(effect.parameters[0].low, 0.05)))
    for where, which in about.joints_and_legs.items() if about.motors else ():
        change = world_elements(field, which, lambda each, x: each * np.exp(x))
        spread = f"{effect.name}.{'scale' if where in about.joints else 'together'}.spread"
        prior = about.widths(f"{effect.name}.scale", "reach", spread=spread)
        out.append(effect.unknown("scale", change, where, low=low, logarithmic=True, **prior))
    return out
