# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead, judged when the measurement arrives, against three baselines on the same samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import compiled
from ..base.types import Array

Ints = NDArray[np.int64]
PREDICTORS = ("model", "rigid", "persistence", "lipm")
BASELINES = PREDICTORS[1:]
_CAPACITY = 4096  # pending predictions a horizon: 2 s at 2 kHz


class HorizonJudge:
    """Collects squared errors of each predictor at each horizon, per axis of the sole that predicted.

    Sums are over the samples where all predictors have a value, so that their errors are comparable.
    """

    def __init__(self, horizons: tuple[float, ...], rigid: bool = True) -> None:
        """Horizons in seconds; without `rigid` there is no reference, and that predictor is left out (NaN)."""
        self._needed = np.array([True, rigid, True, True])
        self.horizons = horizons
        n = len(horizons)
        self._ahead_ns = np.array([round(h * 1e9) for h in horizons], dtype=np.int64)
        self._targets = np.zeros((n, _CAPACITY), dtype=np.int64)
        self._poses = np.zeros((n, _CAPACITY, 4, 4))
        self._predicted = np.zeros((n, _CAPACITY, len(PREDICTORS), 3))
        self._first = np.zeros(n, dtype=np.int64)
        self._count = np.zeros(n, dtype=np.int64)
        self._sums = np.zeros((n, len(PREDICTORS), 3))
        self._judged = np.zeros((n, 3), dtype=np.int64)
        self._last_ns = 0
        self._last = np.full((2, 3), np.nan)  # measured and reference COM in odom at the last sample

    def restart(self) -> None:
        """Drop the pending predictions: the stream broke off."""
        self._count[:] = 0
        self._last[:] = np.nan

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
        _update(
            stamp_ns,
            T_odom_sole,
            measured,
            reference,
            model,
            persistence,
            lipm,
            self._ahead_ns,
            self._targets,
            self._poses,
            self._predicted,
            self._first,
            self._count,
            self._sums,
            self._judged,
            self._last_ns,
            self._last,
            self._needed,
        )
        self._last_ns = stamp_ns

    def rmse(self) -> dict[str, dict[str, Array]]:
        """RMSE (3,) [m] by horizon (as text, `0.1`) and predictor; NaN where nothing was judged."""
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.sqrt(self._sums / self._judged[:, None, :])
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
        return {f"{h:g}": self._judged[i].copy() for i, h in enumerate(self.horizons)}


@compiled
def _to_odom(T: Array, p: Array, out: Array) -> None:
    for i in range(3):
        out[i] = T[i, 0] * p[0] + T[i, 1] * p[1] + T[i, 2] * p[2] + T[i, 3]


@compiled
def _update(
    stamp_ns: int, T: Array, measured: Array, reference: Array, model: Array, persistence: Array, lipm: Array,
    ahead_ns: Ints, targets: Ints, poses: Array, predicted: Array, first: Ints, count: Ints, sums: Array,
    judged: Ints, last_ns: int, last: Array, needed: NDArray[np.bool_],
) -> None:  # fmt: skip
    now = np.empty((2, 3))
    _to_odom(T, measured, now[0])
    _to_odom(T, reference, now[1])
    capacity = targets.shape[1]
    errors = np.empty((4, 3))
    for h in range(targets.shape[0]):
        while count[h] > 0 and targets[h, first[h]] <= stamp_ns:
            slot = first[h]
            first[h] = (slot + 1) % capacity
            count[h] -= 1
            w = (targets[h, slot] - last_ns) / (stamp_ns - last_ns)
            values = predicted[h, slot]
            for i in range(3):
                values[1, i] = (1.0 - w) * last[1, i] + w * now[1, i]
            for k in range(4):
                for i in range(3):
                    e = 0.0
                    for j in range(3):  # into the axes of the sole that predicted
                        e += poses[h, slot, j, i] * (values[k, j] - ((1.0 - w) * last[0, j] + w * now[0, j]))
                    errors[k, i] = e
            for i in range(3):
                complete = True
                for k in range(4):
                    complete &= not (needed[k] and np.isnan(errors[k, i]))
                if not complete:
                    continue
                judged[h, i] += 1
                for k in range(4):
                    sums[h, k, i] += errors[k, i] ** 2
        if count[h] < capacity:
            slot = (first[h] + count[h]) % capacity
            count[h] += 1
            targets[h, slot] = stamp_ns + ahead_ns[h]
            for i in range(4):
                for j in range(4):
                    poses[h, slot, i, j] = T[i, j]
            _to_odom(T, model[h], predicted[h, slot, 0])
            _to_odom(T, persistence[h], predicted[h, slot, 2])
            _to_odom(T, lipm[h], predicted[h, slot, 3])
    for k in range(2):
        for i in range(3):
            last[k, i] = now[k, i]
