# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead without a model of the springs: what a model is compared with."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array


@compiled
def predict_baselines(com: Array, com_vel: Array, zmp: Array, gravity: float, horizons: Array) -> Array:
    """Persistence p + p' h and the LIPM from the measured state with the measured ZMP, (2, k, 3) [m].

    Height is constant in the LIPM. A ZMP of NaN gives a LIPM of NaN.
    """
    out = np.empty((2, horizons.shape[0], 3))
    persistence, lipm = out[0], out[1]
    omega = np.sqrt(gravity / max(com[2], 0.05))
    for h in range(horizons.shape[0]):
        c, s = np.cosh(omega * horizons[h]), np.sinh(omega * horizons[h])
        for i in range(3):
            persistence[h, i] = com[i] + com_vel[i] * horizons[h]
            lipm[h, i] = zmp[i] + (com[i] - zmp[i]) * c + com_vel[i] / omega * s
        lipm[h, 2] = com[2] + 0.0 * zmp[0]
    return out
