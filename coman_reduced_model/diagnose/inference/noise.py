# SPDX-License-Identifier: BSD-3-Clause
"""Noise of one group of rows: an autoregressive process, and an offset of its own in each contiguous piece.

Whitened by it, residuals and columns are innovations in units of their standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from ...core.base.compiled import compiled
from ...core.base.types import Array, Integers
from ..data.masks import TICKS
from ..data.signals import SMOOTHING
from ..data.strides import repeating
from .floor import least

ORDER = 3  # of the autoregression
RIDGE = 0.05  # where a stride has gaps


@dataclass(frozen=True)
class Noise:
    """Of one group of rows.

    Attributes:
        autoregression: (1 + ORDER,) standard deviation of the innovations, coefficients.
        offset: standard deviation of what a whole piece is off by; repeats: of what repeats with each stride.
    """

    autoregression: Array
    offset: float
    repeats: float = 0.0


def no_less(autoregression: Array, key: str, floors: Mapping[str, float]) -> Array:
    """The same, with innovations no smaller than the best sensors have (a tenth of their noise: it is smoothed)."""
    return np.concatenate([[max(autoregression[0], 0.1 * least(key, floors))], autoregression[1:]])


def mean_offset(remainder: Array, pieces: Integers) -> float:
    """Standard deviation of the means of the contiguous pieces; 0 where there are too few to say.

    A piece of one value is no mean: how much such values differ is the noise.
    """
    lengths = np.diff(np.append(pieces, len(remainder)))
    means = (np.add.reduceat(remainder, pieces) / lengths)[lengths > 1]
    return float(np.sqrt(means @ means / len(means))) if len(means) > 2 else 0.0


def independent(rows: Array, stride: Array | None, pieces: Integers, noise: Noise) -> tuple[Array, float]:
    """Rows (n, k) as values that are independent and of standard deviation 1 under the noise.

    Returns:
        these, and the logarithm of the determinant of the covariance (n, n) of the noise.
    """
    white, log = whiten(rows, pieces, noise.autoregression)
    white, by_offsets = free_of_offsets(white, pieces, noise)
    white, by_repeats = free_of_repeats(white, stride, pieces, noise)
    return white, log + by_offsets + by_repeats


def free_of_offsets(white: Array, pieces: Integers, noise: Noise) -> tuple[Array, float]:
    """Whitened rows (n, k) when every contiguous piece has an offset of its own as well; its log determinant.

    No step repeats another exactly, and an encoder that hardly moves has the same error all through a phase.
    """
    one = whiten(np.ones((len(white), 1)), pieces, noise.autoregression)[0][:, 0]
    out, log = _without_offsets(white, one, pieces, noise.offset)
    return np.asarray(out), float(log)


@compiled
def _without_offsets(white: Array, one: Array, pieces: Integers, offset: float) -> tuple[Array, float]:
    """`free_of_offsets`, with what becomes of a constant: one (n,)."""
    out, log = np.empty(white.shape), 0.0
    for p in range(len(pieces)):
        end = pieces[p + 1] if p + 1 < len(pieces) else len(white)
        length, common = 0.0, np.zeros(white.shape[1])
        for i in range(pieces[p], end):
            length += one[i] * one[i]
            for j in range(white.shape[1]):
                common[j] += one[i] * white[i, j]
        # The square root of (I + offset^2 u u')^-1.
        shrink = (1.0 - 1.0 / np.sqrt(1.0 + offset**2 * length)) / length
        log += np.log(1.0 + offset**2 * length)
        for i in range(pieces[p], end):
            for j in range(white.shape[1]):
                out[i, j] = white[i, j] - shrink * one[i] * common[j]
    return out, log


def repeated(remainder: Array, stride: Array | None) -> float:
    """Standard deviation of the part of a remainder (n,) that repeats with each stride, as `repeating` functions do.

    By the product of what they find in strides of even and of odd number: what does not repeat has no part in it.
    """
    if stride is None or not np.isfinite(stride).all():
        return 0.0
    halves = [np.floor(stride) % 2 == parity for parity in (0, 1)]
    if min(half.sum() for half in halves) < 2 * ORDER:
        return 0.0
    found = []
    for half in halves:
        A = repeating(stride[half])
        found.append(np.linalg.solve(A.T @ A + RIDGE * len(A) * np.eye(A.shape[1]), A.T @ remainder[half]))
    return float(np.sqrt(max(float(found[0] @ found[1]), 0.0)))


def free_of_repeats(white: Array, stride: Array | None, pieces: Integers, noise: Noise) -> tuple[Array, float]:
    """Whitened rows (n, k) when something that the model misses repeats with each stride as well; its log determinant.

    Many strides tell little more of an effect than one if the model is as far off in each of them.
    """
    if not noise.repeats or stride is None or not np.isfinite(stride).all():
        return white, 0.0
    waves = repeating(stride)
    scaled, _ = whiten(waves * (noise.repeats / np.sqrt(waves.shape[1])), pieces, noise.autoregression)
    scaled, _ = free_of_offsets(scaled, pieces, noise)
    U, s, _ = np.linalg.svd(scaled, full_matrices=False)
    free = white - (U * (1.0 - 1.0 / np.sqrt(1.0 + s**2))) @ (U.T @ white)
    return np.asarray(free), float(np.log1p(s**2).sum())


def first_guess(values: Array, pieces: Integers) -> Array:
    """Noise of a row before anything is explained: from its second differences' median, which steps and trends pass by.

    White noise that went through the smoothing has a known autocorrelation.
    """
    lags = np.arange(ORDER + 1)
    correlation = np.exp(-((lags / TICKS / SMOOTHING) ** 2) / 4.0)
    second = np.diff(values, 2)
    inside = np.ones(len(values), dtype=bool)
    inside[pieces] = False
    within = second[inside[1:-1] & inside[2:]]
    second = within if len(within) else second  # pieces of one or two ticks: rather too much noise than none
    variance = (1.4826 * float(np.median(np.abs(second)))) ** 2 / (6.0 - 8.0 * correlation[1] + 2.0 * correlation[2])
    phi = np.linalg.solve(toeplitz(correlation[:ORDER]) + 1e-3 * np.eye(ORDER), correlation[1:])
    return np.concatenate([[np.sqrt(max(variance * (1.0 - phi @ correlation[1:]), 1e-18))], phi])


def yule_walker(values: Array, pieces: Integers) -> Array:
    """Innovations' standard deviation and AR coefficients (1 + ORDER,), by Yule-Walker over contiguous pieces."""
    covariance = _autocovariance(values, pieces)
    covariance[0] = covariance[0] * (1.0 + 1e-6) + 1e-30
    phi = np.linalg.solve(toeplitz(covariance[:ORDER]), covariance[1:])
    innovation = covariance[0] - phi @ covariance[1:]
    return np.concatenate([[np.sqrt(max(innovation, 1e-6 * covariance[0]))], phi])


def white_noise(values: Array) -> Array:
    """The same of values (n,) that have nothing to do with each other, one for each step: about zero."""
    return np.array([max(float(np.sqrt(values @ values / max(len(values), 1))), 1e-15), *[0.0] * ORDER])


@compiled
def _autocovariance(values: Array, pieces: Integers) -> Array:
    """(1 + ORDER,) of values (n,) at lags from 0 on, of pairs in the same piece."""
    out = np.zeros(ORDER + 1)
    for p in range(len(pieces)):
        end = pieces[p + 1] if p + 1 < len(pieces) else len(values)
        for i in range(pieces[p], end):
            for lag in range(min(ORDER + 1, end - i)):
                out[lag] += values[i] * values[i + lag]
    return out / len(values)


@compiled
def whiten(values: Array, pieces: Integers, noise: Array) -> tuple[Array, float]:
    """Innovations (n, k) of columns (n, k) in units of their standard deviation; the noise's log determinant.

    A piece begins in the steady state of the process: its first values are predicted from as many as there are.
    """
    sigma, phi = _predictors(noise)
    out, log = np.empty(values.shape), 0.0
    for p in range(len(pieces)):
        end = pieces[p + 1] if p + 1 < len(pieces) else len(values)
        for i in range(pieces[p], end):
            known = min(i - pieces[p], ORDER)
            log += 2.0 * np.log(sigma[known])
            for j in range(values.shape[1]):
                value = values[i, j]
                for lag in range(known):
                    value -= phi[known, lag] * values[i - 1 - lag, j]
                out[i, j] = value / sigma[known]
    return out, log


@compiled
def _predictors(noise: Array) -> tuple[Array, Array]:
    """Standard deviation (1 + ORDER,) of the errors, and coefficients (1 + ORDER, ORDER), from 0, 1, ... values before.

    The recursion of Levinson and Durbin, backwards.
    """
    sigma, phi = np.empty(ORDER + 1), np.zeros((ORDER + 1, ORDER))
    sigma[ORDER], phi[ORDER] = noise[0], noise[1:]
    for m in range(ORDER, 0, -1):
        reflection = phi[m, m - 1]
        left = max(1.0 - reflection**2, 1e-6)
        sigma[m - 1] = sigma[m] / np.sqrt(left)
        for lag in range(m - 1):
            phi[m - 1, lag] = (phi[m, lag] + reflection * phi[m, m - 2 - lag]) / left
    return sigma, phi
