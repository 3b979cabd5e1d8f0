# SPDX-License-Identifier: BSD-3-Clause
"""Hears what the nodes publish, in a thread of its own: com/prediction and /diagnostics."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import rclpy
from coman_reduced_model_msgs.msg import ComPrediction
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..topics import PREDICTION
from . import qos


class Listener:
    """A node that listens. Use it in a `with` statement.

    Attributes:
        node: for publishers and clients of one's own.
        statuses: by name, level, message and values of the last /diagnostics.
    """

    def __init__(self, name: str, on_prediction: Callable[[bytes], None]) -> None:
        """`on_prediction` is called with each serialised com/prediction, in the listener's thread."""
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name)
        self.statuses: dict[str, tuple[int, str, dict[str, str]]] = {}
        self.node.create_subscription(ComPrediction, PREDICTION, on_prediction, qos.prediction_output(), raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.display_output())
        self._executor: Any = EventsExecutor()
        self._executor.add_node(self.node)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            self.statuses[status.name] = (ord(status.level), status.message, values)

    def _spin(self) -> None:
        while not self._ends.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def values(self, status: str) -> dict[str, str]:
        """Values of one status of the last /diagnostics; empty if there was none."""
        return self.statuses.get(status, (0, "", {}))[2]

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join(5.0)
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()
