# SPDX-License-Identifier: BSD-3-Clause
"""com/planned_deflection: the feedforward of the plan, a message for each point of com/reference that is used."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState

from ...core.config.schema import Config
from ...core.feedforward.feedforward import Feedforward
from ...core.pipeline import Pipeline
from ...core.streams.stream import Refused
from ...messages import MessageTypes, planned_deflection_to
from ...topics import PLANNED_DEFLECTION
from . import qos


class PlannedOutput:
    """Computes and publishes planned deflections while someone listens."""

    def __init__(self, node: Node, config: Config, types: MessageTypes) -> None:
        self._types, self._config = types, config
        self._publisher = node.create_publisher(
            JointState, PLANNED_DEFLECTION, qos.prediction_output(), qos_overriding_options=qos.overridable()
        )
        self._feedforward: Feedforward | None = None
        self._joints: tuple[str, ...] = ()

    def on_reference(self, pipeline: Pipeline, message: bytes, decode: Any) -> None:
        """Take a point of the plan, which the pipeline has taken as well; it counts those that are refused."""
        sample = pipeline.predictor.sample
        if sample is None or not self._publisher.get_subscription_count():
            return
        if self._feedforward is None:
            self._joints = pipeline.robot.config.leg_joints
            self._feedforward = Feedforward(pipeline.unloaded, self._config)
            self._feedforward.start(sample.q)
        try:
            planned = self._feedforward.update(decode(message))
        except Refused:
            return
        if planned is not None:
            self._publisher.publish(planned_deflection_to(self._types, planned, self._joints))
