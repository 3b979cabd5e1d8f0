# SPDX-License-Identifier: BSD-3-Clause
"""How wrong predicted deflections have lately been, by horizon: the sigma of `com/deflection`."""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np

from ..base.compiled import Held, compiled, hold
from ..base.types import Array, Integers
from .blend import KNOWN, MEMORY, NOW

_WAITING = 1024  # predictions of a horizon that wait for their time


class Judged(NamedTuple):
    """Of k moments and n deflections; kinds of predictions are 0: as now, 1: by stride or plan."""

    after_ns: Integers  # (k,) moments after the stamp [ns]
    rows: Array  # (k, _WAITING, n) predictions that wait, in a ring
    dues: Integers  # (k, _WAITING) stamps when their time has come [ns]
    kinds: Integers  # (k, _WAITING)
    ends: Integers  # (k, 2) number of the first that waits, and of the next one
    square: Array  # (2, k, n) fading mean square of the errors, by kind
    known: Array  # (2, k, n) share of the memory that is known


class DeflectionJudge:
    """Compares predicted deflections with those that are measured when their time has come."""

    def __init__(self, horizons: Array, size: int) -> None:
        """For `size` deflections now and at horizons (k,) [s]."""
        self.after = np.concatenate(([0.0], horizons))  # [s]
        k = len(self.after)
        dues, kinds = np.zeros((2, k, _WAITING), dtype=np.int64)
        square, known = np.zeros((2, 2, k, size))
        after_ns, ends = np.rint(self.after * 1e9).astype(np.int64), np.zeros((k, 2), dtype=np.int64)
        self._ends = ends
        judged = Judged(after_ns, np.zeros((k, _WAITING, size)), dues, kinds, ends, square, known)
        self._judged = hold(judged)
        self._last_ns = 0

    def restart(self) -> None:
        """Time has jumped: predictions that wait are dropped, what was learnt is kept."""
        self._ends[:] = 0
        self._last_ns = 0

    def update(self, stamp_ns: int, measured: Array, predicted: Array, known: bool) -> Array:
        """Take what is measured (n,) and predicted (1 + k, n) at a stamp; `known`: by stride or plan.

        Returns:
            Standard deviation (1 + k, n) of such predictions, about zero; NaN where none has been judged yet.
        """
        dt = min(max(stamp_ns - self._last_ns, 0) * 1e-9, NOW)
        self._last_ns = stamp_ns
        return _update(self._judged, stamp_ns, 1.0 - exp(-dt / MEMORY), measured, predicted, int(known))


@compiled
def measured_deflections(com: Array, reference: Array, q: Array, motor_q: Array, legs: Array) -> Array:
    """Of the COM against the reference (3,) [m] and of the joints `legs` (m,) against their motors [rad]: (3 + m,)."""
    out = np.empty(3 + legs.shape[0])
    for i in range(3):
        out[i] = com[i] - reference[i]
    for j in range(legs.shape[0]):
        out[3 + j] = q[legs[j]] - motor_q[legs[j]]
    return out


@compiled
def _update(held: Held, stamp: int, fresh: float, measured: Array, predicted: Array, kind: int) -> Array:
    """`DeflectionJudge.update`; of several predictions whose time has come, the last one counts."""
    judged = held.value
    out, ends, room = np.empty(predicted.shape), judged.ends, judged.rows.shape[1]
    for k in range(predicted.shape[0]):
        place = ends[k, 1] % room
        judged.rows[k, place], judged.dues[k, place], judged.kinds[k, place] = (
            predicted[k],
            stamp + judged.after_ns[k],
            kind,
        )
        ends[k, 1] += 1
        ends[k, 0] = max(ends[k, 0], ends[k, 1] - room)
        latest = -1
        while ends[k, 0] < ends[k, 1] and judged.dues[k, ends[k, 0] % room] <= stamp:
            latest = ends[k, 0] % room
            ends[k, 0] += 1
        if latest >= 0:
            square, known = judged.square[judged.kinds[k, latest], k], judged.known[judged.kinds[k, latest], k]
            for i in range(measured.shape[0]):
                error = judged.rows[k, latest, i] - measured[i]
                if not np.isnan(error):
                    square[i] += fresh * (error * error - square[i])
                    known[i] += fresh * (1.0 - known[i])
        for i in range(measured.shape[0]):
            share = judged.known[kind, k, i]
            out[k, i] = np.sqrt(judged.square[kind, k, i] / share) if share > KNOWN else np.nan
    return out
