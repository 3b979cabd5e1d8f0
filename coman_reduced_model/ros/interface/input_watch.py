# SPDX-License-Identifier: BSD-3-Clause
"""Says in the console which inputs are missing: /diagnostics is not what people look at first."""

from __future__ import annotations

import time
from dataclasses import dataclass

from rclpy.clock import Clock, ClockType

from ...core.streams.expected import why_expected
from ...topics import DESCRIPTION, INPUT_TOPICS
from .diagnostics import PredictingNode

MISSING_S = 5.0  # [s] without a usable message: a line
_EVERY_S = 0.5


@dataclass
class _Input:
    """Messages of one input, and when the last usable one came (time.monotonic) [s]."""

    accepted: int
    received: int  # when the last usable one came
    last: float
    missing: bool = False  # a line said so


class InputWatch:
    """One line when inputs that the predictions need have been missing for 5 s, and one when they are there again."""

    def __init__(self, node: PredictingNode) -> None:
        self._node = node
        self._inputs: dict[str, _Input] = {}
        self._timer = node.create_timer(_EVERY_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _look(self) -> None:
        now, missing, back = time.monotonic(), [], []
        counts = self._counts()
        for name, (accepted, received) in counts.items():
            each = self._inputs.setdefault(name, _Input(accepted, received, now))
            if accepted != each.accepted:
                if each.missing:
                    back.append(self._topic(name))
                self._inputs[name] = _Input(accepted, received, now)
            elif now - each.last > MISSING_S and not each.missing:
                each.missing = True
                missing.append(f"{self._topic(name)} ({self._reason(name, received > each.received)})")
        if missing:
            self._node.get_logger().warning(f"no usable message for {MISSING_S:.0f} s on {', '.join(missing)}")
        if back:
            self._node.get_logger().info(f"messages again on {', '.join(back)}")

    def _counts(self) -> dict[str, tuple[int, int]]:
        """Usable and received messages so far, by input that is needed now."""
        pipeline = self._node.pipeline
        if pipeline is not None:
            streams = pipeline.streams().values()
            return {each.name: (each.accepted, each.received) for each in streams if each.expected}
        return {DESCRIPTION: (0, 0)} if self._node.description.waiting else {}

    def _topic(self, name: str) -> str:
        return str(self._node.resolve_topic_name(INPUT_TOPICS.get(name, name)))

    def _reason(self, name: str, rejected: bool) -> str:
        if rejected and self._node.pipeline is not None:
            last = self._node.pipeline.joiner.rejections.last
            return "; ".join(sentence for reason, sentence in last.items() if reason.startswith(f"{name}/"))
        count = self._node.count_publishers(self._topic(name))
        publishers = f"{count or 'no'} publisher{'s' if count > 1 else ''}"
        why = why_expected(name, self._node.config)
        return f"{publishers}; wanted by {why}" if why else publishers
