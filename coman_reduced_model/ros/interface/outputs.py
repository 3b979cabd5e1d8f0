# SPDX-License-Identifier: BSD-3-Clause
"""The output topics of the predictor: com/prediction for every joint state, the rest as often as people can look."""

from __future__ import annotations

import numpy as np
from coman_reduced_model_msgs.msg import ComDeflection, ComPrediction, ExternalWrench, SupportState
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from visualization_msgs.msg import MarkerArray

from ...bag.encode import (
    encode_deflection,
    encode_external_wrench,
    encode_point,
    encode_prediction,
    encode_support,
)
from ...core.base.throttle import Throttle
from ...core.base.types import Array, Prediction
from ...core.config.schema import Config
from ...core.robot.robot import Robot
from ...messages import MessageTypes
from ...topics import DEFLECTION, EXTERNAL, MEASURED, PREDICTED, PREDICTION, REFERENCE_POINT, SUPPORT
from . import qos
from .markers import Markers
from .odometry import OdometryOutput


class Outputs:
    """Publishes predictions, serialised as in a bag: message objects that rclpy converts cost four times as much.

    Rates are in the time of the stamps, so that a bag played faster looks the same.
    """

    def __init__(self, node: Node, config: Config, types: MessageTypes) -> None:
        def publisher(kind: type, topic: str, profile: QoSProfile) -> Publisher:
            return node.create_publisher(kind, topic, profile, qos_overriding_options=qos.overridable())

        self._prediction = publisher(ComPrediction, PREDICTION, qos.prediction_output())
        self._deflection = publisher(ComDeflection, DEFLECTION, qos.prediction_output())
        self._joints: tuple[bytes, ...] = ()
        self._support = publisher(SupportState, SUPPORT, qos.display_output())
        self._external = publisher(ExternalWrench, EXTERNAL, qos.display_output())
        self._points = [
            publisher(PointStamped, topic, qos.display_output()) for topic in (MEASURED, PREDICTED, REFERENCE_POINT)
        ]
        self._marker_array = publisher(MarkerArray, "com/markers", qos.display_output())
        self._markers = Markers()
        self.odometry = OdometryOutput(node, config, types)
        self._set_rates(config)
        self._last_support: tuple[int, int] | None = None

    def begin(self, robot: Robot) -> None:
        """Take over the names of a robot."""
        self._joints = tuple(name.encode() + b"\0" for name in robot.config.leg_joints)
        self.odometry.root = robot.root
        self._markers.begin(robot)

    def _set_rates(self, config: Config) -> None:
        self._every_points = Throttle(config.output.points_rate)
        self._every_markers = Throttle(config.output.markers_rate)

    def reconfigure(self, config: Config) -> None:
        """Take over other rates."""
        self._set_rates(config)
        self.odometry.reconfigure(config)

    def publish(self, prediction: Prediction) -> None:
        """Publish one prediction."""
        self._prediction.publish(encode_prediction(prediction))
        if self._deflection.get_subscription_count():
            self._deflection.publish(encode_deflection(prediction, self._joints))
        support = prediction.support
        changed = self._last_support != (support.phase, support.support_foot)
        due = self._every_points.due(prediction.stamp_ns)
        if changed or due:
            self._last_support = (support.phase, support.support_foot)
            self._support.publish(encode_support(prediction))
        if due:
            self._publish_points(prediction)
        self.odometry.publish(prediction)
        if self._every_markers.due(prediction.stamp_ns) and self._marker_array.get_subscription_count():
            self._marker_array.publish(self._markers.of(prediction))

    def _publish_points(self, prediction: Prediction) -> None:
        if np.isfinite(prediction.estimate.force[0]):
            self._external.publish(encode_external_wrench(prediction))
        places = (prediction.measured_com, prediction.predicted_com, prediction.reference_com)
        for publisher, place in zip(self._points, places, strict=True):
            if publisher.get_subscription_count():
                point = in_odom(prediction.T_odom_sole, place)
                if np.isfinite(point).all():  # displays choke on NaN
                    publisher.publish(encode_point(prediction.stamp_ns, point))


def in_odom(T_odom_sole: Array, point: Array) -> Array:
    """A point (3,) of the support sole's frame in `odom` [m]."""
    return T_odom_sole[:3, :3] @ point + T_odom_sole[:3, 3]
