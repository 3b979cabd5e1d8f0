# SPDX-License-Identifier: BSD-3-Clause
"""Plays a bag into ROS 2 in its own time, with /clock: what `coman replay` and `coman demo` do.

Messages go out as the bytes that they are in the bag, so that live and offline see the same bits.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from ...bag.reader import Bag
from ...errors import BagError, ComanError
from ...topics import DESCRIPTION
from ..interface import qos

_CLOCK_NS = 5_000_000  # /clock at 200 Hz or more, so that timers in the bag's time are on time
_AT_ONCE = (DESCRIPTION, "tf_static")
_LATCHED = (*_AT_ONCE, "reference_path")
_SLEEP_NS = 200_000  # less is not worth asking the scheduler for


def _profile(topic: str, count: int) -> QoSProfile:
    """Of a topic with so many messages, in any namespace: each publisher of static transforms has sent some of them."""
    name = topic.rpartition("/")[2]
    if name not in _LATCHED:
        return qos.sensor_output()
    return qos.latched(max(count, 1) if name == "tf_static" else 1)


@dataclass
class Progress:
    """How far the replay is."""

    messages: int = 0  # sent
    total: int = 0  # in one pass
    loops: int = 0  # passes begun
    lag_s: float = 0.0  # how late the last message was
    max_lag_s: float = 0.0
    skipped: dict[str, str] = field(default_factory=dict)  # topics not played, and why


class Replay:
    """Publishers for the topics of a bag."""

    def __init__(self, node: Node, path: str | Path, exclude: Collection[str] = ()) -> None:
        """Open the bag and advertise its topics; robot_description and tf_static are sent at once.

        Args:
            node: publishes; topics are made relative to its namespace.
            path: of the bag.
            exclude: topics that are not played, without leading slash.

        Raises:
            BagError: the bag cannot be read, or no topic of it can be played.
        """
        self.bag = Bag(path)
        self.progress = Progress()
        self._node = node
        self._publishers: dict[str, Publisher] = {}
        self._clock = node.create_publisher(Clock, "/clock", qos.clock_output())
        for topic, kind in sorted(self.bag.topics.items()):
            name = topic.lstrip("/")
            if name in (*exclude, "clock"):
                continue
            try:
                package, _, short = kind.split("/")
                found = getattr(importlib.import_module(f"{package}.msg"), short)
            except (ImportError, AttributeError, ValueError):
                self.progress.skipped[topic] = f"its type {kind} is not installed"
                continue
            try:
                self._publishers[topic] = node.create_publisher(
                    found, name, _profile(name, self.bag.counts[topic]), qos_overriding_options=qos.overridable()
                )
            except NameValidationException:  # other recorders allow more
                self.progress.skipped[topic] = "it is no name of a ROS 2 topic"
        if not self._publishers:
            raise BagError(f"{path}: no topic to play; topics of the bag: {', '.join(self.bag.topics)}")
        at_once = [topic for topic in self._publishers if topic.rpartition("/")[2] in _AT_ONCE]
        self._played = [topic for topic in self._publishers if topic not in at_once]
        self.progress.total = sum(self.bag.counts[topic] for topic in self._played)
        for topic, _, raw in self.bag.raw(at_once):
            self._publishers[topic].publish(raw)

    def has(self, topic: str) -> bool:
        """Whether a topic (without leading slash) is played."""
        return f"/{topic}" in self._publishers or topic in self._publishers

    def subscribers(self, topic: str) -> int:
        """How many subscriptions a topic of the bag (without leading slash) has been matched with."""
        publisher = self._publishers.get(f"/{topic}") or self._publishers.get(topic)
        return publisher.get_subscription_count() if publisher else 0

    def wait_for_subscribers(
        self, topics: Collection[str], timeout_s: float, keep_waiting: Callable[[], bool] = lambda: True
    ) -> bool:
        """Wait until each of the topics has a subscriber, and until nothing more matches for 0.3 s.

        Returns:
            False if `keep_waiting` said so.

        Raises:
            ComanError: they were not there in time; names those that nobody listens to.
        """
        deadline = time.monotonic() + timeout_s
        settled, since = -1, 0.0
        while keep_waiting():
            now = time.monotonic()
            missing = [topic for topic in topics if not self.subscribers(topic)]
            matched = sum(publisher.get_subscription_count() for publisher in self._publishers.values())
            if matched != settled:
                settled, since = matched, now
            if not missing and now - since > 0.3:
                return True
            if now > deadline:
                raise ComanError(f"nobody listens to {', '.join(missing or topics)} after {timeout_s:g} s")
            time.sleep(0.02)
        return False

    def play(
        self,
        rate: float = 1.0,
        loop: bool = False,
        keep_going: Callable[[Progress], bool] = lambda progress: True,
    ) -> Progress:
        """Play the bag in the order and with the timing of its log times.

        Args:
            rate: times as fast as recorded; 0: as fast as possible, which only reliable subscribers survive.
            loop: begin again at the end, for ever.
            keep_going: asked before every message; False ends the replay.

        Returns:
            The state at the end.
        """
        while self._pass(rate, keep_going) and loop:
            pass
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=2.0))
        return self.progress

    def close(self) -> None:
        """Close the bag."""
        self.bag.close()

    def _pass(self, rate: float, keep_going: Callable[[Progress], bool]) -> bool:
        progress = self.progress
        progress.loops += 1
        start: int | None = None
        wall = clock_at = 0
        for topic, stamp, raw in self.bag.raw(self._played):
            if start is None:
                start, wall, clock_at = stamp, time.monotonic_ns(), stamp
            while clock_at <= stamp:  # a gap in the bag is no gap in time
                if not self._wait(wall, clock_at - start, rate, keep_going):
                    return False
                self._send_clock(clock_at)
                clock_at += _CLOCK_NS
            if not self._wait(wall, stamp - start, rate, keep_going):
                return False
            self._publishers[topic].publish(raw)
            progress.messages += 1
        return True

    def _wait(self, wall: int, elapsed: int, rate: float, keep_going: Callable[[Progress], bool]) -> bool:
        """Until it is time; False if the replay is to end."""
        if not keep_going(self.progress):
            return False
        if rate <= 0.0:
            return True
        due = wall + round(elapsed / rate)
        while (left := due - time.monotonic_ns()) > _SLEEP_NS:
            time.sleep(min(left * 1e-9, 0.1))
            if left > 100_000_000 and not keep_going(self.progress):
                return False
        self.progress.lag_s = max(0.0, -left * 1e-9)
        self.progress.max_lag_s = max(self.progress.max_lag_s, self.progress.lag_s)
        return True

    def _send_clock(self, stamp: int) -> None:
        message: Any = Clock()
        message.clock.sec, message.clock.nanosec = divmod(stamp, 1_000_000_000)
        self._clock.publish(message)
