# SPDX-License-Identifier: BSD-3-Clause
"""Deflection in y, which the paper neglects because only harmonic drives act there."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from .base import Effect

if TYPE_CHECKING:
    from ..model import Terms


class LateralCompliance(Effect):
    """The y row and column of K and D take part: (16), (17) in three dimensions."""

    name: ClassVar[str] = "lateral_compliance"

    def terms(self, terms: Terms) -> None:
        terms.axes = np.arange(3)
