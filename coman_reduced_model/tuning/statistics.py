# SPDX-License-Identifier: BSD-3-Clause
"""Intervals that hold for coloured noise: neighbouring residuals of a walking robot are never independent."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from ..core.base.types import Array

CONFIDENCE = 0.95


def hac_covariance(J: Array, residual: Array, lags: int, groups: Array | None = None) -> Array:
    """Covariance (p, p) of a least-squares estimate, consistent with heteroscedastic, autocorrelated residuals.

    Newey and West (1987), with Bartlett weights: (J^T J)^-1 S (J^T J)^-1.

    Args:
        J: (n, p) Jacobian of the residuals.
        residual: (n,) in order of time.
        lags: beyond which residuals count as independent.
        groups: (n,) number of the recording or stretch that a residual belongs to; different ones are independent.
    """
    bread = np.linalg.pinv(J.T @ J)
    scores = J * residual[:, None]
    meat = np.zeros_like(bread)
    groups = np.zeros(len(J)) if groups is None else groups
    for group in np.unique(groups):
        part = scores[groups == group]
        meat += part.T @ part
        for lag in range(1, min(lags, len(part) - 1) + 1):
            cross = part[lag:].T @ part[:-lag]
            meat += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return bread @ meat @ bread * len(J) / max(len(J) - J.shape[1], 1)


def quantile(freedom: float) -> float:
    """Half width of an interval in standard errors, by Student."""
    return float(stdtrit(max(freedom, 1.0), 0.5 + CONFIDENCE / 2.0))
