# SPDX-License-Identifier: BSD-3-Clause
"""Hypothesis strategies that spoil a recording: clocks that jump, streams that stop, values that are none."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import strategies as st
from synthetic import LEFT, RIGHT, Message

from coman_reduced_model.core.base.stream_names import JOINTS, MOTORS, REFERENCE

STREAMS = (JOINTS, MOTORS, LEFT, RIGHT, REFERENCE)
_LAST_STAMP = (2**31 - 1) * 10**9  # [ns] that the header of a message can hold
_ARRAYS = {  # fields of the messages of a stream
    JOINTS: ("position", "velocity", "effort"),
    MOTORS: ("position", "velocity"),
    LEFT: ("force", "torque"),
    RIGHT: ("force", "torque"),
    REFERENCE: ("com", "com_vel", "com_acc", "zmp"),
}


@dataclass(frozen=True)
class Mutation:
    """What happens to the messages of some streams over a part of the recording."""

    kind: str
    streams: frozenset[str]
    first: float  # share of the messages before it
    length: float  # share of the messages that it takes
    amount: Any = None

    def apply(self, messages: Iterable[Message]) -> list[Message]:
        """The messages, spoiled."""
        messages, result = list(messages), []
        begin = self.first * len(messages)
        end = begin + max(1.0, self.length * len(messages))
        for index, (stream, message) in enumerate(messages):
            hit = stream in self.streams and begin <= index < end
            result += [(stream, each) for each in (self._change(stream, message, index) if hit else [message])]
        return result

    def _change(self, stream: str, message: Any, index: int) -> list[Any]:
        if self.kind == "stops":
            return []
        if self.kind == "twice":
            return [message, message]
        if self.kind == "jumps":
            return [_moved(message, self.amount)]
        if self.kind == "to and fro":
            return [_moved(message, self.amount if index % 2 else -self.amount)]
        if self.kind == "frame":
            return [replace(message, frame_id=self.amount)] if stream in (LEFT, RIGHT) else [message]
        field, value, everywhere = self.amount
        name = _ARRAYS[stream][field % len(_ARRAYS[stream])]
        array = getattr(message, name)
        if array is None:
            return [message]
        array = array.copy()
        if everywhere:
            with np.errstate(invalid="ignore"):  # zero times infinity
                array *= value
        else:
            array[index % len(array)] = value
        return [replace(message, **{name: array})]


def _moved(message: Any, by_ns: int) -> Any:
    return replace(message, stamp_ns=min(max(0, message.stamp_ns + by_ns), _LAST_STAMP))


def _mutations(kind: str, amount: st.SearchStrategy[Any]) -> st.SearchStrategy[Mutation]:
    streams, share = st.frozensets(st.sampled_from(STREAMS), min_size=1), st.floats(0.0, 1.0)
    return st.builds(Mutation, st.just(kind), streams, share, share, amount)


_jumps = st.sampled_from([1, 4_000_000, 60_000_000, 300_000_000, 10**10, 10**18]).flatmap(
    lambda ns: st.sampled_from([ns, -ns])
)
_values = st.sampled_from([math.nan, math.inf, 0.0, 1.0, -1.0, 180.0 / math.pi, 1e3, 1e6, 5e8, 1e12, 1e300])

clock_mutations = st.one_of(
    _mutations("stops", st.none()),
    _mutations("twice", st.none()),
    _mutations("jumps", _jumps),
    _mutations("to and fro", _jumps),
)
value_mutations = st.one_of(
    _mutations("value", st.tuples(st.integers(0, 3), _values, st.booleans())),
    _mutations("frame", st.sampled_from(["", "nobody", "l_sole", "r_sole", "base_link"])),
)


def spoil(messages: Iterable[Message], mutations: Iterable[Mutation]) -> list[Message]:
    """The messages after all mutations, one after the other."""
    result = list(messages)
    for mutation in mutations:
        result = mutation.apply(result)
    return result
