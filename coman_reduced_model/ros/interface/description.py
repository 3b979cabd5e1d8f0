# SPDX-License-Identifier: BSD-3-Clause
"""Where a node gets the robot's URDF from: parameter, file or latched topic, in this order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rclpy.node import Node
from std_msgs.msg import String

from ...core.config.schema import Config
from ...errors import RobotError
from ...topics import DESCRIPTION
from . import qos


class Description:
    """Calls `found(urdf, source)` once, as soon as the URDF is there; the node works with any order of start."""

    def __init__(self, node: Node, config: Config, found: Callable[[str, str], None]) -> None:
        """Look for the URDF.

        Raises:
            RobotError: the file of `robot.urdf` cannot be read.
        """
        self._node = node
        self._found = found
        self._urdf: str | None = None
        self.waiting = False
        text = str(node.get_parameter(DESCRIPTION).value)
        if text:
            self._take(text, f"parameter {DESCRIPTION}")
        elif config.urdf is not None:
            self._take(_read(config.urdf), str(config.urdf))
        else:
            self.waiting = True
            self.topic = node.resolve_topic_name(DESCRIPTION)
            node.create_subscription(String, DESCRIPTION, self._on_message, qos.latched())
            node.get_logger().info(f"waiting for the URDF on {self.topic} (or give the parameter robot.urdf a file)")

    def _take(self, urdf: str, source: str) -> None:
        self.waiting = False
        self._urdf = urdf
        self._found(urdf, source)

    def _on_message(self, message: String) -> None:
        if self._urdf is None:
            self._take(message.data, self.topic)
        elif message.data != self._urdf:
            self._node.get_logger().warning(f"{self.topic} has changed: restart this node to use the new URDF")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise RobotError(f"robot.urdf: {path} cannot be read: {reason}") from None
