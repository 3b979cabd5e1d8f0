# SPDX-License-Identifier: BSD-3-Clause
"""Streams of a bag on the uniform grid of a recording, and where each of them is there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

from ...core.base.stream_names import IMU, JOINTS, REFERENCE
from ...core.base.types import Array, Booleans, Integers, Sample
from ...core.pipeline import clock_apart
from ...core.robot.robot import Robot

LEAST_THERE = 0.8  # share of the time that a stream must be there, to be used
PAUSE = 10.0  # [s] without joint states, from which what follows is another run
_NEAR, _NEAR_PERIODS = 0.02, 0.6  # [s], and periods of a stream, from a value of it until which it is there


def clocks_apart(arrived: Mapping[str, Sequence[tuple[int, int]]], most_s: float) -> list[str]:
    """IMU and plan, whose clocks nobody needs for a prediction, against that of the joint states as they arrived.

    Args:
        arrived: by stream, log times and stamps [ns].
        most_s: by which they may differ [s]; a plan may come early.
    """
    out = []
    for stream in (IMU, REFERENCE):
        if arrived.get(stream) and arrived.get(JOINTS):
            (log, stamps), (at, joints) = (np.array(arrived[each]).T for each in (stream, JOINTS))
            if at[-1] <= at[0]:  # no log times
                continue
            ahead = float(np.median(stamps - log - np.interp(log, at, joints - at))) * 1e-9
            if (warning := clock_apart(stream, ahead, most_s)) is not None:
                out.append(str(warning))
    return out


def rising(stamps: Array | Integers) -> Booleans:
    """(n,) Whether each of n stamps is later than all before it."""
    return np.asarray(np.diff(np.maximum.accumulate(stamps), prepend=stamps[:1] - 1) > 0)


def longest_run(stamps: Sequence[int] | Integers, gap: float) -> tuple[int, int, int]:
    """Begin and end of the most stamps [ns] in a row without a pause, that never go back by more than `gap` [s].

    Returns:
        Begin, end, how many other runs there are.
    """
    steps = np.diff(stamps)
    ends = [0, *(np.flatnonzero((steps < -1e9 * gap) | (steps > 1e9 * PAUSE)) + 1).tolist(), len(stamps)]
    begin, end = max(pairwise(ends), key=lambda run: run[1] - run[0])
    return begin, end, len(ends) - 2


def rows_of(samples: list[Sample], field: str) -> Array | None:
    """(n, k) values of a field, NaN where a sample lacks it; None: most lack it."""
    rows = [getattr(s, field) for s in samples]
    if sum(row is None for row in rows) > len(rows) // 2:
        return None
    size = next(len(row) for row in rows if row is not None)
    return np.array([np.full(size, np.nan) if row is None else row for row in rows])


def resample(at: Array, values: Array, t: Array) -> Array:
    """Averages over a grid interval where the samples are denser than the grid, else linear between them."""
    per_cell = (t[1] - t[0]) / max(float(np.median(np.diff(at))), 1e-9)
    width = 2 * (round(per_cell) // 2) + 1  # odd, so that nothing moves in time
    out = np.empty((len(t), values.shape[1]))
    for k in range(values.shape[1]):
        finite = np.isfinite(values[:, k])
        if finite.any():
            column = np.interp(at, at[finite], values[finite, k])
            out[:, k] = np.interp(t, at, uniform_filter1d(column, width, mode="nearest") if width > 1 else column)
        else:
            out[:, k] = np.nan
    return out


def there(at: Array, values: Array | None, t: Array) -> Booleans:
    """(n,) whether a stream is there at times t (n,): values (k, m) at times (k,), NaN where one is missing; or none.

    Columns that are seldom there say nothing of the others.
    """
    if values is None:
        return np.zeros(len(t), dtype=bool)
    columns = ~seldom_there(values)
    at = at[np.isfinite(values)[:, columns].all(axis=1)]
    return near(at, t) if columns.any() and len(at) > 1 else np.zeros(len(t), dtype=bool)


def seldom_there(values: Array) -> Booleans:
    """(m,) columns of values (k, m) that are missing (NaN) in much of the time in which any other is there."""
    finite = np.isfinite(values)
    return np.asarray(finite.sum(axis=0) < LEAST_THERE * max(finite.any(axis=1).sum(), 1))


def near(at: Array, t: Array) -> Booleans:
    """(n,) whether a value of a stream, which has two or more at times (k,), is near each of the times t (n,)."""
    after = np.searchsorted(at, t).clip(1, len(at) - 1)
    away = np.minimum(np.abs(at[after] - t), np.abs(t - at[after - 1]))
    return np.asarray(away < max(_NEAR, _NEAR_PERIODS * float(np.median(np.diff(at)))))


def up_by_imu(
    imu: list[tuple[int, Array]], start_ns: int, t: Array, robot: Robot, frame: str, q: Array
) -> tuple[Array | None, Booleans]:
    """(n, 3) the direction against gravity, in the root link's frame, at the grid's times; where the IMU is there."""
    nowhere = np.zeros(len(t), dtype=bool)
    if len(imu) < 10:
        return None, nowhere
    at = np.array([(stamp - start_ns) * 1e-9 for stamp, _ in imu])
    inside = (at > t[0] - 1.0) & (at < t[-1] + 1.0)  # a stamp far in the future would make all later ones too old
    at, imu = at[inside], [each for each, kept in zip(imu, inside, strict=True) if kept]
    keep = rising(at)
    if keep.sum() < 10:
        return None, nowhere
    slerp = Slerp(at[keep], Rotation.from_quat(np.array([x for _, x in imu])[keep]))
    up = slerp(np.clip(t, at[keep][0], at[keep][-1])).as_matrix()[:, 2, :]
    sensor = robot.sensor_frame(frame)
    if sensor is None:
        return None, nowhere
    posture, still, R = robot.posture(), np.zeros(q.shape[1]), np.empty((len(t), 3, 3))
    for i, each in enumerate(q):
        posture.update(each, still)
        R[i] = posture.orientation(sensor)
    return np.asarray(np.einsum("nij,nj->ni", R, up)), near(at[keep], t)
