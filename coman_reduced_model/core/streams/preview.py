# SPDX-License-Identifier: BSD-3-Clause
"""A plan that comes late, continued by its own preview."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Reference


def later(plan: Reference, late_ns: int) -> Reference:
    """The plan so much later [ns], by its own preview: messages may be late, but what they say is not about the past.

    Where the preview ends, without one, or for a plan that is yet to come, the plan as it is.
    """
    n = len(plan.preview_com)
    if late_ns <= 0 or not n or not plan.preview_dt > 0.0:
        return plan
    i, w = divmod(late_ns * 1e-9 / plan.preview_dt, 1.0)
    first = int(i)
    if first >= n:
        return plan
    com, com_vel = np.empty((n - first, 3)), np.empty((n - first, 3))
    _between(plan.com, plan.preview_com, first, w, com)
    _between(plan.com_vel, plan.preview_com_vel, first, w, com_vel)
    return Reference(
        plan.stamp_ns + late_ns,
        com[0],
        com_vel[0],
        plan.com_acc,
        plan.zmp,
        plan.T_odom_left,
        plan.T_odom_right,
        plan.phase,
        plan.step,
        plan.preview_dt,
        com[1:],
        com_vel[1:],
        plan.steps,
    )


@compiled
def _between(now: Array, preview: Array, first: int, w: float, out: Array) -> None:
    """Points (k, 3) between those of now (3,) and preview (n, 3): w of the way from the first-th on to the next."""
    for k in range(out.shape[0]):
        for i in range(3):
            before = now[i] if first + k == 0 else preview[first + k - 1, i]
            out[k, i] = (1.0 - w) * before + w * preview[first + k, i]
