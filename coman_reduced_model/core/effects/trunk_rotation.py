# SPDX-License-Identifier: BSD-3-Clause
"""The trunk turns: its pitch and roll are states with inertia, held by the angular blocks of K_c and D_c."""

from __future__ import annotations

from typing import ClassVar

from ..parameter import Parameter
from .base import Effect


class TrunkRotation(Effect):
    """Replaces the point mass by the trunk on its legs with all six freedoms (`core/trunk_model.py`).

    In double support both legs act, each in proportion to its load until it carries `full_share` of the weight: a foot
    that has just landed stands on an edge and holds little.
    """

    name: ClassVar[str] = "trunk_rotation"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "full_share", "float", 0.5, "1", "share of the weight from which a leg's springs count fully", 0.01, 1.0
        ),
    )
