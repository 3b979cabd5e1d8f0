# SPDX-License-Identifier: BSD-3-Clause
"""The trunk turns: its pitch and roll are states with inertia, held by the angular blocks of K_c and D_c."""

from __future__ import annotations

from typing import ClassVar

from ..parameter import Parameter
from .base import Effect


class TrunkRotation(Effect):
    """Replaces the point mass by the trunk on its legs with all six freedoms (`core/trunk_model.py`).

    In double support both act, the other one as far as its foot presses on the ground: within the edges of its sole
    (the URDF's collision boxes, or `robot.foot_length` and `foot_width`), and with `friction` holding it.
    """

    name: ClassVar[str] = "trunk_rotation"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("friction", "float", 0.7, "1", "coefficient between soles and ground", 0.05, 2.0),
    )
