# SPDX-License-Identifier: BSD-3-Clause
"""The moving legs carry angular momentum; what changes it acts on the trunk."""

from __future__ import annotations

from typing import ClassVar

from .base import Effect


class SwingMomentum(Effect):
    """Adds the torques that the reference motion of all joints needs, by inverse dynamics, to the turning trunk.

    Without it the reference motion only has the inertia of a point mass. Acts with `trunk_rotation` alone.
    """

    name: ClassVar[str] = "swing_momentum"
    needs: ClassVar[tuple[str, ...]] = ("trunk_rotation",)
