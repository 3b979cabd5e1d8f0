# SPDX-License-Identifier: BSD-3-Clause
"""How sure predictions ahead are: by their errors in the last seconds, and before there are any, by the estimate.

What the estimate knows, h seconds ahead at constant velocity, is the least that can be said of an error before one has
been seen. It counts as a little (`GIVEN`) of an experience, and is forgotten as that is. How far the external force
wanders does not enter: it says how a sole rolls, and no prediction ahead rests on that force.
"""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array
from .blend import GIVEN, KNOWN, Experience

Experiences = tuple[Experience, Experience, Experience]
Spread = tuple[Array, Array]  # (6, 6) covariance of COM and velocity, and (3, 3) what is constant in it [m^2]
UNKNOWN: Spread = np.full((6, 6), np.nan), np.zeros((3, 3))


@compiled
def carry(spread: Spread, seconds: float, out: Array) -> None:
    """Fill in the covariance (3, 3) [m^2] of the COM some seconds ahead; NaN without an estimate.

    What is constant, masses and zeros of encoders, is left out: it is the same in the measured COM that comes.
    """
    P, constants = spread
    for i in range(3):
        for j in range(3):
            both = P[i, 3 + j] + P[3 + i, j]
            out[i, j] = P[i, j] - constants[i, j] + seconds * (both + seconds * P[3 + i, 3 + j])


@compiled
def covariance_ahead(experiences: Experiences, h: int, out: Array) -> None:
    """Fill in that (3, 3) [m^2] of what is published at a horizon, whatever the model did.

    out: what `carry` says, changed in place; where that is NaN, it stays so as long as too little is known.
    """
    known = 0.0
    for each in experiences:
        known += each.known[h]
    given = GIVEN * max(1.0 - known, 0.0)
    if not np.isfinite(out[0, 0] + out[1, 1] + out[2, 2]):
        out[:] = 0.0 if known > KNOWN else np.nan
        given = 0.0
    for i in range(3):
        for j in range(3):
            errors = given * out[i, j]
            for each in experiences:
                errors += each.errors[h, i, j]
            out[i, j] = errors / (known + given)
