# SPDX-License-Identifier: BSD-3-Clause
"""The catalogue of effects: what can be added to the paper's model, by name.

An effect is one file with one small class; adding it here makes it a configuration key, a ROS parameter and a
candidate of the diagnosis.
"""

from .base import Effect
from .gravity_stiffness import GravityStiffness
from .lateral_compliance import LateralCompliance
from .swing_momentum import SwingMomentum
from .trunk_rotation import TrunkRotation

CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect for effect in (GravityStiffness, TrunkRotation, SwingMomentum, LateralCompliance)
}

__all__ = ["CATALOGUE", "Effect"]
