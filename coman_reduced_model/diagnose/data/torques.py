# SPDX-License-Identifier: BSD-3-Clause
"""Torques that a driver computes from the deflection of the springs: their noise is that of the link encoders."""

from __future__ import annotations

from math import comb

import numpy as np

from ...core.base.types import Array

ALIKE = 0.6  # correlation of the fast parts of torques and deflections, from which they are the same measurement
ROUNDED = 2.0  # counts of the link encoder: fast changes of a deflection that are no larger are rounding
WITH_MOTORS, ALONE = 2, 4  # differences: without motors, more of them, as the joint moves more than its spring


def from_deflection(tau: Array | None, motor_q: Array | None, q: Array | None, counts: Array) -> bool:
    """Whether torques (n, nj) [Nm] are computed from motor_q - q (n, nj) [rad], all as recorded.

    A torque sensor does not know how an encoder rounds. Only joints whose deflection hardly changes faster than by
    rounding are looked at; counts (nj,) [rad] of the link encoders, 0 where unknown. Where motors are not recorded, all
    that is fast in the deflection is taken to be of the link.
    """
    if tau is None or q is None:
        return False
    found = []
    for j in range(q.shape[1]):
        alone = motor_q is None or not np.isfinite(motor_q[:, j]).any()
        order = ALONE if alone else WITH_MOTORS
        deflection = -q[:, j] if motor_q is None or alone else motor_q[:, j] - q[:, j]
        fast, rounding = np.diff(deflection, order), np.diff(tau[:, j], order)
        both = np.isfinite(fast) & np.isfinite(rounding)
        fast, rounding = fast[both], rounding[both]
        most = ROUNDED * counts[j] * np.sqrt(comb(2 * order, order) / comb(2 * WITH_MOTORS, WITH_MOTORS))
        if len(fast) and 0.0 < np.std(fast) < most and np.std(rounding) > 0.0:
            found.append(float(np.corrcoef(fast, rounding)[0, 1]))
    return bool(found) and float(np.median(found)) > ALIKE
