# SPDX-License-Identifier: BSD-3-Clause
"""Where the reference comes from: motor-side kinematics or the planned COM, told in the frame of a sole."""

from __future__ import annotations

import numpy as np

from .robot import Posture
from .types import Array, Foot, Reference, Sample


def planned_com(reference: Reference, foot: Foot) -> tuple[Array, Array]:
    """Planned COM position and velocity (3,), (3,) in the frame of the planned sole of a foot [m], [m/s].

    The planned sole is used, not the measured one, so that a drift of the odometry does not become a deflection.
    """
    T = reference.T_odom_left if foot == Foot.LEFT else reference.T_odom_right
    return (reference.com - T[:3, 3]) @ T[:3, :3], reference.com_vel @ T[:3, :3]


def preview(sample: Sample, foot: Foot, reference_vel: Array, times: Array) -> tuple[Array, Array]:
    """How the reference goes on: displacement (k, 3) [m] and change of velocity (k, 3) [m/s] at times ahead (k,) [s].

    From the preview of `com/reference` if the sample has one, in the axes of the planned sole; it is held beyond its
    end. Without one the reference is taken to go on at its present velocity.
    """
    plan = sample.reference
    if plan is None or len(plan.preview_com) == 0 or not plan.preview_dt > 0.0:
        return times[:, None] * reference_vel, np.zeros((len(times), 3))
    R = (plan.T_odom_left if foot == Foot.LEFT else plan.T_odom_right)[:3, :3]
    com = np.vstack((plan.com, plan.preview_com))
    vel = np.vstack((plan.com_vel, plan.preview_com_vel))
    position = np.minimum(times / plan.preview_dt, len(com) - 1.0)
    index = np.minimum(position.astype(np.intp), len(com) - 2)
    w = (position - index)[:, None]
    moved = (1.0 - w) * com[index] + w * com[index + 1] - plan.com
    faster = (1.0 - w) * vel[index] + w * vel[index + 1] - plan.com_vel
    return moved @ R, faster @ R


def motor_com(motor: Posture, foot: Foot) -> tuple[Array, Array]:
    """COM position and velocity (3,), (3,) by the motor-side joints, the sole of the foot flat: (A1) of the paper."""
    return motor.com_in_sole(foot)
