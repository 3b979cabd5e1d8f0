# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead without a model of the springs, from what is known now: what a model is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, nan

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array
from ..model.reference import Plan, look

BASELINES = ("planned", "deflected", "persistence", "still", "lipm")


def best_baseline(errors: Mapping[str, float | None]) -> tuple[float, str]:
    """The least error by BASELINES, and whose it is; NaN and nothing where none is known."""
    known = [(error, name) for name in BASELINES if (error := errors.get(name)) is not None and isfinite(error)]
    return min(known, default=(nan, ""))


@compiled
def predict_baselines(
    out: Array, com: Array, com_vel: Array, zmp: Array, gravity: float, horizons: Array, reference: Array,
    reference_vel: Array, plan: Plan,
) -> None:  # fmt: skip
    """Fill in predictions (5, k, 3) [m] in the support sole, by BASELINES.

    planned: where the reference will be, by its preview or else at its velocity: a rigid robot. deflected: the same,
    as far from it as now. persistence: p + p' h. still: p. lipm: from this state about the measured ZMP, its height
    constant.

    Args:
        out: filled in.
        com, com_vel: (3,) measured or estimated [m], [m/s].
        zmp: (3,) measured [m]; NaN where not known.
        gravity: [m/s^2].
        horizons: (k,) [s].
        reference, reference_vel: (3,) COM of the rigid robot now; NaN if there is none.
        plan: from `reference.plan_ahead`.
    """
    omega = np.sqrt(gravity / max(com[2], 0.05))
    moved, faster = np.empty(3), np.empty(3)
    for h in range(horizons.shape[0]):
        look(*plan, reference_vel, horizons[h], moved, faster)
        c, s = np.cosh(omega * horizons[h]), np.sinh(omega * horizons[h])
        for i in range(3):
            out[0, h, i] = reference[i] + moved[i]
            out[1, h, i] = com[i] + moved[i]
            out[2, h, i] = com[i] + com_vel[i] * horizons[h]
            out[3, h, i] = com[i]
            out[4, h, i] = zmp[i] + (com[i] - zmp[i]) * c + com_vel[i] / omega * s
        out[4, h, 2] = com[2] + 0.0 * zmp[0]
