# SPDX-License-Identifier: BSD-3-Clause
"""Where the reference comes from: motor-side kinematics or the planned COM, expressed in the frame of a sole."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Booleans, Foot, Reference, Sample
from ..robot.robot import Posture

Plan = tuple[Array, Array, float]  # what `plan_ahead` returns
_NOTHING = np.empty((0, 3))


def planned_com(reference: Reference, foot: Foot) -> tuple[Array, Array]:
    """Planned COM position and velocity (3,), (3,) in the frame of the planned sole of a foot [m], [m/s].

    The planned sole is used, not the measured one, so that a drift of the odometry does not become a deflection.
    """
    T = reference.sole_pose(foot)
    return (reference.com - T[:3, 3]) @ T[:3, :3], reference.com_vel @ T[:3, :3]


def plan_ahead(sample: Sample, foot: Foot) -> Plan:
    """The preview of `com/reference` relative to its present point, in the axes of the planned sole of the foot.

    Returns:
        Displacement (n, 3) [m] and change of velocity (n, 3) [m/s], the first row zero, and their spacing [s];
        n is 0 if there is no preview.
    """
    plan = sample.reference
    if plan is None or len(plan.preview_com) == 0 or not plan.preview_dt > 0.0:
        return _NOTHING, _NOTHING, 0.0
    out = np.zeros((2, len(plan.preview_com) + 1, 3))
    _change(plan.preview_com, plan.com, plan.preview_com_vel, plan.com_vel, plan.sole_pose(foot), out)
    return out[0], out[1], plan.preview_dt


@compiled
def _change(preview: Array, now: Array, preview_vel: Array, now_vel: Array, T: Array, out: Array) -> None:
    """Add previews (n, 3) minus what is now (3,), in the axes of T (4, 4), to out (2, n + 1, 3) after first rows."""
    for k in range(preview.shape[0]):
        for i in range(3):
            for j in range(3):
                out[0, k + 1, i] += (preview[k, j] - now[j]) * T[j, i]
                out[1, k + 1, i] += (preview_vel[k, j] - now_vel[j]) * T[j, i]


@compiled
def look(
    plan: Array, plan_vel: Array, plan_dt: float, reference_vel: Array, t: float, moved: Array, faster: Array
) -> None:
    """Fill in how far the reference moves in t [s] from now, (3,) [m], and how much faster it gets, (3,) [m/s].

    With a plan (n, 3) from `plan_ahead` linearly between its points; beyond its end, or without one (n = 0), at the
    last velocity; `reference_vel` (3,) is the present one.
    """
    end = plan.shape[0] - 1
    position = t / plan_dt if end > 0 else 0.0
    i = min(int(position), end - 1)
    w = position - i
    for axis in range(3):
        if end < 1:
            moved[axis] = t * reference_vel[axis]
            faster[axis] = 0.0
        elif position < end:
            moved[axis] = (1.0 - w) * plan[i, axis] + w * plan[i + 1, axis]
            faster[axis] = (1.0 - w) * plan_vel[i, axis] + w * plan_vel[i + 1, axis]
        else:
            faster[axis] = plan_vel[end, axis]
            moved[axis] = plan[end, axis] + (t - end * plan_dt) * (reference_vel[axis] + faster[axis])


@compiled
def faded(
    com: Array, reference: Array, reference_vel: Array, plan: Plan, horizons: Array, fading: float, felt: Booleans
) -> Array:
    """COM (k, 3) [m] at horizons (k,) [s] as planned, while its horizontal deflection fades; the sag stays.

    Args:
        com: (3,) now [m].
        reference, reference_vel: (3,) [m], [m/s].
        plan: from `plan_ahead`.
        horizons: (k,) [s].
        fading: rate [1/s].
        felt: (3,) axes that deflect; the others follow the reference.
    """
    out, moved, faster = np.empty((horizons.shape[0], 3)), np.empty(3), np.empty(3)
    for k in range(horizons.shape[0]):
        look(*plan, reference_vel, horizons[k], moved, faster)
        for i in range(3):
            left = 0.0 if not felt[i] else 1.0 if i == 2 else np.exp(-fading * horizons[k])
            out[k, i] = reference[i] + moved[i] + left * (com[i] - reference[i])
    return out


def motor_com(motor: Posture, foot: Foot) -> tuple[Array, Array]:
    """COM position and velocity (3,), (3,) by the motor-side joints, the sole of the foot flat: (A1) of the paper."""
    return motor.com_in_sole(foot)
