# SPDX-License-Identifier: BSD-3-Clause
"""How wrong predicted deflections have lately been, by horizon: the sigma of `com/deflection`."""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np

from ..base.compiled import Held, compiled, hold
from ..base.types import Array, Integers
from .blend import KNOWN, MEMORY, NOW

_WAITING = 4096  # predictions of a horizon that wait for their time: 2 s at 2 kHz


class Judged(NamedTuple):
    """Of k moments and n deflections; kinds of predictions are 0: as now, 1: by stride or plan."""

    legs: Array  # (n - 3,) indices of the joints whose deflections are the last ones
    after_ns: Integers  # (k,) moments after the stamp [ns]
    rows: Array  # (k, _WAITING, n) predictions that wait, in a ring
    dues: Integers  # (k, _WAITING) stamps when their time has come [ns]
    kinds: Integers  # (k, _WAITING)
    ends: Integers  # (k, 2) number of the first that waits, and of the next one
    square: Array  # (2, k, n) fading mean square of the errors, by kind
    known: Array  # (2, k, n) share of the memory that is known


class DeflectionJudge:
    """Compares predicted deflections of COM and joints with those that are measured when their time has come."""

    def __init__(self, horizons: Array, legs: Array) -> None:
        """Now and at horizons (k,) [s], for joints of indices `legs` (m,)."""
        self.after = np.concatenate(([0.0], horizons))  # [s]
        k, size = len(self.after), 3 + len(legs)
        dues, kinds = np.zeros((2, k, _WAITING), dtype=np.int64)
        square, known = np.zeros((2, 2, k, size))
        after_ns, ends = np.rint(self.after * 1e9).astype(np.int64), np.zeros((k, 2), dtype=np.int64)
        self._ends = ends
        judged = Judged(legs, after_ns, np.zeros((k, _WAITING, size)), dues, kinds, ends, square, known)
        self._judged = hold(judged)
        self._last_ns = 0

    def restart(self) -> None:
        """Time has jumped: predictions that wait are dropped, what was learnt is kept."""
        self._ends[:] = 0
        self._last_ns = 0

    def update(
        self, stamp_ns: int, com: Array, reference: Array, q: Array, motor_q: Array, predicted: Array, known: bool
    ) -> Array:
        """Take what is measured and predicted at a stamp.

        Args:
            stamp_ns: of the sample.
            com, reference: (3,) COM and that of the reference [m].
            q, motor_q: (nj,) positions of joints and motors [rad].
            predicted: (1 + k, 3 + m) deflections.
            known: whether by stride or plan.

        Returns:
            Standard deviation (1 + k, 3 + m) of such predictions, about zero; NaN where none has been judged yet.
        """
        dt = min(max(stamp_ns - self._last_ns, 0) * 1e-9, NOW)
        self._last_ns, sigma = stamp_ns, np.empty(predicted.shape)
        fresh = 1.0 - exp(-dt / MEMORY)
        _update(self._judged, stamp_ns, fresh, com, reference, q, motor_q, predicted, known, sigma)
        return sigma


@compiled
def _update(
    held: Held, stamp: int, fresh: float, com: Array, reference: Array, q: Array, motor_q: Array, predicted: Array,
    known_ahead: bool, out: Array,
) -> None:  # fmt: skip
    """`DeflectionJudge.update`; of several predictions whose time has come, the last one counts."""
    judged, measured, kind = held.value, np.empty(out.shape[1]), int(known_ahead)
    ends, legs, room = judged.ends, judged.legs, judged.rows.shape[1]
    for i in range(3):
        measured[i] = com[i] - reference[i]
    for j in range(legs.shape[0]):
        measured[3 + j] = q[legs[j]] - motor_q[legs[j]]
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
