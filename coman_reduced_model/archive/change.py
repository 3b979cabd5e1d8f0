# SPDX-License-Identifier: BSD-3-Clause
"""Since when a series is at another level: one change at most, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.special import logsumexp

from ..core.base.types import Array

SURE = float(np.log(100.0))  # [nats] from which on a change counts: 100 to 1, as in the diagnosis
FEWEST = 2  # values before and after a change


@dataclass(frozen=True)
class Change:
    """A change of level.

    Attributes:
        first: index of the first value at the new level, the most probable one.
        earliest, latest: bounds of `first` that hold with 95 %.
        evidence: for one change against none [nats].
        step, low, high: change of the mean if it is at `first`, and its 95 % interval.
    """

    first: int
    earliest: int
    latest: int
    evidence: float
    step: float
    low: float
    high: float


def find_change(values: Array) -> Change | None:
    """The change of the mean of (n,) values in the order of time, all with one unknown variance; None if too few.

    Each place of a change has the same prior probability. The evidence of a place is the Bayes factor of a linear
    model with Zellner's g prior, g = n (the unit information prior): Liang et al. 2008, J. Am. Stat. Assoc. 103,
    410-423, equation (6), with one regressor. Values that depend on each other, or more than one change, make it too
    sure.
    """
    n = len(values)
    if n < 2 * FEWEST + 1:
        return None
    places = np.arange(FEWEST, n - FEWEST + 1)
    total = float(np.sum((values - values.mean()) ** 2))
    if total <= 0.0:
        return None
    sums: Array = np.cumsum(values - values.mean())[places - 1]  # of the values before each place
    explained = sums**2 * n / (places * (n - places)) / total  # R^2
    factors = 0.5 * (n - 2) * np.log1p(n) - 0.5 * (n - 1) * np.log1p(n * np.maximum(1.0 - explained, 0.0))
    evidence = float(logsumexp(factors) - np.log(len(places)))
    below: Array = np.cumsum(np.exp(factors - logsumexp(factors)))
    first = int(places[np.argmax(factors)])
    ends = [int(places[min(int(np.searchsorted(below, share)), len(places) - 1)]) for share in (0.025, 0.975)]
    before, after = values[:first], values[first:]
    step = float(after.mean() - before.mean())
    spread = np.sqrt(max(total - step**2 * first * (n - first) / n, 0.0) / (n - 2))
    half = float(stats.t.ppf(0.975, n - 2) * spread * np.sqrt(1.0 / first + 1.0 / (n - first)))
    return Change(first, min(ends[0], first), max(ends[1], first), evidence, step, step - half, step + half)


def strongest_change(errors: Array) -> Change | None:
    """The surest change of the logarithm of any column of (n, k) positive values; None if none is sure."""
    found = [change for column in np.log(errors).T if (change := find_change(column)) is not None]
    best = max(found, key=lambda each: each.evidence, default=None)
    return best if best is not None and best.evidence > SURE else None
