# SPDX-License-Identifier: BSD-3-Clause
"""Bands of means of normalised errors squared, each of three axes, over steps."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from coman_reduced_model.core.base.types import Array, Integers


def bands(steps: Integers) -> tuple[Array, Array]:
    """Ends of the 95 % bands of the mean over each number of steps."""
    return chi2.ppf(0.025, 3 * steps) / steps, chi2.ppf(0.975, 3 * steps) / steps


def counted(walks: list[Array]) -> tuple[float, int, int, int]:
    """Median of the means of walks, and how many of them are in the band of their steps, below it and above."""
    means = np.array([each.mean() for each in walks])
    low, high = bands(np.array([len(each) for each in walks]))
    inside = ((means >= low) & (means <= high)).sum()
    return float(np.median(means)), int(inside), int((means < low).sum()), int((means > high).sum())
