# SPDX-License-Identifier: BSD-3-Clause
"""ROS messages to and from the types of the core: the one place that knows their fields.

Every function serves the classes of rclpy and those that rosbags makes from message definitions alike. What makes
messages takes a `MessageTypes`: `ros_types()` for rclpy, `bag.types.bag_types()` for bags.
"""

from __future__ import annotations

import array
import importlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .core.base.pose import matrix, quaternion
from .core.base.stream_names import IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from .core.base.types import (
    Array,
    Flags,
    Foot,
    HorizonPrediction,
    ImuMessage,
    JointMessage,
    Phase,
    Prediction,
    Reference,
    SupportState,
    WrenchMessage,
)
from .core.streams.stream import Refused

ODOM = "odom"
OWN = "coman_reduced_model_msgs"
JOINT_STATE, WRENCH_STAMPED, IMU_TYPE = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/Imu",
)
COM_REFERENCE, COM_PREDICTION, SUPPORT_STATE = (
    f"{OWN}/msg/ComReference",
    f"{OWN}/msg/ComPrediction",
    f"{OWN}/msg/SupportState",
)
POINT_STAMPED, STRING = "geometry_msgs/msg/PointStamped", "std_msgs/msg/String"

# What the predictor takes in: relative topic name (which is the stream's name, but for the IMU's) and type.
INPUT_TYPES = {
    JOINTS: JOINT_STATE,
    MOTORS: JOINT_STATE,
    **dict.fromkeys(WRENCHES.values(), WRENCH_STAMPED),
    REFERENCE: COM_REFERENCE,
    IMU: IMU_TYPE,
}


class MessageTypes:
    """Message classes by their short names (`types.Header`), and what a float64[] field takes (`types.doubles`)."""

    _NAMES = (
        "builtin_interfaces/msg/Time",
        "std_msgs/msg/Header",
        "std_msgs/msg/String",
        *(f"geometry_msgs/msg/{name}" for name in ("Point", "Vector3", "Quaternion", "Pose", "PointStamped")),
        *(f"geometry_msgs/msg/{name}" for name in ("Wrench", "WrenchStamped")),
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/Imu",
        *(f"{OWN}/msg/{name}" for name in ("SupportState", "HorizonPrediction", "ComPrediction", "ComReference")),
    )

    def __init__(self, find: Callable[[str], type], doubles: Callable[[Array], Any]) -> None:
        self.doubles = doubles
        for name in self._NAMES:
            setattr(self, name.rsplit("/", 1)[-1], find(name))

    def __getattr__(self, name: str) -> Any:  # for type checkers: the classes are set in the constructor
        raise AttributeError(name)


def ros_types() -> MessageTypes:
    """The classes of rclpy; needs ROS 2 and the built messages."""

    def find(name: str) -> type:
        package, _, short = name.split("/")
        found: type = getattr(importlib.import_module(f"{package}.msg"), short)
        return found

    return MessageTypes(find, lambda values: array.array("d", values.tobytes()))


# --- messages to core types ---


def stamp_of(header: Any) -> int:
    """Stamp of a header [ns]."""
    stamp = header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def joint_from(message: Any) -> JointMessage:
    """A sensor_msgs/JointState, link or motor side; empty velocity and effort become None."""
    velocity, effort = message.velocity, message.effort
    return JointMessage(
        stamp_of(message.header),
        tuple(message.name),
        np.asarray(message.position, dtype=np.float64),
        np.asarray(velocity, dtype=np.float64) if len(velocity) else None,
        np.asarray(effort, dtype=np.float64) if len(effort) else None,
    )


def wrench_from(message: Any) -> WrenchMessage:
    """A geometry_msgs/WrenchStamped."""
    wrench = message.wrench
    return WrenchMessage(stamp_of(message.header), message.header.frame_id, _xyz(wrench.force), _xyz(wrench.torque))


def imu_from(message: Any) -> ImuMessage:
    """A sensor_msgs/Imu."""
    o = message.orientation
    return ImuMessage(
        stamp_of(message.header),
        message.header.frame_id,
        known_orientation(np.array((o.x, o.y, o.z, o.w)), message.orientation_covariance[0]),
        _xyz(message.angular_velocity),
        _xyz(message.linear_acceleration),
    )


def known_orientation(quaternion: Array, covariance: float) -> Array | None:
    """A quaternion (4,) x y z w; None if the first covariance says so (-1), as the message defines.

    Or if it is no rotation: there are drivers that leave both fields at zero.
    """
    return quaternion if covariance >= 0.0 and 0.9 < float(quaternion @ quaternion) < 1.1 else None


def reference_from(message: Any) -> Reference:
    """A ComReference.

    Raises:
        Refused: as `plan` does.
    """
    return plan(
        stamp_of(message.header),
        message.header.frame_id,
        tuple(_xyz(each) for each in (message.position, message.velocity, message.acceleration, message.zmp)),
        (matrix_from(message.left_sole), matrix_from(message.right_sole)),
        message.phase,
        message.step,
        message.preview_dt,
        np.asarray(message.preview_position, dtype=np.float64),
        np.asarray(message.preview_velocity, dtype=np.float64),
    )


def plan(
    stamp_ns: int,
    frame_id: str,
    vectors: tuple[Array, ...],
    soles: tuple[Array, Array],
    phase: int,
    step: int,
    preview_dt: float,
    position: Array,
    velocity: Array,
) -> Reference:
    """A Reference of the fields of a ComReference: vectors (3,) in their order, poses (4, 4), previews flat.

    Raises:
        Refused: an unknown phase or frame, or previews that do not fit together.
    """
    if len(position) % 3 or len(position) != len(velocity):
        raise Refused("length", f"{len(position)} numbers of preview positions, {len(velocity)} of velocities")
    if len(position) and not 0.0 < preview_dt < math.inf:
        raise Refused("preview", f"preview_dt {preview_dt} s")
    if phase not in _PHASES:
        raise Refused("phase", f"phase {phase} is not one of 0 to 3")
    if frame_id.lstrip("/") != ODOM:
        raise Refused("frame", f"it is in frame {frame_id!r}, wanted {ODOM!r}")
    com, com_vel, com_acc, zmp = vectors
    left, right = soles
    ahead, ahead_vel = position.reshape(-1, 3), velocity.reshape(-1, 3)
    return Reference(
        stamp_ns, com, com_vel, com_acc, zmp, left, right, _PHASES[phase], step, preview_dt, ahead, ahead_vel
    )


_PHASES = {int(phase): phase for phase in Phase}  # faster than Phase()


def prediction_from(message: Any) -> Prediction:
    """A ComPrediction, for those who judge what a node has published."""
    s = message.support
    return Prediction(
        stamp_of(message.header),
        message.header.frame_id,
        SupportState(Phase(s.phase), Foot(s.support_foot), s.left_share, s.phase_time, s.total_force),
        _xyz(message.measured_position),
        _xyz(message.measured_velocity),
        _xyz(message.reference_position),
        _xyz(message.reference_velocity),
        _xyz(message.predicted_position),
        _xyz(message.predicted_velocity),
        matrix_from(message.sole_pose),
        [_horizon_from(each) for each in message.horizons],
        Flags(message.flags),
        predicted_covariance=_covariance_from(message, "predicted_covariance"),
    )


def _horizon_from(message: Any) -> HorizonPrediction:
    share = getattr(message, "model_share", None)
    return HorizonPrediction(
        message.h,
        _xyz(message.position),
        _covariance_from(message, "covariance"),
        np.full(3, np.nan) if share is None else _xyz(share),
    )


def _covariance_from(message: Any, name: str) -> Array:
    """(3, 3); NaN in messages of version 1, which have none."""
    values = getattr(message, name, None)
    return np.full((3, 3), np.nan) if values is None else np.array(values, dtype=np.float64).reshape(3, 3)


FROM = {
    JOINTS: joint_from,
    MOTORS: joint_from,
    **dict.fromkeys(WRENCHES.values(), wrench_from),
    REFERENCE: reference_from,
    IMU: imu_from,
}


def _xyz(value: Any) -> Array:
    return np.array((value.x, value.y, value.z))


def matrix_from(pose: Any) -> Array:
    """(4, 4) of a geometry_msgs/Pose; NaN where its quaternion is zero or not finite."""
    o, p = pose.orientation, pose.position
    return matrix(p.x, p.y, p.z, o.x, o.y, o.z, o.w)


# --- core types to messages ---


def header_to(types: MessageTypes, stamp_ns: int, frame_id: str) -> Any:
    """A std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return types.Header(stamp=types.Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def point_to(types: MessageTypes, stamp_ns: int, point: Array) -> Any:
    """A geometry_msgs/PointStamped in `odom`, for plots and RViz."""
    return types.PointStamped(header=header_to(types, stamp_ns, ODOM), point=_vector(types.Point, point))


def support_to(types: MessageTypes, prediction: Prediction) -> Any:
    """The SupportState of a prediction, as a message of its own."""
    header = header_to(types, prediction.stamp_ns, prediction.frame_id)
    message = types.SupportState(
        header=header, phase=0, support_foot=0, left_share=math.nan, phase_time=0.0, total_force=math.nan
    )
    _fill_support(message, prediction.support)
    return message


def _fill_support(message: Any, support: SupportState) -> None:
    message.phase = int(support.phase)
    message.support_foot = int(support.support_foot)
    message.left_share = float(support.left_share)
    message.phase_time = float(support.phase_time)
    message.total_force = float(support.total_force)


def prediction_to(types: MessageTypes, prediction: Prediction, into: Any = None) -> Any:
    """A ComPrediction.

    Args:
        types: classes to make it of.
        prediction: what the message is to hold.
        into: a message from an earlier call to fill again: rclpy takes a third of the time for it.
    """
    message = _blank_prediction(types) if into is None else into
    header = message.header
    header.stamp.sec, header.stamp.nanosec = divmod(prediction.stamp_ns, 1_000_000_000)
    header.frame_id = prediction.frame_id
    _fill_support(message.support, prediction.support)  # its header is the same object
    _fill(message.measured_position, prediction.measured_com)
    _fill(message.measured_velocity, prediction.measured_com_vel)
    _fill(message.reference_position, prediction.reference_com)
    _fill(message.reference_velocity, prediction.reference_com_vel)
    _fill(message.predicted_position, prediction.predicted_com)
    _fill(message.predicted_velocity, prediction.predicted_com_vel)
    _fill(message.residual, prediction.residual)
    _fill_pose(message.sole_pose, prediction.T_odom_sole)
    if len(message.horizons) != len(prediction.horizons):
        zero = np.zeros(3)
        message.horizons = [
            types.HorizonPrediction(
                h=0.0,
                position=_vector(types.Point, zero),
                covariance=np.zeros(9),
                model_share=_vector(types.Vector3, zero),
            )
            for _ in prediction.horizons
        ]
    for target, horizon in zip(message.horizons, prediction.horizons, strict=True):
        target.h = float(horizon.h)
        _fill(target.position, horizon.com)
        target.covariance = horizon.covariance.ravel()
        _fill(target.model_share, horizon.model_share)
    message.flags = int(prediction.flags)
    message.predicted_covariance = prediction.predicted_covariance.ravel()
    return message


def _blank_prediction(types: MessageTypes) -> Any:
    zero, identity = np.zeros(3), np.eye(4)
    header = header_to(types, 0, "")
    return types.ComPrediction(
        header=header,
        support=types.SupportState(
            header=header, phase=0, support_foot=0, left_share=math.nan, phase_time=0.0, total_force=math.nan
        ),
        measured_position=_vector(types.Point, zero),
        measured_velocity=_vector(types.Vector3, zero),
        reference_position=_vector(types.Point, zero),
        reference_velocity=_vector(types.Vector3, zero),
        predicted_position=_vector(types.Point, zero),
        predicted_velocity=_vector(types.Vector3, zero),
        residual=_vector(types.Vector3, zero),
        sole_pose=pose_to(types, identity),
        horizons=[],
        flags=0,
        predicted_covariance=np.zeros(9),
    )


def reference_to(types: MessageTypes, reference: Reference) -> Any:
    """A ComReference."""
    return types.ComReference(
        header=header_to(types, reference.stamp_ns, ODOM),
        position=_vector(types.Point, reference.com),
        velocity=_vector(types.Vector3, reference.com_vel),
        acceleration=_vector(types.Vector3, reference.com_acc),
        zmp=_vector(types.Point, reference.zmp),
        left_sole=pose_to(types, reference.T_odom_left),
        right_sole=pose_to(types, reference.T_odom_right),
        phase=int(reference.phase),
        step=int(reference.step),
        preview_dt=float(reference.preview_dt),
        preview_position=types.doubles(np.ascontiguousarray(reference.preview_com, dtype=np.float64).ravel()),
        preview_velocity=types.doubles(np.ascontiguousarray(reference.preview_com_vel, dtype=np.float64).ravel()),
    )


def joint_to(types: MessageTypes, message: JointMessage) -> Any:
    """A sensor_msgs/JointState."""
    empty = np.empty(0)
    return types.JointState(
        header=header_to(types, message.stamp_ns, ""),
        name=list(message.names),
        position=types.doubles(message.position),
        velocity=types.doubles(empty if message.velocity is None else message.velocity),
        effort=types.doubles(empty if message.effort is None else message.effort),
    )


def wrench_to(types: MessageTypes, message: WrenchMessage) -> Any:
    """A geometry_msgs/WrenchStamped."""
    return types.WrenchStamped(
        header=header_to(types, message.stamp_ns, message.frame_id),
        wrench=types.Wrench(force=_vector(types.Vector3, message.force), torque=_vector(types.Vector3, message.torque)),
    )


def imu_to(types: MessageTypes, message: ImuMessage) -> Any:
    """A sensor_msgs/Imu; an unknown orientation is marked with -1, as the message defines."""
    known = message.orientation is not None
    x, y, z, w = message.orientation.tolist() if message.orientation is not None else (0.0, 0.0, 0.0, 1.0)
    return types.Imu(
        header=header_to(types, message.stamp_ns, message.frame_id),
        orientation=types.Quaternion(x=x, y=y, z=z, w=w),
        orientation_covariance=np.array([0.0 if known else -1.0] + [0.0] * 8),
        angular_velocity=_vector(types.Vector3, message.angular_velocity),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=_vector(types.Vector3, message.linear_acceleration),
        linear_acceleration_covariance=np.zeros(9),
    )


def _vector(kind: Callable[..., Any], value: Array) -> Any:
    x, y, z = value.tolist()
    return kind(x=x, y=y, z=z)


def _fill(target: Any, value: Array) -> None:
    target.x, target.y, target.z = value.tolist()


def pose_to(types: MessageTypes, T: Array) -> Any:
    """A geometry_msgs/Pose; NaN throughout where the pose is not known."""
    message = types.Pose(
        position=_vector(types.Point, T[:3, 3]), orientation=types.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    _fill_pose(message, T)
    return message


def _fill_pose(target: Any, T: Array) -> None:
    _fill(target.position, T[:3, 3])
    o = target.orientation
    o.x, o.y, o.z, o.w = quaternion(T[:3, :3])


def foot_of(stream: str) -> Foot:
    """The foot whose wrench a stream is; NONE for the others."""
    return next((foot for foot, name in WRENCHES.items() if name == stream), Foot.NONE)
