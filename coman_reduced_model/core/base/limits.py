# SPDX-License-Identifier: BSD-3-Clause
"""From where on a free run is beyond physics: it has diverged."""

from __future__ import annotations

import numpy as np

from .compiled import compiled
from .types import Array

DIVERGED = 0.5  # [m] from the measured COM
TOPPLED = 1.0  # [rad] that the trunk leans more or less than the measured one


@compiled
def is_near(state: Array, tilt: Array, com: Array, measured_tilt: Array, limits: tuple[float, float]) -> bool:
    """Whether a free run is where the robot can be.

    Args:
        state: (6,) its COM and velocity [m], [m/s].
        tilt: (2,) of its trunk [rad].
        com, measured_tilt: (3,), (2,) measured.
        limits: of the distance to the measured COM [m] and of each tilt [rad]; infinite: any tilt, or none.
    """
    far, aslant = 0.0, False
    for i in range(3):
        far += (state[i] - com[i]) ** 2  # infinite or NaN: not near
    for i in range(2):
        aslant |= not abs(tilt[i] - measured_tilt[i]) < limits[1]
    return far < limits[0] ** 2 and not (aslant and limits[1] < np.inf) and np.isfinite(state[3] + state[4] + state[5])
