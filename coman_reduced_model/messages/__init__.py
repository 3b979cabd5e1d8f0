# SPDX-License-Identifier: BSD-3-Clause
"""ROS messages to and from the types of the core: the one place that knows their fields.

Every function serves the classes of rclpy and those that rosbags makes from message definitions alike. What makes
messages takes a `MessageTypes`: `ros_types()` for rclpy, `bag.types.bag_types()` for bags.
"""

from .received import (
    FROM,
    imu_from,
    joint_from,
    known_orientation,
    matrix_from,
    plan,
    prediction_from,
    reference_from,
    stamp_of,
    wrench_from,
)
from .sent import header_to, imu_to, joint_to, point_to, pose_to, prediction_to, reference_to, support_to, wrench_to
from .types import (
    COM_PREDICTION,
    COM_REFERENCE,
    IMU_TYPE,
    INPUT_TYPES,
    JOINT_STATE,
    ODOM,
    OWN,
    POINT_STAMPED,
    STRING,
    SUPPORT_STATE,
    WRENCH_STAMPED,
    MessageTypes,
    foot_of,
    ros_types,
)

__all__ = [
    "COM_PREDICTION",
    "COM_REFERENCE",
    "FROM",
    "IMU_TYPE",
    "INPUT_TYPES",
    "JOINT_STATE",
    "MessageTypes",
    "ODOM",
    "OWN",
    "POINT_STAMPED",
    "STRING",
    "SUPPORT_STATE",
    "WRENCH_STAMPED",
    "foot_of",
    "header_to",
    "imu_from",
    "imu_to",
    "joint_from",
    "joint_to",
    "known_orientation",
    "matrix_from",
    "plan",
    "point_to",
    "pose_to",
    "prediction_from",
    "prediction_to",
    "reference_from",
    "reference_to",
    "ros_types",
    "stamp_of",
    "support_to",
    "wrench_from",
    "wrench_to",
]
