# SPDX-License-Identifier: BSD-3-Clause
"""Deflection in y, which the paper neglects because only harmonic drives act there."""

from __future__ import annotations

from typing import ClassVar

from .base import Effect


class LateralCompliance(Effect):
    """The y row and column of K and D take part: (14), (15) in three dimensions."""

    name: ClassVar[str] = "lateral_compliance"
    axes: ClassVar[tuple[int, ...]] = (1,)
