# SPDX-License-Identifier: BSD-3-Clause
"""Signals on a uniform grid: shifted in time, and behind a first-order lag."""

from __future__ import annotations

import numpy as np

from .types import Array

FAST = 1.0  # [m/s] no COM moves over its sole


def shifted(values: Array, by: float, rate: float) -> Array:
    """Values `by` seconds later (n, k), at a rate [Hz]: what a stream that is late by that should have said.

    By cubics through four values: lines through two would take part of the noise away, which then speaks for a delay
    of half a sample that is not there.
    """
    n = len(values)
    position = np.clip(np.arange(n) + by * rate, 0.0, n - 1.0)
    low = np.minimum(np.floor(position).astype(int), n - 2)
    t = position - low
    weights = (
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    )
    out = np.zeros_like(values)
    for k, weight in enumerate(weights):
        used = weight != 0.0  # a whole shift takes what is there, gaps in the neighbours or not
        out[used] += weight[used, None] * values[np.clip(low[used] + k - 1, 0, n - 1)]
    return out


def apart(values: Array, rate: float) -> tuple[Array, Array]:
    """A COM over the stance sole (n, k) [m], without its jumps where the other sole becomes it, and these jumps (n, k).

    What moves faster than FAST has jumped, by what it moved beside its speed before.
    """
    moved = np.diff(values, axis=0)
    fast = np.abs(moved).max(axis=1) > FAST / rate
    usual = np.where(fast[:, None], np.nan, moved)
    last = np.maximum.accumulate(np.where(fast, 0, np.arange(len(moved))))
    jumps = np.where(fast[:, None], moved - np.nan_to_num(usual[last]), 0.0)
    jumps = np.concatenate((np.zeros_like(values[:1]), np.cumsum(jumps, axis=0)))
    return values - jumps, jumps


def lagged(values: Array, time_constant: float, rate: float) -> Array:
    """First-order lag [s] along the first axis, at a rate [Hz].

    A negative time constant leads (for difference quotients around zero).
    """
    if time_constant <= 0.0:
        return values - time_constant * np.gradient(values, 1.0 / rate, axis=0)
    a = np.exp(-1.0 / rate / time_constant)
    # Exact for values that are linear between samples.
    b = time_constant * rate * (1.0 - a)
    state = b * values[:1]  # as if it had been at its first value for ever
    from scipy.signal import lfilter  # loads scipy.optimize, which predictions do without

    return np.asarray(lfilter([1.0 - b, b - a], [1.0, -a], values, axis=0, zi=state)[0])
