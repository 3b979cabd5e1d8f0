# SPDX-License-Identifier: BSD-3-Clause
"""Where the reference comes from: motor-side kinematics or the planned COM, told in the frame of a sole."""

from __future__ import annotations

import numpy as np
from numba import njit

from .robot import Posture
from .types import Array, Foot, Reference, Sample

_NOTHING = np.empty((0, 3))


def planned_com(reference: Reference, foot: Foot) -> tuple[Array, Array]:
    """Planned COM position and velocity (3,), (3,) in the frame of the planned sole of a foot [m], [m/s].

    The planned sole is used, not the measured one, so that a drift of the odometry does not become a deflection.
    """
    T = reference.T_odom_left if foot == Foot.LEFT else reference.T_odom_right
    return (reference.com - T[:3, 3]) @ T[:3, :3], reference.com_vel @ T[:3, :3]


def plan_ahead(sample: Sample, foot: Foot) -> tuple[Array, Array, float]:
    """The preview of `com/reference` relative to its present point, in the axes of the planned sole of the foot.

    Returns:
        Displacement (n, 3) [m] and change of velocity (n, 3) [m/s], the first row zero, and their spacing [s];
        n is 0 if there is no preview.
    """
    plan = sample.reference
    if plan is None or len(plan.preview_com) == 0 or not plan.preview_dt > 0.0:
        return _NOTHING, _NOTHING, 0.0
    R = (plan.T_odom_left if foot == Foot.LEFT else plan.T_odom_right)[:3, :3]
    moved = np.zeros((len(plan.preview_com) + 1, 3))
    faster = np.zeros_like(moved)
    np.subtract(plan.preview_com, plan.com, out=moved[1:])
    np.subtract(plan.preview_com_vel, plan.com_vel, out=faster[1:])
    return moved @ R, faster @ R, plan.preview_dt


@njit(cache=True)
def look_ahead(
    plan: Array, plan_vel: Array, plan_dt: float, reference_vel: Array, start: float, end: float, steps: int
) -> tuple[Array, Array]:
    """How the reference goes on at equal steps from start to end [s] ahead.

    With a plan (n, 3) from `plan_ahead` linearly between its points, held beyond its end; without one (n = 0) at its
    present velocity `reference_vel` (3,).

    Returns:
        Displacement (steps + 1, 3) [m] and change of velocity (steps + 1, 3) [m/s] since now.
    """
    moved, faster = np.zeros((steps + 1, 3)), np.zeros((steps + 1, 3))
    for k in range(steps + 1):
        t = start + (end - start) * k / steps
        if plan.shape[0] < 2:
            moved[k] = t * reference_vel
            continue
        position = min(t / plan_dt, plan.shape[0] - 1.0)
        i = min(int(position), plan.shape[0] - 2)
        w = position - i
        moved[k] = (1.0 - w) * plan[i] + w * plan[i + 1]
        faster[k] = (1.0 - w) * plan_vel[i] + w * plan_vel[i + 1]
    return moved, faster


def motor_com(motor: Posture, foot: Foot) -> tuple[Array, Array]:
    """COM position and velocity (3,), (3,) by the motor-side joints, the sole of the foot flat: (A1) of the paper."""
    return motor.com_in_sole(foot)
