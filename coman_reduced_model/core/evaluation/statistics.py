# SPDX-License-Identifier: BSD-3-Clause
"""How good the predictions of a run were: errors per axis and phase, collected sample by sample."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from ..base.types import Array, Flags, Phase, Prediction

AXES = ("x", "y", "z")
NINETY = 1.645  # standard deviations within which 90 % of normal errors are
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)  # shares of normal errors, and within how many
QUANTILES = np.array([0.1257, 0.2533, 0.3853, 0.5244, 0.6745, 0.8416, 1.0364, 1.2816, NINETY, 1.9600])


class RunStatistics:
    """Squared errors of the free run and of the rigid robot, on the samples where both are known.

    A sample at which the free run diverged counts for neither: there it was restarted from the measurement.

    `mse` is (24) of the paper, per axis of the support sole. Where no reference exists (prediction.reference: none),
    the rigid robot has no error and the free run's counts alone.
    """

    def __init__(self, restart_gap_s: float) -> None:
        self._gap = round(restart_gap_s * 1e9)
        self._sums = {phase: np.zeros((2, 3)) for phase in Phase}
        self._counts = {phase: np.zeros(2, dtype=int) for phase in Phase}
        self._seconds = dict.fromkeys(Phase, 0.0)
        self._flags: Counter[str] = Counter()
        self._last: tuple[int, Phase] | None = None
        self.samples = 0

    def add(self, prediction: Prediction) -> None:
        """Take one prediction; stamps that go back or leave a gap restart the clock."""
        self.samples += 1
        phase = prediction.support.phase
        if self._last is not None and 0 < prediction.stamp_ns - self._last[0] <= self._gap:
            self._seconds[self._last[1]] += (prediction.stamp_ns - self._last[0]) * 1e-9
        self._last = prediction.stamp_ns, phase
        if prediction.flags:
            self._flags.update(flag.name for flag in Flags if flag and flag in prediction.flags)  # type: ignore[misc]
            if prediction.flags.diverged:
                return
        error = prediction.residual
        if error[0] == error[0]:  # not NaN
            self._sums[phase][0] += error * error
            self._counts[phase][0] += 1
            rigid = prediction.measured_com - prediction.reference_com
            if rigid[0] == rigid[0]:
                self._sums[phase][1] += rigid * rigid
                self._counts[phase][1] += 1

    def summary(self) -> dict[str, Any]:
        """The part of `summary.json` that this knows; NaN where nothing was judged."""
        return {
            "samples": self.samples,
            "judged_samples": int(sum(counts[0] for counts in self._counts.values())),
            "duration_s": sum(self._seconds.values()),
            "phases_s": {phase.name: seconds for phase, seconds in self._seconds.items()},
            "flags": dict(self._flags),
            **self._errors(list(Phase)),
            "by_phase": {
                phase.name: {"samples": int(self._counts[phase][0]), **self._errors([phase])}
                for phase in Phase
                if self._counts[phase][0]
            },
        }

    def _errors(self, phases: list[Phase]) -> dict[str, dict[str, float]]:
        sums: Array = np.sum([self._sums[phase] for phase in phases], axis=0)
        counts = np.sum([self._counts[phase] for phase in phases], axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mse = sums / counts[:, None]
        return {
            "mse_m2": by_axis(mse[0]),
            "rmse_m": by_axis(np.sqrt(mse[0])),
            "rmse_rigid_m": by_axis(np.sqrt(mse[1])),
        }


def by_axis(values: Array) -> dict[str, float]:
    """(3,) as {"x": ..., "y": ..., "z": ...}."""
    return dict(zip(AXES, values.tolist(), strict=True))


def beside(times: Array, t: float) -> tuple[int, float]:
    """Index, from 1 on, of the later one of the times (n,) around t, and its share; 0 or 1 beyond the ends."""
    k = int(np.clip(np.searchsorted(times, t), 1, len(times) - 1))
    return k, float(np.clip((t - times[k - 1]) / (times[k] - times[k - 1]), 0.0, 1.0))
