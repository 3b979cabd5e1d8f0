# SPDX-License-Identifier: BSD-3-Clause
"""The trunk turns: its pitch and roll are states with inertia, held by the angular blocks of K_c and D_c."""

from __future__ import annotations

from typing import ClassVar

from ..base.parameter import Parameter
from .base import Effect


class TrunkRotation(Effect):
    """Replaces the point mass by the trunk on its legs with all six freedoms (`core/model/trunk/model.py`).

    The ground presses on the corners of the soles (the URDF's collision boxes, or `robot.foot_length` and
    `foot_width`) and holds them by `friction` (`core/model/trunk/contact.py`); in double support on those of both.
    """

    name: ClassVar[str] = "trunk_rotation"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("friction", "float", 0.7, "1", "coefficient between soles and ground", 0.05, 2.0),
    )
