# SPDX-License-Identifier: BSD-3-Clause
"""The predictor: sensor topics in, predicted against measured COM out. `ros2 run coman_reduced_model predictor`."""

from __future__ import annotations

import gc
import importlib
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import Trigger

from ...bag.decode import decoder
from ...core.base.stream_names import REFERENCE
from ...core.config.schema import Config
from ...core.pipeline import Pipeline
from ...core.robot.robot import Robot
from ...messages import INPUT_TYPES, ros_types
from ...topics import DESCRIPTION, INPUT_TOPICS
from ...warm_up import warm_up
from ..interface import qos
from ..interface.description import Description
from ..interface.diagnostics import Diagnostics, PredictingNode
from ..interface.input_watch import InputWatch
from ..interface.outputs import Outputs
from ..interface.parameters import Own, declare
from ..interface.planned import PlannedOutput

NAME = "predictor"
OWN = Own(
    names=(
        "robot.",
        "streams.",
        "support.",
        "model.",
        "prediction.",
        "output.",
        "monitor.",
        "effects.",
        DESCRIPTION,
    ),
    changing=("support.", "output.", "monitor."),
)


class PredictorNode(PredictingNode):
    """Adapter around core.Pipeline; everything that it computes, `coman predict` computes alike."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self.config = declare(self, OWN, self._on_config)
        self.types = ros_types()
        self.pipeline: Pipeline | None = None
        self.todo: Callable[[], None] | None = None
        # First, because a URDF that cannot be read ends the node in one line.
        self.description = Description(self, self.config, self._on_description)
        self.outputs = Outputs(self, self.config, self.types)
        self.planned = PlannedOutput(self, self.config, self.types)
        self.diagnostics = Diagnostics(self)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.input_watch = InputWatch(self)

    def _on_description(self, urdf: str, source: str) -> None:
        self.todo = partial(self._begin, urdf, source)

    def _begin(self, urdf: str, source: str) -> None:
        """Everything that takes time, before the first message is asked for."""
        robot = Robot(urdf, self.config.robot, source)
        started = time.monotonic()
        self.get_logger().info("warming up (the first time on a machine, compiling takes up to a minute)")
        warm_up(robot, self.config, self.types)
        self.pipeline = pipeline = Pipeline(robot, self.config)
        self.outputs.begin(robot)
        gc.collect()
        gc.freeze()  # what lives until the end need not be looked at again: no pauses of 10 ms
        for stream, type_name in INPUT_TYPES.items():
            package, _, short = type_name.split("/")
            kind = getattr(importlib.import_module(f"{package}.msg"), short)
            self.create_subscription(
                kind,
                INPUT_TOPICS[stream],
                # Serialised, as they are in a bag: cheaper than message objects, and decoded by the same code.
                partial(self._on_message, pipeline, stream, decoder(stream)),
                qos.sensor_input(),
                qos_overriding_options=qos.overridable(),
                raw=True,
            )
        self.get_logger().info(
            f"ready: {self.config.robot.name}, {robot.mass:.2f} kg, from {source} "
            f"(warmed up in {time.monotonic() - started:.1f} s)"
        )

    def _on_message(self, pipeline: Pipeline, stream: str, decode: Any, message: bytes) -> None:
        started = time.perf_counter()
        try:
            for prediction in pipeline.feed(stream, message, decode):
                self.outputs.publish(prediction)
                self.diagnostics.on_prediction(prediction, started)
            if stream == REFERENCE:
                self.planned.on_reference(pipeline, message, decode)
        except Exception as error:  # a bug of ours: said and counted, and the node goes on
            self.diagnostics.on_failure(stream, error)
        self.diagnostics.on_message(stream, started)

    def _on_config(self, config: Config) -> None:
        """Parameters that may change at run time have changed: of support phase, monitor and outputs."""
        if self.pipeline is not None:
            self.pipeline.reconfigure(config)
        self.config = config
        self.outputs.reconfigure(config)
        self.diagnostics.reconfigure(config)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.pipeline is not None
        if self.pipeline is None:
            response.message = "predicts nothing yet: " + self.diagnostics.preparing()
        else:
            self.pipeline.reset()
            response.message = "begins again at the next joint state: odom, free run, and what the monitor has learnt"
        return response

    def finish(self) -> None:
        """The end: joint states that still wait for other streams are predicted with what is there."""
        if self.pipeline is not None:
            for prediction in self.pipeline.flush():
                self.outputs.publish(prediction)
