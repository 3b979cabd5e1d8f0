# SPDX-License-Identifier: BSD-3-Clause
"""Torques that a driver computes from the deflection of the springs: their noise is that of the link encoders."""

from __future__ import annotations

import numpy as np

from ...core.base.types import Array

ALIKE = 0.6  # correlation of the fast parts of torques and deflections, from which they are the same measurement
ROUNDED = 2.0  # counts of the link encoder: fast changes of a deflection that are no larger are rounding


def from_deflection(tau: Array | None, motor_q: Array | None, q: Array | None, counts: Array) -> bool:
    """Whether torques (n, nj) [Nm] are computed from motor_q - q (n, nj) [rad], all as recorded.

    A torque sensor does not know how an encoder rounds. Only joints whose deflection hardly changes faster than by
    rounding are looked at; counts (nj,) [rad] of the link encoders, 0 where unknown. Where motors are not recorded, all
    that is fast in the deflection is taken to be of the link.
    """
    if tau is None or q is None:
        return False
    motor_q = np.zeros_like(q) if motor_q is None else motor_q
    found = []
    for j in range(q.shape[1]):
        fast, rounding = np.diff(motor_q[:, j] - q[:, j], 2), np.diff(tau[:, j], 2)
        both = np.isfinite(fast) & np.isfinite(rounding)
        fast, rounding = fast[both], rounding[both]
        if len(fast) and 0.0 < np.std(fast) < ROUNDED * counts[j] and np.std(rounding) > 0.0:
            found.append(float(np.corrcoef(fast, rounding)[0, 1]))
    return bool(found) and float(np.median(found)) > ALIKE
