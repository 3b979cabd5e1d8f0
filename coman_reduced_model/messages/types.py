# SPDX-License-Identifier: BSD-3-Clause
"""Names and classes of the messages that come in and go out."""

from __future__ import annotations

import array
import importlib
from collections.abc import Callable
from typing import Any

from ..core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..core.base.types import (
    Array,
    Foot,
)

ODOM = "odom"
OWN = "coman_reduced_model_msgs"
JOINT_STATE, WRENCH_STAMPED, IMU_TYPE = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/Imu",
)
COM_REFERENCE, COM_PREDICTION, SUPPORT_STATE, EXTERNAL_WRENCH, COM_DEFLECTION, FOOT_CONTACTS = (
    f"{OWN}/msg/ComReference",
    f"{OWN}/msg/ComPrediction",
    f"{OWN}/msg/SupportState",
    f"{OWN}/msg/ExternalWrench",
    f"{OWN}/msg/ComDeflection",
    f"{OWN}/msg/FootContacts",
)
POINT_STAMPED, STRING = "geometry_msgs/msg/PointStamped", "std_msgs/msg/String"
ODOMETRY, TRANSFORMS = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"

# What the predictor takes in: relative topic name (which is the stream's name, but for the IMU's) and type.
INPUT_TYPES = {
    JOINTS: JOINT_STATE,
    MOTORS: JOINT_STATE,
    **dict.fromkeys(WRENCHES.values(), WRENCH_STAMPED),
    REFERENCE: COM_REFERENCE,
    IMU: IMU_TYPE,
    CONTACTS: FOOT_CONTACTS,
}


class MessageTypes:
    """Message classes by their short names (`types.Header`), and what a float64[] field takes (`types.doubles`)."""

    _NAMES = (
        "builtin_interfaces/msg/Time",
        "std_msgs/msg/Header",
        "std_msgs/msg/String",
        *(f"geometry_msgs/msg/{name}" for name in ("Point", "Vector3", "Quaternion", "Pose", "PointStamped")),
        *(f"geometry_msgs/msg/{name}" for name in ("Twist", "PoseWithCovariance", "TwistWithCovariance")),
        *(f"geometry_msgs/msg/{name}" for name in ("Transform", "TransformStamped")),
        ODOMETRY,
        *(f"geometry_msgs/msg/{name}" for name in ("Wrench", "WrenchStamped")),
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/Imu",
        *(
            f"{OWN}/msg/{name}"
            for name in ("SupportState", "HorizonPrediction", "ComPrediction", "ComReference", "ExternalWrench")
        ),
        *(f"{OWN}/msg/{name}" for name in ("DeflectionPrediction", "ComDeflection", "FootContacts")),
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


def foot_of(stream: str) -> Foot:
    """The foot whose wrench a stream is; NONE for the others."""
    return next((foot for foot, name in WRENCHES.items() if name == stream), Foot.NONE)
