# SPDX-License-Identifier: BSD-3-Clause
"""Predictions by the hundred to serialised messages (CDR), for what goes out with every joint state: rows of bytes.

Predictions in a row whose messages have the same layout are written together: those of one support foot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.base.pose import quaternion
from ..core.base.types import Array, Integers, Prediction
from .layout import Rows, cdr_string

Encoded = NDArray[np.uint8]  # (n, size)


def alike(predictions: Sequence[Prediction]) -> Iterator[list[Prediction]]:
    """Predictions in runs whose messages have the same layout."""
    for _, run in groupby(predictions, lambda each: (each.frame_id, len(each.horizons), len(each.deflections))):
        yield list(run)


def stamps(predictions: Sequence[Prediction]) -> Integers:
    """(n,) [ns]."""
    return np.array([each.stamp_ns for each in predictions], dtype=np.int64)


@lru_cache(maxsize=4)
def _pose(matrix: bytes) -> tuple[float, ...]:
    """Position and quaternion of (4, 4): the same as long as the support foot is."""
    T = np.frombuffer(matrix).reshape(4, 4)
    return (*T[:3, 3].tolist(), *quaternion(T[:3, :3]))


@lru_cache(maxsize=16)
def _prediction_layout(frame: str, horizons: int) -> Rows:
    rows = Rows().header(cdr_string(frame)).header(cdr_string(frame), "support_stamp")
    rows.add("phase", "u1").add("foot", "u1").add("load", "<f8", 3)
    for name in ("measured", "measured_vel", "reference", "reference_vel", "predicted", "predicted_vel", "residual"):
        rows.add(name, "<f8", 3)
    rows.add("pose", "<f8", 7).fixed("<u4", horizons)
    for k in range(horizons):
        rows.add(f"h{k}", "<f8").add(f"com{k}", "<f8", 3).add(f"covariance{k}", "<f8", 9).add(f"share{k}", "<f8", 3)
    rows.add("flags", "<u4").add("predicted_covariance", "<f8", 9).add("estimate", "<f8", 3).add("velocity", "<f8", 3)
    return rows.add("estimate_covariance", "<f8", 36).add("measured_covariance", "<f8", 9).add("nis", "<f8")


def prediction_rows(predictions: Sequence[Prediction]) -> Encoded:
    """ComPrediction messages of predictions that are `alike`; messages.prediction_to, serialised."""
    supports, estimates = [p.support for p in predictions], [p.estimate for p in predictions]
    count, horizons = len(predictions), len(predictions[0].horizons)
    values: dict[str, ArrayLike] = {
        "phase": [s.phase for s in supports],
        "foot": [s.support_foot for s in supports],
        "load": [(s.left_share, s.phase_time, s.total_force) for s in supports],
        "measured": _joined([p.measured_com for p in predictions]),
        "measured_vel": _joined([p.measured_com_vel for p in predictions]),
        "reference": _joined([p.reference_com for p in predictions]),
        "reference_vel": _joined([p.reference_com_vel for p in predictions]),
        "predicted": _joined([p.predicted_com for p in predictions]),
        "predicted_vel": _joined([p.predicted_com_vel for p in predictions]),
        "pose": [_pose(p.T_odom_sole.tobytes()) for p in predictions],
        "flags": [int(p.flags) for p in predictions],
        "predicted_covariance": _joined([p.predicted_covariance for p in predictions]),
        "estimate": _joined([e.com for e in estimates]),
        "velocity": _joined([e.com_vel for e in estimates]),
        "estimate_covariance": _joined([e.covariance for e in estimates]),
        "measured_covariance": _joined([e.measured_covariance for e in estimates]),
        "nis": [e.nis for e in estimates],
    }
    values["residual"] = np.subtract(values["measured"], values["predicted"])
    ahead = [each for p in predictions for each in p.horizons]
    if ahead:
        h = np.array([each.h for each in ahead]).reshape(count, horizons)
        com = _joined([each.com for each in ahead]).reshape(count, horizons, 3)
        covariance = _joined([each.covariance for each in ahead]).reshape(count, horizons, 9)
        share = _joined([each.model_share for each in ahead]).reshape(count, horizons, 3)
        for k in range(horizons):
            values |= {
                f"h{k}": h[:, k],
                f"com{k}": com[:, k],
                f"covariance{k}": covariance[:, k],
                f"share{k}": share[:, k],
            }
    return _prediction_layout(predictions[0].frame_id, horizons).filled(stamps(predictions), values)


@lru_cache(maxsize=16)
def _deflection_layout(frame: str, names: tuple[bytes, ...], moments: int) -> Rows:
    rows = Rows().header(cdr_string(frame)).add("repeating", "u1").fixed("<u4", len(names))
    for joint in names:
        rows.string(joint)
    rows.fixed("<u4", moments)
    for k in range(moments):
        rows.add(f"h{k}", "<f8").add(f"com{k}", "<f8", 3).add(f"com_sigma{k}", "<f8", 3)
        for name in ("joints", "joint_sigma"):
            rows.fixed("<u4", len(names)).add(f"{name}{k}", "<f8", len(names))
    return rows


def deflection_rows(predictions: Sequence[Prediction], names: tuple[bytes, ...]) -> Encoded:
    """ComDeflection messages of predictions that are `alike`; messages.deflection_to, serialised.

    `names` of the joints end with a zero byte.
    """
    count, moments = len(predictions), len(predictions[0].deflections)
    values: dict[str, ArrayLike] = {"repeating": [each.repeating for each in predictions]}
    each_of = [each for p in predictions for each in p.deflections]
    if each_of:
        arrays = {
            "h": np.array([each.h for each in each_of]),
            "com": _joined([each.com for each in each_of]),
            "com_sigma": _joined([each.com_sigma for each in each_of]),
            "joints": _joined([each.joints for each in each_of]),
            "joint_sigma": _joined([each.joint_sigma for each in each_of]),
        }
        for name, array in arrays.items():
            by_moment = array.reshape(count, moments, -1)
            values |= {f"{name}{k}": by_moment[:, k] for k in range(moments)}
    return _deflection_layout(predictions[0].frame_id, names, moments).filled(stamps(predictions), values)


def _joined(arrays: list[Array]) -> Array:
    """One after the other along the first axis: an array each costs many times as much to make."""
    return np.concatenate(arrays)
