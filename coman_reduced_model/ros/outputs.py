# SPDX-License-Identifier: BSD-3-Clause
"""The output topics of the predictor: com/prediction for every joint state, the rest as often as people can look."""

from __future__ import annotations

import numpy as np
from coman_reduced_model_msgs.msg import ComPrediction, SupportState
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from ..core.config import Config
from ..core.types import Array, Prediction
from ..messages import MessageTypes, point_to, prediction_to, support_to
from . import qos
from .markers import Markers


class Outputs:
    """Publishes predictions. Rates are in the time of the stamps, so that a bag played faster looks the same."""

    def __init__(self, node: Node, config: Config, types: MessageTypes) -> None:
        def publisher(kind: type, topic: str, profile):
            return node.create_publisher(kind, topic, profile, qos_overriding_options=qos.overridable())

        self._types = types
        self._prediction = publisher(ComPrediction, "com/prediction", qos.prediction_output())
        self._support = publisher(SupportState, "com/support", qos.display_output())
        self._points = [
            publisher(PointStamped, topic, qos.display_output())
            for topic in ("com/measured", "com/predicted", "com/reference_point")
        ]
        self._marker_array = publisher(MarkerArray, "com/markers", qos.display_output())
        self._markers = Markers(config)
        self._every_points = _Every(config.output.points_rate)
        self._every_markers = _Every(config.output.markers_rate)
        self._last_support: tuple[int, int] | None = None

    def publish(self, prediction: Prediction) -> None:
        """Publish one prediction."""
        self._prediction.publish(prediction_to(self._types, prediction))
        support = prediction.support
        changed = self._last_support != (support.phase, support.support_foot)
        due = self._every_points.due(prediction.stamp_ns)
        if changed or due:
            self._last_support = (support.phase, support.support_foot)
            self._support.publish(support_to(self._types, prediction))
        if due:
            self._publish_points(prediction)
        if self._every_markers.due(prediction.stamp_ns) and self._marker_array.get_subscription_count():
            self._marker_array.publish(self._markers.of(prediction))

    def _publish_points(self, prediction: Prediction) -> None:
        places = (prediction.measured_com, prediction.predicted_com, prediction.reference_com)
        for publisher, place in zip(self._points, places, strict=True):
            if publisher.get_subscription_count():
                point = in_odom(prediction.T_odom_sole, place)
                if np.isfinite(point).all():  # displays choke on NaN
                    publisher.publish(point_to(self._types, prediction.stamp_ns, point))


def in_odom(T_odom_sole: Array, point: Array) -> Array:
    """A point (3,) of the support sole's frame in `odom` [m]."""
    return T_odom_sole[:3, :3] @ point + T_odom_sole[:3, 3]


class _Every:
    """True at most `rate` times a second of stamps; never for a rate of 0."""

    def __init__(self, rate: float) -> None:
        self._interval = round(1e9 / rate) if rate > 0.0 else 0
        self._last = 0

    def due(self, stamp_ns: int) -> bool:
        if not self._interval or 0 <= stamp_ns - self._last < self._interval:
            return False
        # On a grid, so that 1 kHz joint states give 30 Hz and not 29.4.
        self._last = stamp_ns - stamp_ns % self._interval
        return True
