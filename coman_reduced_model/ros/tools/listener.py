# SPDX-License-Identifier: BSD-3-Clause
"""Listens to what the nodes publish, in a thread of its own: com/prediction and /diagnostics."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import rclpy
from coman_reduced_model_msgs.msg import ComPrediction, ComReference
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ...core.base.stream_names import REFERENCE
from ...topics import PREDICTION
from ..interface import qos
from ..interface.diagnostic_report import Report


class Listener:
    """A node that listens. Use it in a `with` statement.

    Attributes:
        node: for publishers and clients of one's own.
        reports: by name, the last of each status on /diagnostics.
    """

    def __init__(
        self, name: str, on_prediction: Callable[[bytes], None], on_reference: Callable[[bytes], None] | None = None
    ) -> None:
        """They are called with each serialised com/prediction and com/reference, in the listener's thread."""
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name)
        self.reports: dict[str, Report] = {}
        self.node.create_subscription(ComPrediction, PREDICTION, on_prediction, qos.prediction_output(), raw=True)
        if on_reference is not None:
            self.node.create_subscription(ComReference, REFERENCE, on_reference, qos.sensor_input(), raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.display_output())
        self._executor: Any = EventsExecutor()
        self._executor.add_node(self.node)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.reports[status.name] = Report.of(status)

    def _spin(self) -> None:
        while not self._ends.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def report(self, status: str) -> Report:
        """The last of one status; empty if there was none."""
        return self.reports.get(status, Report())

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join(5.0)
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()
