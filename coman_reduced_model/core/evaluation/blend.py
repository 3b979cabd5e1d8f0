# SPDX-License-Identifier: BSD-3-Clause
"""Predictions ahead, blended by how wrong each has lately been, and how wrong the blend itself is.

What is known of the last seconds (`MEMORY`) is, by horizon and axis, the second moments of the errors of all
predictors. The blend has the weights of least expected square error among those that are not negative and sum to one
(Bates and Granger, 1969: the combination of forecasts). Where the model is the best of them by far it has all of the
weight; where it is wrong, what is simpler takes over, and gives way when the model is right again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, Booleans

MEMORY = 8.0  # [s] time constant with which errors are forgotten
KNOWN = 0.02  # of the whole memory, from which on it says something: 0.16 s
SHRUNK = 0.2  # share by which the errors of two predictors are taken to be less correlated than they were
WORSE = 1.2  # times the error of a simpler prediction, from which on the model is said to be worse
LONG = 0.3  # of the whole memory, before which that is not said: 3 s
GIVEN = 0.02  # share of another model's experience that one without any begins with
EXPECTED = 0.001, 0.01  # [m] that what is expected to be best, and all else, is taken to be off by
LEAST = 1e-5  # [m] that any prediction is taken to be off by
SWEEPS = 60  # of the search for the weights, at most
STAYS = 1e-13  # of the weights: a sweep that changes less is the last one
OWN = 2  # of the predictors are the model's: as it is, and corrected
NOW = 0.1  # [s] that one error counts for at most: it stands for the time since the last one


class Experience(NamedTuple):
    """Of n horizons and k predictors, the model's OWN first: fading sums of products of errors, and of their times.

    Axes are those of the sole that predicted.
    """

    moments: Array  # (n, 3, k, k) [m^2] by axis
    times: Array  # (n, 3, k, k) [1] share of the memory in which both were known
    weights: Array  # (n, 3, k) of the blend
    worse: Booleans  # (n, 3) whether a simpler prediction has been better than the model
    errors: Array  # (n, 3, 3) [m^2] of the blend, axis by axis
    known: Array  # (n,) [1] share of the memory in which the blend was judged
    fresh: Booleans  # (n,) errors have been taken in since the weights were made


def no_experience(n: int, k: int, best: int = 0) -> Experience:
    """Nothing has been judged yet: the model has all of the weight, or the one that is expected to be best.

    The latter begins with a little (`GIVEN`) of an experience: by `EXPECTED` errors of it and of all others.
    """
    weights = np.zeros((n, 3, k))
    weights[:, :, best] = 1.0
    moments, times = np.zeros((2, n, 3, k, k))
    if best:
        expected = np.where(np.arange(k) == best, *EXPECTED)
        moments[:] = GIVEN * np.diag(expected**2)
        times[:] = GIVEN
    worse, fresh = np.zeros((n, 3), np.bool_), np.zeros(n, np.bool_)
    return Experience(moments, times, weights, worse, np.zeros((n, 3, 3)), np.zeros(n), fresh)


def begin_with(experience: Experience, other: Experience) -> None:
    """Let one without experience begin with a little (`GIVEN`) of another one's."""
    experience.moments[:], experience.times[:] = GIVEN * other.moments, GIVEN * other.times
    experience.weights[:] = other.weights


@compiled
def learn(experience: Experience, h: int, off: Array, blended: Array, dt: float) -> None:
    """Take in errors at a horizon: off (k, 3) of each predictor and blended (3,) [m], dt [s] after the ones before."""
    fresh = 1.0 - np.exp(-min(dt, NOW) / MEMORY)
    moments, times, k = experience.moments[h], experience.times[h], off.shape[0]
    for axis in range(3):
        for i in range(k):
            for j in range(i + 1):
                moment, time = (1.0 - fresh) * moments[axis, i, j], (1.0 - fresh) * times[axis, i, j]
                product = off[i, axis] * off[j, axis]
                if np.isfinite(product):
                    moment, time = moment + fresh * product, time + fresh
                moments[axis, i, j] = moments[axis, j, i] = moment
                times[axis, i, j] = times[axis, j, i] = time
    experience.known[h] = remember(experience.errors[h], experience.known[h], blended, fresh)
    experience.fresh[h] = True


@compiled
def forget(experience: Experience, h: int, dt: float) -> None:
    """Let errors of what was published at a horizon fade, where another kind of prediction was judged dt [s] later."""
    fresh = 1.0 - np.exp(-min(dt, NOW) / MEMORY)
    experience.errors[h] *= 1.0 - fresh
    experience.known[h] *= 1.0 - fresh


@compiled
def remember(errors: Array, known: float, off: Array, fresh: float) -> float:
    """Let fading sums of products (3, 3) take in an error (3,), and return the share of the memory that is known."""
    if not np.isfinite(off[0] + off[1] + off[2]):
        errors *= 1.0 - fresh
        return known * (1.0 - fresh)
    for i in range(3):
        for j in range(3):
            errors[i, j] = (1.0 - fresh) * errors[i, j] + fresh * off[i] * off[j]
    return known * (1.0 - fresh) + fresh


@compiled
def follow(known: Array, measured: Array, predicted: Array, fresh: float) -> Array:
    """`remember` a residual and return the `covariance` (3, 3) [m^2] then; known (10,): the sums and the share."""
    errors = known[:9].reshape(3, 3)
    if fresh > 0.0:
        known[9] = remember(errors, known[9], measured - predicted, fresh)
    return covariance(errors, known[9])


@compiled
def weigh(experience: Experience) -> None:
    """New weights of the blend, at all axes and the horizons where there are new errors."""
    n, k = experience.weights.shape[0], experience.weights.shape[2]
    C, usable = np.empty((k, k)), np.empty(k, np.bool_)
    for h in range(n):
        if not experience.fresh[h]:
            continue
        experience.fresh[h] = False
        for axis in range(3):
            moments, times = experience.moments[h, axis], experience.times[h, axis]
            if not times[0, 0] > KNOWN:  # nothing to compare the others with
                continue
            own, best = np.inf, np.inf
            for i in range(k):
                usable[i] = times[i, i] > KNOWN
                for j in range(k):
                    less = 1.0 if i == j else 1.0 - SHRUNK
                    C[i, j] = less * moments[i, j] / times[i, j] if times[i, j] > 0.0 else 0.0
                if usable[i] and i < OWN:
                    own = min(own, C[i, i])
                elif usable[i]:
                    best = min(best, C[i, i])
            experience.worse[h, axis] = times[0, 0] > LONG and own > WORSE**2 * best
            least_squares(C, usable, experience.weights[h, axis])


@compiled
def least_squares(C: Array, usable: Booleans, weights: Array) -> None:
    """Fill in weights (k,) >= 0 with sum 1, zero where not usable (k,), that make w' C w least; C (k, k) is symmetric.

    They are those of the least y' C y / 2 - sum y with y >= 0, found coordinate by coordinate, each in units of its own
    error. What comes out is continuous in C: the same input, but for rounding, gives the same blend.
    """
    k = weights.shape[0]
    unit, z, alike = np.zeros(k), np.zeros(k), np.zeros((k, k))
    for i in range(k):
        if usable[i]:
            unit[i] = 1.0 / np.sqrt(C[i, i] + LEAST**2)
    for i in range(k):
        for j in range(k):
            alike[i, j] = unit[i] * C[i, j] * unit[j] if j != i else 0.0
    rest = unit.copy()  # unit - alike z; most of z stays zero
    for _ in range(SWEEPS):
        changed = 0.0
        for i in range(k):
            more = max(rest[i], 0.0) - z[i]
            if more != 0.0:
                z[i] += more
                changed = max(changed, abs(more))
                for j in range(k):
                    rest[j] -= more * alike[i, j]
        if changed <= STAYS * z.sum():
            break
    total = (unit * z).sum()
    for i in range(k):
        weights[i] = unit[i] * z[i] / total


@compiled
def blend(experience: Experience, ahead: Array, out: Array) -> None:
    """Fill in the blend (n, 3) of predictions ahead (k, n, 3), of those that are known now; NaN if none is.

    If none that has a weight is known, it is the first that is: the model's, as before there is any experience.
    """
    for h in range(out.shape[0]):
        for axis in range(3):
            value, sum_of_weights, first = 0.0, 0.0, np.nan
            for i in range(ahead.shape[0]):
                each, weight = ahead[i, h, axis], experience.weights[h, axis, i]
                if np.isfinite(each):
                    first = each if np.isnan(first) else first
                    if weight > 0.0:
                        value += weight * each
                        sum_of_weights += weight
            out[h, axis] = value / sum_of_weights if sum_of_weights > 0.0 else first


@compiled
def covariance(errors: Array, known: float) -> Array:
    """(3, 3) [m^2] about zero, by fading sums; NaN while too little is known."""
    return errors / known if known > KNOWN else np.full((3, 3), np.nan)
