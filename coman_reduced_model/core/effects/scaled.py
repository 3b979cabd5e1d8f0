# SPDX-License-Identifier: BSD-3-Clause
"""What effects that scale something by a parameter `scale` have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .unknown import About, Unknown, world_elements
from .widths import widths

if TYPE_CHECKING:
    from .base import Effect


def scaled_joints(effect: type[Effect], about: About, field: str, low: float) -> list[Unknown]:
    """The scale of a field of the world: at each joint, at those of a leg together, at all.

    Args:
        effect: that scales it.
        about: the recording.
        field: of `World`, one value a joint.
        low: least deviation from nominal [1].
    """
    out = []
    for where, which in about.joints_and_legs.items() if about.motors else ():
        change = world_elements(field, which, lambda each, x: each * (1.0 + x))
        nominal = "spread" if where in about.joints else "slack"  # of one joint, of many alike
        out.append(effect.unknown("scale", change, where, low=low, **widths(f"{effect.name}.scale", nominal, "reach")))
    return out
