# SPDX-License-Identifier: BSD-3-Clause
"""Predictions straight to serialised messages (CDR), for what goes out with every joint state.

See layout.py.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ..core.base.pose import quaternion
from ..core.base.types import Array, Prediction
from ..messages import ODOM, UNKNOWN, external_covariance
from .layout import LITTLE_ENDIAN, SECOND, Layout, cdr_string, header_values


@lru_cache(maxsize=64)
def _support_format(frame: bytes) -> struct.Struct:
    return struct.Struct(Layout().header(frame).add("B", 2).add("d", 3).format)


@lru_cache(maxsize=64)
def _prediction_format(frame: bytes, horizons: int) -> struct.Struct:
    layout = Layout().header(frame).header(frame).add("B", 2).add("d", 3 + 7 * 3 + 7).add("I")
    if horizons:
        layout.add("d", 16 * horizons)
    return struct.Struct(layout.add("I").add("d", 9 + 3 + 3 + 36 + 9 + 1 + 3 + 9 + 4 + 3 + 36).add("B").format)


@lru_cache(maxsize=64)
def _point_format(frame: bytes) -> struct.Struct:
    return struct.Struct(Layout().header(frame).add("d", 3).format)


@lru_cache(maxsize=4)
def _pose(matrix: bytes) -> tuple[float, ...]:
    """Position and quaternion of (4, 4): the same as long as the support foot is."""
    T = np.frombuffer(matrix).reshape(4, 4)
    return (*T[:3, 3].tolist(), *quaternion(T[:3, :3]))


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
        *prediction.estimate.moment.tolist(),
        *external_covariance(prediction).tolist(),
    )


@lru_cache(maxsize=64)
def _deflection_format(frame: bytes, names: tuple[bytes, ...], moments: int) -> struct.Struct:
    layout = Layout().header(frame).add("B").add("I")
    for name in names:
        layout.add("I").add("s", len(name))
    layout.add("I")
    for _ in range(moments):
        layout.add("d", 7).add("I").add("d", len(names)).add("I").add("d", len(names))
    return struct.Struct(layout.add("B").format)


def encode_deflection(prediction: Prediction, names: tuple[bytes, ...]) -> bytes:
    """A ComDeflection; messages.deflection_to, serialised. `names` of the joints end with a zero byte."""
    frame, count = cdr_string(prediction.frame_id), len(names)
    values: list[float | bytes] = [prediction.repeating, count]
    for name in names:
        values += [len(name), name]
    values.append(len(prediction.deflections))
    for each in prediction.deflections:
        values += [each.h, *each.com.tolist(), *each.com_sigma.tolist()]
        values += [count, *each.joints.tolist(), count, *each.joint_sigma.tolist()]
    values.append(prediction.stepping)
    return LITTLE_ENDIAN + _deflection_format(frame, names, len(prediction.deflections)).pack(
        *header_values(prediction.stamp_ns, frame), *values
    )


def encode_prediction(prediction: Prediction) -> bytes:
    """A ComPrediction; messages.prediction_to, serialised."""
    p, s, T = prediction, prediction.support, prediction.T_odom_sole
    trunk = p.estimate.trunk
    frame = cdr_string(p.frame_id)
    header = header_values(p.stamp_ns, frame)
    ahead = [
        value
        for each in p.horizons
        for value in (each.h, *each.com.tolist(), *each.covariance.ravel().tolist(), *each.model_share.tolist())
    ]
    return LITTLE_ENDIAN + _prediction_format(frame, len(p.horizons)).pack(
        *header,
        *header,
        s.phase,
        s.support_foot,
        s.left_share,
        s.phase_time,
        s.total_force,
        *p.measured_com.tolist(),
        *p.measured_com_vel.tolist(),
        *p.reference_com.tolist(),
        *p.reference_com_vel.tolist(),
        *p.predicted_com.tolist(),
        *p.predicted_com_vel.tolist(),
        *p.residual.tolist(),
        *_pose(T.tobytes()),
        len(p.horizons),
        *ahead,
        p.flags,
        *p.predicted_covariance.ravel().tolist(),
        *p.estimate.com.tolist(),
        *p.estimate.com_vel.tolist(),
        *p.estimate.covariance.ravel().tolist(),
        *p.estimate.measured_covariance.ravel().tolist(),
        p.estimate.nis,
        *p.estimate.ground_vel.tolist(),
        *p.estimate.ground_vel_covariance.ravel().tolist(),
        *quaternion(trunk.R),
        *trunk.angular_velocity.tolist(),
        *trunk.covariance.ravel().tolist(),
        trunk.by_imu,
    )
