# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot stands by the odometry of its feet: foot_odometry, and odom -> root link on /tf."""

from __future__ import annotations

import math
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node

from ...core.base.throttle import Throttle
from ...core.base.types import Prediction
from ...core.config.schema import Config
from ...messages import MessageTypes, odometry_to, transform_to
from ...topics import FOOT_ODOMETRY, TF
from . import qos

try:  # no wheels of Jazzy have it; every installation does
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None


class OdometryOutput:
    """Publishes the root link at `output.odometry_rate`; its links below are for robot_state_publisher."""

    def __init__(self, node: Node, config: Config, types: MessageTypes) -> None:
        self.root = ""  # name of the root link, known with the URDF
        self._node, self._types = node, types
        self._odometry = self._publisher(Odometry, FOOT_ODOMETRY)
        self._transforms: Any = None
        self._wanted = False  # to publish transforms
        self.reconfigure(config)

    def _publisher(self, kind: type, topic: str) -> Any:
        options = qos.overridable()
        return self._node.create_publisher(kind, topic, qos.display_output(), qos_overriding_options=options)

    def reconfigure(self, config: Config) -> None:
        """Take over another rate, and begin or end to publish transforms."""
        self._every = Throttle(config.output.odometry_rate)
        if config.output.publish_tf == self._wanted:
            return
        self._wanted = config.output.publish_tf
        if self._wanted and TFMessage is None:
            self._node.get_logger().info("output.publish_tf: tf2_msgs is not installed: no transforms on /tf")
        elif self._wanted:
            self._transforms = self._publisher(TFMessage, TF)
        elif self._transforms is not None:
            self._node.destroy_publisher(self._transforms)
            self._transforms = None

    def publish(self, prediction: Prediction) -> None:
        """Publish where the root link is, if that is due and known."""
        if not self._every.due(prediction.stamp_ns) or not math.isfinite(prediction.base_in_sole[0, 0]):
            return
        if self._odometry.get_subscription_count():
            self._odometry.publish(odometry_to(self._types, prediction, self.root))
        if self._transforms is not None:
            transform = transform_to(self._types, prediction, self.root)
            self._transforms.publish(TFMessage(transforms=[transform]))
