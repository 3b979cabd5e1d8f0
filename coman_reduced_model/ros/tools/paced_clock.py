# SPDX-License-Identifier: BSD-3-Clause
"""Simulated time that no node falls behind."""

from __future__ import annotations

import time

from rclpy.clock import Clock as SteadyClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ...core.base.stream_names import JOINTS
from ...messages import stamp_of
from ..interface import qos

_AHEAD_NS = 150_000_000  # of the slowest; the virtual robot lives 90 ms in the past, and publishes for some more
_FIRST_NS = 500_000_000  # without waiting for anyone: nobody begins before there is time
_LOST_S = 1.0  # so long it waits, since messages may be lost
_STEP_NS = 5_000_000
_LOST_STEP_NS = 50_000_000  # a robot that is put somewhere begins 0.3 s ahead


class PacedClock:
    """Publishes /clock, which waits for the virtual robot and, once it predicts, for the predictor.

    On a machine that is too slow for real time, time itself goes slower, and what the nodes do stays the same.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._last = node, 0
        self._publisher = node.create_publisher(Clock, "/clock", qos.clock_output())
        self._now = self._robot = 0  # [ns]
        self._predicted: int | None = None
        self._advanced = time.monotonic()
        node.create_subscription(JointState, JOINTS, self._on_joint_states, qos.sensor_input())

    def _on_joint_states(self, message: JointState) -> None:
        self._robot = stamp_of(message.header)

    def on_prediction(self, stamp_ns: int) -> None:
        """The predictor has come so far."""
        self._predicted = stamp_ns

    def follow_real_time(self) -> None:
        """Advance by itself from now on, at the rate of real time where no one is behind."""
        self._last = time.monotonic_ns()
        self._node.create_timer(_STEP_NS * 1e-9, self._tick, clock=SteadyClock(clock_type=ClockType.STEADY_TIME))

    def _tick(self) -> None:
        last, self._last = self._last, time.monotonic_ns()
        self.advance(self._last - last)

    def advance(self, step_ns: int = _STEP_NS) -> None:
        """Go on by a step [ns], unless someone is behind; then by 50 ms once a second."""
        slowest = self._robot if self._predicted is None else min(self._robot, self._predicted)
        step_ns = min(step_ns, max(slowest + _AHEAD_NS, _FIRST_NS) - self._now)
        now = time.monotonic()
        if step_ns <= 0:
            if now - self._advanced < _LOST_S:
                return
            step_ns = _LOST_STEP_NS
        self._advanced = now
        self._now += step_ns
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self._now, 1_000_000_000)
        self._publisher.publish(message)
