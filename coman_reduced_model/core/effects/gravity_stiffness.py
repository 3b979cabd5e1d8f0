# SPDX-License-Identifier: BSD-3-Clause
"""Gravity changes the stiffness: the Jacobian turns as the leg deflects under the robot's weight."""

from __future__ import annotations

from typing import ClassVar

from .base import Effect


class GravityStiffness(Effect):
    """Adds the curvature of the potential energy m g z(q) to the joint stiffness.

    The energy of the loaded leg is 1/2 dq^T K_q dq + m g z(q); its second derivative is K_q + m g H_z with
    H_z the Hessian of the COM height (n, n). This is the term that equation (11) leaves out (the conservative
    congruence transformation of Chen and Kao, 2000). Horizontally it softens by about m g / z_c, the toppling of
    an inverted pendulum. Without it gravity acts as in the posture in which the springs are not deflected. The models
    do it themselves (`Springs.gravity_stiffness`, `stiffness.add_gravity_stiffness`).
    """

    name: ClassVar[str] = "gravity_stiffness"
