# SPDX-License-Identifier: BSD-3-Clause
"""Types of the core to messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..core.base.pose import quaternion
from ..core.base.types import (
    Array,
    ContactMessage,
    ImuMessage,
    JointMessage,
    PlannedDeflection,
    Prediction,
    Reference,
    SupportState,
    WrenchMessage,
)
from .types import ODOM, MessageTypes


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
    estimate = prediction.estimate
    _fill(message.estimated_position, estimate.com)
    _fill(message.estimated_velocity, estimate.com_vel)
    message.estimated_covariance = estimate.covariance.ravel()
    message.measured_covariance = estimate.measured_covariance.ravel()
    message.nis = float(estimate.nis)
    return message


def deflection_to(types: MessageTypes, prediction: Prediction, joints: Sequence[str]) -> Any:
    """A ComDeflection; `joints` are the names of the joints of both legs, the left leg's first."""
    return types.ComDeflection(
        header=header_to(types, prediction.stamp_ns, prediction.frame_id),
        repeating=prediction.repeating,
        joints=list(joints),
        predictions=[
            types.DeflectionPrediction(
                h=each.h,
                com=_vector(types.Vector3, each.com),
                com_sigma=_vector(types.Vector3, each.com_sigma),
                joints=types.doubles(each.joints),
                joint_sigma=types.doubles(each.joint_sigma),
            )
            for each in prediction.deflections
        ],
    )


def planned_deflection_to(types: MessageTypes, planned: PlannedDeflection, joints: Sequence[str]) -> Any:
    """A sensor_msgs/JointState: deflections [rad] as positions, torques [Nm] as efforts, at the stamp of the plan."""
    return types.JointState(
        header=header_to(types, planned.stamp_ns, ""),
        name=list(joints),
        position=types.doubles(planned.deflection),
        velocity=types.doubles(np.empty(0)),
        effort=types.doubles(planned.torque),
    )


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
        estimated_position=_vector(types.Point, zero),
        estimated_velocity=_vector(types.Vector3, zero),
        estimated_covariance=np.zeros(36),
        measured_covariance=np.zeros(9),
        nis=math.nan,
    )


def external_wrench_to(types: MessageTypes, prediction: Prediction) -> Any:
    """An ExternalWrench; nothing estimates the moment."""
    return types.ExternalWrench(
        header=header_to(types, prediction.stamp_ns, prediction.frame_id),
        wrench=types.Wrench(
            force=_vector(types.Vector3, prediction.estimate.force), torque=_vector(types.Vector3, np.full(3, np.nan))
        ),
        covariance=external_covariance(prediction),
    )


def external_covariance(prediction: Prediction) -> Array:
    """(36,) of an ExternalWrench [N^2]; NaN where the moment takes part."""
    out = np.full((6, 6), np.nan)
    out[:3, :3] = prediction.estimate.force_covariance
    return out.ravel()


def odometry_to(types: MessageTypes, prediction: Prediction, root: str) -> Any:
    """A nav_msgs/Odometry of the root link. Covariances are not known: -1 in front, as in sensor_msgs/Imu."""
    linear, angular = (_vector(types.Vector3, part) for part in np.split(prediction.base_twist, 2))
    return types.Odometry(
        header=header_to(types, prediction.stamp_ns, ODOM),
        child_frame_id=root,
        pose=types.PoseWithCovariance(pose=pose_to(types, prediction.T_odom_base), covariance=UNKNOWN),
        twist=types.TwistWithCovariance(twist=types.Twist(linear=linear, angular=angular), covariance=UNKNOWN),
    )


UNKNOWN = np.array([-1.0] + [0.0] * 35)  # covariance


def transform_to(types: MessageTypes, prediction: Prediction, root: str) -> Any:
    """A geometry_msgs/TransformStamped from `odom` to the root link."""
    pose = pose_to(types, prediction.T_odom_base)
    place = types.Vector3(x=pose.position.x, y=pose.position.y, z=pose.position.z)
    return types.TransformStamped(
        header=header_to(types, prediction.stamp_ns, ODOM),
        child_frame_id=root,
        transform=types.Transform(translation=place, rotation=pose.orientation),
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


def contacts_to(types: MessageTypes, message: ContactMessage) -> Any:
    """A FootContacts."""
    return types.FootContacts(header=header_to(types, message.stamp_ns, ""), left=message.left, right=message.right)


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
