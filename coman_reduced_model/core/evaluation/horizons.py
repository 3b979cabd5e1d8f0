# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead, judged when the measurement arrives, against three baselines on the same samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import compiled
from ..base.types import Array

Ints = NDArray[np.int64]
PREDICTORS = ("model", "rigid", "persistence", "lipm")
BASELINES = PREDICTORS[1:]
_CAPACITY = 4096  # pending predictions a horizon: 2 s at 2 kHz


class Pending(NamedTuple):
    """Predictions that wait for the measurement, a ring of slots for each of n horizons."""

    ahead_ns: Ints  # (n,) the horizons [ns]
    targets: Ints  # (n, slots) stamps that are predicted [ns]
    poses: Array  # (n, slots, 4, 4) of the sole that predicted, in odom
    predicted: Array  # (n, slots, 4, 3) by PREDICTORS, in odom [m]
    first: Ints  # (n,) oldest slot
    used: Ints  # (n,) slots in use


class Errors(NamedTuple):
    """Squared errors so far, and what the next ones are interpolated from."""

    sums: Array  # (n, 4, 3) [m^2]
    judged: Ints  # (n, 3) how many
    needed: NDArray[np.bool_]  # (4,) predictors without which nothing counts
    last: Array  # (2, 3) measured and reference COM in odom at the last sample [m]


class HorizonJudge:
    """Collects squared errors of each predictor at each horizon, per axis of the sole that predicted.

    Sums are over the samples where all predictors have a value, so that their errors are comparable.
    """

    def __init__(self, horizons: tuple[float, ...], rigid: bool = True) -> None:
        """Horizons in seconds; without `rigid` there is no reference, and that predictor is left out (NaN)."""
        self.horizons = horizons
        n, predictors = len(horizons), len(PREDICTORS)
        self._pending = Pending(
            np.array([round(h * 1e9) for h in horizons], dtype=np.int64),
            np.zeros((n, _CAPACITY), dtype=np.int64),
            np.zeros((n, _CAPACITY, 4, 4)),
            np.zeros((n, _CAPACITY, predictors, 3)),
            np.zeros(n, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
        )
        self._errors = Errors(
            np.zeros((n, predictors, 3)),
            np.zeros((n, 3), dtype=np.int64),
            np.array([True, rigid, True, True]),
            np.full((2, 3), np.nan),
        )
        self._last_ns = 0

    def restart(self) -> None:
        """Drop the pending predictions: the stream broke off."""
        self._pending.used[:] = 0
        self._errors.last[:] = np.nan

    def update(
        self,
        stamp_ns: int,
        T_odom_sole: Array,
        measured: Array,
        reference: Array,
        model: Array,
        persistence: Array,
        lipm: Array,
    ) -> None:
        """Judge what is due at this sample and take its predictions in.

        Args:
            stamp_ns: of the sample.
            T_odom_sole: (4, 4) pose of the support sole.
            measured, reference: (3,) COM now [m], in the sole frame; reference NaN if there is none.
            model, persistence, lipm: (n, 3) predictions [m] in the sole frame, a row a horizon; NaN where none.
        """
        now = np.empty((2, 3))
        _to_odom(T_odom_sole, measured, now[0])
        _to_odom(T_odom_sole, reference, now[1])
        _judge_due(self._pending, self._errors, stamp_ns, self._last_ns, now)
        _add(self._pending, stamp_ns, T_odom_sole, model, persistence, lipm)
        self._errors.last[:] = now
        self._last_ns = stamp_ns

    def rmse(self) -> dict[str, dict[str, Array]]:
        """RMSE (3,) [m] by horizon (as text, `0.1`) and predictor; NaN where nothing was judged."""
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.sqrt(self._errors.sums / self._errors.judged[:, None, :])
        return {f"{h:g}": dict(zip(PREDICTORS, means[i], strict=True)) for i, h in enumerate(self.horizons)}

    def skill(self) -> dict[str, Array]:
        """1 - RMSE of the model / RMSE of the best baseline, (3,) a horizon; NaN where nothing was judged."""
        skills = {}
        for h, errors in self.rmse().items():
            with np.errstate(invalid="ignore", divide="ignore"):
                best = np.fmin.reduce([errors[name] for name in BASELINES])
                skills[h] = 1.0 - errors["model"] / best
        return skills

    @property
    def judged(self) -> dict[str, Array]:
        """How many predictions were judged, (3,) a horizon."""
        return {f"{h:g}": self._errors.judged[i].copy() for i, h in enumerate(self.horizons)}


@compiled
def _to_odom(T: Array, p: Array, out: Array) -> None:
    for i in range(3):
        out[i] = T[i, 0] * p[0] + T[i, 1] * p[1] + T[i, 2] * p[2] + T[i, 3]


@compiled
def _judge_due(pending: Pending, errors: Errors, stamp_ns: int, last_ns: int, now: Array) -> None:
    """Judge the predictions of stamps up to this one by measured and reference COM now (2, 3), in odom [m]."""
    first, used, capacity = pending.first, pending.used, pending.targets.shape[1]
    for h in range(pending.targets.shape[0]):
        while used[h] > 0 and pending.targets[h, first[h]] <= stamp_ns:
            slot = first[h]
            first[h] = (slot + 1) % capacity
            used[h] -= 1
            w = (pending.targets[h, slot] - last_ns) / (stamp_ns - last_ns)
            true = (1.0 - w) * errors.last + w * now
            values = pending.predicted[h, slot]
            values[1] = true[1]  # the rigid robot is at its reference
            _add_errors(errors, h, pending.poses[h, slot], values, true[0])


@compiled
def _add_errors(errors: Errors, h: int, pose: Array, values: Array, measured: Array) -> None:
    """Square the errors of all predictors (4, 3), along the axes of the sole that predicted."""
    off = np.zeros((4, 3))
    for k in range(4):
        for i in range(3):
            for j in range(3):
                off[k, i] += pose[j, i] * (values[k, j] - measured[j])
    for i in range(3):
        complete = True
        for k in range(4):
            complete &= not (errors.needed[k] and np.isnan(off[k, i]))
        if complete:
            errors.judged[h, i] += 1
            for k in range(4):
                errors.sums[h, k, i] += off[k, i] ** 2


@compiled
def _add(pending: Pending, stamp_ns: int, pose: Array, model: Array, persistence: Array, lipm: Array) -> None:
    """Take in the predictions (n, 3) of a sample; where all slots are in use they are dropped."""
    capacity = pending.targets.shape[1]
    for h in range(pending.targets.shape[0]):
        if pending.used[h] < capacity:
            slot = (pending.first[h] + pending.used[h]) % capacity
            pending.used[h] += 1
            pending.targets[h, slot] = stamp_ns + pending.ahead_ns[h]
            pending.poses[h, slot] = pose
            _to_odom(pose, model[h], pending.predicted[h, slot, 0])
            _to_odom(pose, persistence[h], pending.predicted[h, slot, 2])
            _to_odom(pose, lipm[h], pending.predicted[h, slot, 3])
