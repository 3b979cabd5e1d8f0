# SPDX-License-Identifier: BSD-3-Clause
"""What is published of the states of the trunk model: COM and tilt of the free run, deflections by the filter."""

from __future__ import annotations

import numpy as np

from ...base.compiled import Held, compiled
from ...base.types import Array, Integers
from ...robot.posture import tilt

FALLEN = 0.3  # [m], [rad] by which the support sole of a free run has left the ground when the robot has fallen
# Orientation (3, 3) of the support sole and z (3,) of the trunk in the base frame; measured COM and that of the
# reference (3,) [m]; whether the support foot is the left one.
Seen = tuple[Array, Array, Array, Array, bool]


@compiled
def publish(out: Array, held: Held, states: Held, q: Array, order: Integers, seen: Seen) -> None:
    """Fill in COM and its velocity, roll and pitch of the trunk (8,), and deflections (3 + m,) as in `Dynamics`.

    COM and velocity are NaN if the free run fell over an edge of the support sole, in whose frame all this is.

    Args:
        out: (11 + m,) [m], [m/s], [rad], filled in.
        held: the terms.
        states: of the filter and of the free run.
        q: (nj,) measured joints [rad]: the measured COM is corrected by what the filter differs from them.
        order: (m,) as in `pose_legs`.
        seen: at this sample.
    """
    terms, (filtered, free), (R, up, measured, reference, left) = held.value[0], states.value[0], seen
    J, com, at, m = terms.geometry.J, terms.geometry.com, terms.linear.y, order.shape[0]
    out[6], out[7] = tilt(R, up)
    for i in range(3):
        out[i], out[3 + i], out[8 + i] = com[i], 0.0, measured[i] - reference[i]
    for j in range(m):
        for i in range(3):
            out[i] += J[i, j] * (free.y[j] - at[j])
            out[3 + i] += J[i, j] * free.w[j]
            out[8 + i] += J[i, j] * (filtered.y[j] - q[order[j]])
        for i in range(2):
            out[6 + i] += J[3 + i, j] * (free.y[j] - at[j])
        out[11 + (j if left else (j + m // 2) % m)] = filtered.y[j] - terms.theta[j]
    for i in range(m, m + 6):
        if not abs(free.y[i]) < FALLEN:
            out[:6] = np.nan
