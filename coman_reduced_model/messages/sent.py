# SPDX-License-Identifier: BSD-3-Clause
"""Types of the core to messages."""

from __future__ import annotations

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
    support = prediction.support
    return types.SupportState(
        header=header_to(types, prediction.stamp_ns, prediction.frame_id),
        phase=int(support.phase),
        support_foot=int(support.support_foot),
        left_share=float(support.left_share),
        phase_time=float(support.phase_time),
        total_force=float(support.total_force),
    )


def prediction_to(types: MessageTypes, prediction: Prediction) -> Any:
    """A ComPrediction; bag.encode packs the same four times as fast."""
    p, estimate = prediction, prediction.estimate
    return types.ComPrediction(
        header=header_to(types, p.stamp_ns, p.frame_id),
        support=support_to(types, p),
        measured_position=_vector(types.Point, p.measured_com),
        measured_velocity=_vector(types.Vector3, p.measured_com_vel),
        reference_position=_vector(types.Point, p.reference_com),
        reference_velocity=_vector(types.Vector3, p.reference_com_vel),
        predicted_position=_vector(types.Point, p.predicted_com),
        predicted_velocity=_vector(types.Vector3, p.predicted_com_vel),
        residual=_vector(types.Vector3, p.residual),
        sole_pose=pose_to(types, p.T_odom_sole),
        horizons=[
            types.HorizonPrediction(
                h=float(each.h),
                position=_vector(types.Point, each.com),
                covariance=each.covariance.ravel(),
                model_share=_vector(types.Vector3, each.model_share),
            )
            for each in p.horizons
        ],
        flags=int(p.flags),
        predicted_covariance=p.predicted_covariance.ravel(),
        estimated_position=_vector(types.Point, estimate.com),
        estimated_velocity=_vector(types.Vector3, estimate.com_vel),
        estimated_covariance=estimate.covariance.ravel(),
        measured_covariance=estimate.measured_covariance.ravel(),
        nis=float(estimate.nis),
        estimated_ground_velocity=_vector(types.Vector3, estimate.ground_vel),
        estimated_ground_velocity_covariance=estimate.ground_vel_covariance.ravel(),
        estimated_orientation=types.Quaternion(**dict(zip("xyzw", quaternion(estimate.trunk.R), strict=True))),
        estimated_angular_velocity=_vector(types.Vector3, estimate.trunk.angular_velocity),
        estimated_rotation_covariance=estimate.trunk.covariance.ravel(),
        estimated_by_imu=bool(estimate.trunk.by_imu),
    )


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
        stepping=prediction.stepping,
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


def external_wrench_to(types: MessageTypes, prediction: Prediction) -> Any:
    """An ExternalWrench."""
    return types.ExternalWrench(
        header=header_to(types, prediction.stamp_ns, prediction.frame_id),
        wrench=types.Wrench(
            force=_vector(types.Vector3, prediction.estimate.force),
            torque=_vector(types.Vector3, prediction.estimate.moment),
        ),
        covariance=external_covariance(prediction),
    )


def external_covariance(prediction: Prediction) -> Array:
    """(36,) of an ExternalWrench [N^2], [N Nm], [Nm^2], row by row."""
    out, estimate = np.empty((6, 6)), prediction.estimate
    out[:3, :3], out[3:, :3] = estimate.force_covariance, estimate.moment_covariance[:3].T
    out[:, 3:] = estimate.moment_covariance
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
    steps = reference.steps
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
        preview_soles=types.doubles(np.empty(0) if steps is None else steps.soles.ravel()),
        preview_phase=np.array(() if steps is None else steps.phase, dtype=np.uint8),
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


def pose_to(types: MessageTypes, T: Array) -> Any:
    """A geometry_msgs/Pose; NaN throughout where the pose is not known."""
    x, y, z, w = quaternion(T[:3, :3])
    return types.Pose(position=_vector(types.Point, T[:3, 3]), orientation=types.Quaternion(x=x, y=y, z=z, w=w))
