# SPDX-License-Identifier: BSD-3-Clause
"""Messages to the types of the core."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.base.pose import matrix
from ..core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..core.base.types import (
    Array,
    ContactMessage,
    Estimate,
    Flags,
    Foot,
    HorizonPrediction,
    ImuMessage,
    JointMessage,
    Phase,
    PlannedSteps,
    Prediction,
    Reference,
    SupportState,
    TrunkRotation,
    WrenchMessage,
)
from ..core.streams.stream import Refused
from .types import ODOM


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


def contacts_from(message: Any) -> ContactMessage:
    """A FootContacts."""
    return ContactMessage(stamp_of(message.header), bool(message.left), bool(message.right))


def known_orientation(quaternion: Array, covariance: float) -> Array | None:
    """A quaternion (4,) x y z w; None if the first covariance says so (-1), as the message defines.

    Or if it is no rotation: there are drivers that leave both fields at zero.
    """
    length = math.hypot(*quaternion)
    return quaternion if covariance >= 0.0 and 0.9 < length * length < 1.1 else None


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
        (
            np.asarray(message.preview_position, dtype=np.float64),
            np.asarray(message.preview_velocity, dtype=np.float64),
            np.asarray(getattr(message, "preview_soles", ()), dtype=np.float64),  # older bags lack them
            np.asarray(getattr(message, "preview_phase", ()), dtype=np.uint8),
        ),
    )


def plan(
    stamp_ns: int,
    frame_id: str,
    vectors: tuple[Array, ...],
    soles: tuple[Array, Array],
    phase: int,
    step: int,
    preview_dt: float,
    previews: tuple[Array, Array, Array, NDArray[np.uint8]],
) -> Reference:
    """A Reference of the fields of a ComReference: vectors (3,) in their order, poses (4, 4), previews flat.

    The previews are of positions, velocities, soles and phases.

    Raises:
        Refused: an unknown phase or frame, or previews that do not fit together.
    """
    position, velocity, feet, phases = previews
    if len(position) % 3 or len(position) != len(velocity):
        raise Refused("length", f"{len(position)} numbers of preview positions, {len(velocity)} of velocities")
    if (len(feet) or len(phases)) and not 3 * len(feet) == 14 * len(position) == 42 * len(phases):
        raise Refused("length", f"{len(feet)} numbers of preview soles, {len(phases)} of preview phases")
    if len(position) and not 0.0 < preview_dt < math.inf:
        raise Refused("preview", f"preview_dt {preview_dt} s")
    for each in (phase, *phases[phases > max(_PHASES)].tolist()):
        if each not in _PHASES:
            raise Refused("phase", f"phase {each} is not one of 0 to 3")
    if frame_id.lstrip("/") != ODOM:
        raise Refused("frame", f"it is in frame {frame_id!r}, wanted {ODOM!r}")
    com, com_vel, com_acc, zmp = vectors
    left, right = soles
    ahead, ahead_vel = position.reshape(-1, 3), velocity.reshape(-1, 3)
    steps = None
    if len(phases):
        steps = PlannedSteps(stamp_ns, preview_dt, ahead, feet.reshape(-1, 14), phases.astype(np.int64))
    return Reference(
        stamp_ns, com, com_vel, com_acc, zmp, left, right, _PHASES[phase], step, preview_dt, ahead, ahead_vel,
        steps,
    )  # fmt: skip


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
        estimate=_estimate_from(message),
    )


def _horizon_from(message: Any) -> HorizonPrediction:
    share = getattr(message, "model_share", None)
    return HorizonPrediction(
        message.h,
        _xyz(message.position),
        _covariance_from(message, "covariance"),
        np.full(3, np.nan) if share is None else _xyz(share),
    )


def _estimate_from(message: Any) -> Estimate:
    """Without the external force, which is a message of its own; NaN in messages of earlier versions."""
    if not hasattr(message, "estimated_position"):
        return Estimate()
    return Estimate(
        _xyz(message.estimated_position),
        _xyz(message.estimated_velocity),
        _covariance_from(message, "estimated_covariance", 6),
        _covariance_from(message, "measured_covariance"),
        nis=message.nis,
        trunk=_trunk_from(message),
        ground_vel=_xyz(message.estimated_ground_velocity)
        if hasattr(message, "estimated_ground_velocity")
        else np.full(3, np.nan),
        ground_vel_covariance=_covariance_from(message, "estimated_ground_velocity_covariance"),
    )


def _trunk_from(message: Any) -> TrunkRotation:
    """NaN in messages of earlier versions."""
    if not hasattr(message, "estimated_orientation"):
        return TrunkRotation()
    o = message.estimated_orientation
    return TrunkRotation(
        matrix(0.0, 0.0, 0.0, o.x, o.y, o.z, o.w)[:3, :3],
        _xyz(message.estimated_angular_velocity),
        _covariance_from(message, "estimated_rotation_covariance", 6),
        bool(message.estimated_by_imu),
    )


def _covariance_from(message: Any, name: str, n: int = 3) -> Array:
    """(n, n); NaN in messages of version 1, which have none."""
    values = getattr(message, name, None)
    return np.full((n, n), np.nan) if values is None else np.array(values, dtype=np.float64).reshape(n, n)


FROM = {
    JOINTS: joint_from,
    MOTORS: joint_from,
    **dict.fromkeys(WRENCHES.values(), wrench_from),
    REFERENCE: reference_from,
    IMU: imu_from,
    CONTACTS: contacts_from,
}


def _xyz(value: Any) -> Array:
    return np.array((value.x, value.y, value.z))


def matrix_from(pose: Any) -> Array:
    """(4, 4) of a geometry_msgs/Pose; NaN where its quaternion is zero or not finite."""
    o, p = pose.orientation, pose.position
    return matrix(p.x, p.y, p.z, o.x, o.y, o.z, o.w)
