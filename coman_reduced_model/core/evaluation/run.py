# SPDX-License-Identifier: BSD-3-Clause
"""A run of the predictor as arrays, one row a sample, and the phases and steps in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..base.limits import DIVERGED
from ..base.types import Array, Booleans, Flags, Foot, Integers, Phase, Prediction

_GAP = 0.25  # [s] where samples are farther apart, lines are broken: nothing is known in between


@dataclass(frozen=True)
class Step:
    """One step: the double support before it and the single support that follows, samples first to last - 1."""

    first: int
    last: int
    foot: Foot  # the support foot of its single support


@dataclass(frozen=True)
class Run:
    """Predictions, one row a sample; vectors (n, 3) in the support sole, NaN where not valid, m and s."""

    time: Array  # (n,) [s] since the first sample
    phase: Integers  # (n,) Phase
    foot: Integers  # (n,) Foot
    left_share: Array  # (n,) [1]
    flags: Integers  # (n,) Flags
    measured: Array
    reference: Array
    predicted: Array
    T_odom_sole: Array  # (n, 4, 4)
    frames: dict[Foot, str]  # sole frames

    def __len__(self) -> int:
        return len(self.time)

    @property
    def residual(self) -> Array:
        """Measured minus predicted, (n, 3) [m]."""
        return self.measured - self.predicted

    @property
    def deflection(self) -> Array:
        """Measured minus reference, (n, 3) [m]: what the rigid-robot assumption gets wrong."""
        return self.measured - self.reference

    @property
    def predicted_deflection(self) -> Array:
        """Predicted minus reference, (n, 3) [m]."""
        return self.predicted - self.reference

    @property
    def diverged(self) -> Booleans:
        """(n,) whether the free run diverged: there it begins from the measurement again and predicts nothing."""
        both = int(Flags.RESET | Flags.REJECTED_STATE)
        return (self.flags & both) == both

    def possible(self) -> Run:
        """The same run without what is beyond physics.

        NaN stands for predictions where the free run diverged, and for predictions and references that are `DIVERGED`
        or more from the measured COM along an axis.
        """
        predicted = np.where((self.diverged | _far(self.predicted, self.measured))[:, None], np.nan, self.predicted)
        reference = np.where(_far(self.reference, self.measured)[:, None], np.nan, self.reference)
        return replace(self, predicted=predicted, reference=reference)

    def in_odom(self, points: Array) -> Array:
        """Points (n, 3) of the support sole in `odom`."""
        return np.einsum("nij,nj->ni", self.T_odom_sole[:, :3, :3], points) + self.T_odom_sole[:, :3, 3]

    def slice(self, first: int, last: int) -> Run:
        """Samples first to last - 1; time goes on from the start of the whole run."""
        each = {name: value[first:last] for name, value in vars(self).items() if name != "frames"}
        return Run(**each, frames=self.frames)

    def breaks(self) -> Booleans:
        """(n,) whether a line must not come from the sample before: a reset, another support sole, or a gap."""
        broken = np.zeros(len(self), dtype=bool)
        if len(self) > 1:
            broken[1:] = (np.diff(self.foot) != 0) | (np.diff(self.time) > _GAP) | (np.diff(self.time) <= 0)
        return broken | ((self.flags & Flags.RESET) != 0)

    def phases(self) -> list[tuple[int, int, Phase]]:
        """Stretches of one phase: first sample, first sample after it, phase."""
        if not len(self):
            return []
        edges = [0, *(np.flatnonzero(np.diff(self.phase)) + 1).tolist(), len(self)]
        return [(a, b, Phase(int(self.phase[a]))) for a, b in zip(edges, edges[1:], strict=False)]

    def steps(self) -> list[Step]:
        """Complete steps, in order: a single support between two double supports, with the one before it."""
        stretches = self.phases()
        return [
            Step(before[0], now[1], Foot.LEFT if now[2] == Phase.LEFT else Foot.RIGHT)
            for before, now, after in zip(stretches, stretches[1:], stretches[2:], strict=False)
            if before[2] == Phase.DOUBLE == after[2] and now[2] in (Phase.LEFT, Phase.RIGHT)
        ]

    def consecutive_steps(self, count: int = 3) -> tuple[int, int] | None:
        """First sample and end of `count` steps in a row, in the middle of the walk: chosen by place, never by fit."""
        steps = self.steps()
        follows = [a.last == b.first and a.foot != b.foot for a, b in zip(steps, steps[1:], strict=False)]
        rows = [steps[i : i + count] for i in range(len(steps) - count + 1) if all(follows[i : i + count - 1])]
        if not rows:
            return None
        row = rows[len(rows) // 2]
        return row[0].first, row[-1].last


def _far(points: Array, measured: Array) -> Booleans:
    with np.errstate(invalid="ignore"):
        far = np.logical_or(np.abs(points - measured) >= DIVERGED, np.isinf(points))
    return np.logical_or.reduce(far, axis=1)


def run_of(predictions: Iterable[Prediction]) -> Run:
    """A run of the predictor's own results, without a bag between."""
    return run_of_rows(
        (p.stamp_ns, p.frame_id, p.support.phase, p.support.support_foot, p.support.left_share, p.flags,
         p.measured_com, p.reference_com, p.predicted_com, p.T_odom_sole)
        for p in predictions
    )  # fmt: skip


def run_of_rows(rows: Iterable[tuple[Any, ...]]) -> Run:
    """A run from rows of stamp, frame, phase, foot, share, flags, three points and the pose of the sole."""
    columns = list(zip(*rows, strict=True)) or [()] * 10
    stamps = np.array(columns[0], dtype=np.int64)
    phase, foot, flags = (np.array(columns[i], dtype=np.int64) for i in (2, 3, 5))
    frames: dict[Foot, str] = {}
    for side in (Foot.LEFT, Foot.RIGHT):
        used = np.flatnonzero(foot == side)
        if len(used):
            frames[side] = columns[1][used[0]]
    measured, reference, predicted = (np.array(columns[i], dtype=float).reshape(-1, 3) for i in (6, 7, 8))
    return Run(
        (stamps - stamps[0]) * 1e-9 if len(stamps) else np.empty(0),
        phase,
        foot,
        np.array(columns[4], dtype=float),
        flags,
        measured,
        reference,
        predicted,
        np.array(columns[9], dtype=float).reshape(-1, 4, 4),
        frames,
    )
