# SPDX-License-Identifier: BSD-3-Clause
"""Predictions straight to serialised messages (CDR), for what goes out some ten times a second.

See layout.py; encode_rows.py has what goes out with every joint state.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

from ..core.base.pose import quaternion
from ..core.base.types import Array, Prediction
from ..messages import ODOM, UNKNOWN, external_covariance
from .layout import LITTLE_ENDIAN, SECOND, Layout, cdr_string, header_values


@lru_cache(maxsize=64)
def _support_format(frame: bytes) -> struct.Struct:
    return struct.Struct(Layout().header(frame).add("B", 2).add("d", 3).format)


@lru_cache(maxsize=64)
def _point_format(frame: bytes) -> struct.Struct:
    return struct.Struct(Layout().header(frame).add("d", 3).format)


def encode_point(stamp_ns: int, point: Array) -> bytes:
    """A geometry_msgs/PointStamped in `odom`; messages.point_to, serialised."""
    frame = cdr_string(ODOM)
    return LITTLE_ENDIAN + _point_format(frame).pack(*header_values(stamp_ns, frame), *point.tolist())


def encode_support(prediction: Prediction) -> bytes:
    """A SupportState; messages.support_to, serialised."""
    frame = cdr_string(prediction.frame_id)
    s = prediction.support
    return LITTLE_ENDIAN + _support_format(frame).pack(
        *header_values(prediction.stamp_ns, frame), s.phase, s.support_foot, s.left_share, s.phase_time, s.total_force
    )


@lru_cache(maxsize=4)
def _odometry_format(frame: bytes, child: bytes) -> struct.Struct:
    layout = Layout().header(frame).add("I").add("s", len(child)).add("d", 7 + 36 + 6 + 36)
    return struct.Struct(layout.format)


def encode_odometry(prediction: Prediction, root: str) -> bytes:
    """A nav_msgs/Odometry; messages.odometry_to, serialised."""
    frame, child, T = cdr_string(ODOM), cdr_string(root), prediction.T_odom_base
    return LITTLE_ENDIAN + _odometry_format(frame, child).pack(
        *header_values(prediction.stamp_ns, frame),
        len(child),
        child,
        *T[:3, 3].tolist(),
        *quaternion(T[:3, :3]),
        *_UNKNOWN,
        *prediction.base_twist.tolist(),
        *_UNKNOWN,
    )


_UNKNOWN = UNKNOWN.tolist()


@lru_cache(maxsize=4)
def _transforms_format(names: tuple[tuple[bytes, bytes], ...]) -> struct.Struct:
    layout = Layout().add("I")
    for frame, child in names:
        layout.header(frame).add("I").add("s", len(child)).add("d", 7)
    return struct.Struct(layout.format)


def encode_transforms(stamp_ns: int, names: Sequence[tuple[str, str]], poses: Array) -> bytes:
    """A tf2_msgs/TFMessage of poses (n, 7), position and quaternion x y z w, of parents and children by name."""
    sec, nanosec = divmod(stamp_ns, SECOND)
    frames = tuple((cdr_string(parent), cdr_string(child)) for parent, child in names)
    values: list[float | bytes] = [len(frames)]
    for (frame, child), pose in zip(frames, poses.tolist(), strict=True):
        values += [sec, nanosec, len(frame), frame, len(child), child, *pose]
    return LITTLE_ENDIAN + _transforms_format(frames).pack(*values)


@lru_cache(maxsize=64)
def _wrench_format(frame: bytes) -> struct.Struct:
    return struct.Struct(Layout().header(frame).add("d", 6 + 36).format)


def encode_external_wrench(prediction: Prediction) -> bytes:
    """An ExternalWrench; messages.external_wrench_to, serialised."""
    frame = cdr_string(prediction.frame_id)
    return LITTLE_ENDIAN + _wrench_format(frame).pack(
        *header_values(prediction.stamp_ns, frame),
        *prediction.estimate.force.tolist(),
        *_NO_MOMENT,
        *external_covariance(prediction).tolist(),
    )


_NO_MOMENT = [float("nan")] * 3
