# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead, from the estimated or measured state."""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled, inverse, pick
from ..base.types import Array, Integers
from .integrator import advance_into, select, transition
from .reference import look

_STEP = 0.02  # [s] longest step of a prediction; the steps are exact, this only samples the reference


@compiled
def predict_horizons(
    com: Array, com_vel: Array, horizons: Array, M: Array, K: Array, D: Array, axes: Integers, force: Array,
    reference: Array, reference_vel: Array, plan: Array, plan_vel: Array, plan_dt: float,
) -> Array:  # fmt: skip
    """COM at each horizon ahead of a state, posture and phase staying as they are.

    Args:
        com, com_vel: (3,) estimated or measured [m], [m/s] in the support sole.
        horizons: (k,) ascending [s], at least one.
        M, K, D, axes, force: `model.Terms` now.
        reference, reference_vel: (3,) now; NaN without a reference (LIPM): what is not integrated stays.
        plan, plan_vel, plan_dt: from `reference.plan_ahead`.

    Returns:
        (k, 3) [m] in the support sole.
    """
    out = np.empty((horizons.shape[0], 3))
    n = axes.shape[0]
    M_inv, K_n, D_n = inverse(select(M, axes)), select(K, axes), select(D, axes)
    z = np.empty(2 * n)
    for i in range(n):
        z[i], z[n + i] = com[axes[i]], com_vel[axes[i]]
    free = np.isnan(reference[0])
    velocity = np.zeros(3) if free else reference_vel
    u, u_end = pick(force, axes), np.empty(n)
    z_end, moved, faster = np.empty(2 * n), np.empty(3), np.empty(3)  # once: making arrays is what takes the time here
    start, last_dt = 0.0, -1.0
    # Without a plan the reference moves linearly and any step is exact; equal ones share their transition.
    longest = _STEP if plan.shape[0] > 1 else horizons[0]
    for h in range(horizons.shape[0]):
        steps = max(1, int(np.ceil((horizons[h] - start) / longest - 1e-9)))
        dt = (horizons[h] - start) / steps
        if abs(dt - last_dt) > 1e-12:
            E, G_0, G_1 = transition(M_inv, K_n, D_n, dt)
            last_dt = dt
        for k in range(steps):
            look(plan, plan_vel, plan_dt, velocity, start + (k + 1) * dt, moved, faster)
            for i in range(n):
                u_end[i] = force[axes[i]]
                for j in range(3):
                    u_end[i] += K[axes[i], j] * moved[j] + D[axes[i], j] * faster[j]
            advance_into(z_end, z, E, G_0, G_1, u, u_end)
            z, z_end, u, u_end = z_end, z, u_end, u
        for i in range(3):
            out[h, i] = com[i] if free else reference[i] + moved[i]
        for i in range(n):
            out[h, axes[i]] = z[i]
        start = horizons[h]
    return out


@compiled
def drop_impossible(ahead: Array, com: Array, com_vel: Array, horizons: Array, gravity: float, diverged: float) -> bool:
    """Write NaN over predictions that no robot on its feet gets to; whether any was the model's.

    It accelerates by less than gravity, so that in a time h it gets no farther than |p'| h + g h^2 / 2.

    Args:
        ahead: (n, k, 3) predictions [m] in the support sole, the model's first, changed in place.
        com, com_vel: (3,) measured [m], [m/s].
        horizons: (k,) [s].
        gravity: [m/s^2].
        diverged: [m] by which a prediction may be off on top of that.
    """
    found = False
    for h in range(horizons.shape[0]):
        t = horizons[h]
        limit = diverged + np.sqrt(com_vel.dot(com_vel)) * t + 0.5 * gravity * t * t
        for n in range(ahead.shape[0]):
            for i in range(3):
                if not abs(ahead[n, h, i] - com[i]) < limit:  # an axis each: a sum of squares could overflow
                    ahead[n, h] = np.nan
                    found = found or n == 0
                    break
    return found
