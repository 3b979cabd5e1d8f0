# SPDX-License-Identifier: BSD-3-Clause
"""Serialised messages by the thousand: where each lies in one piece of memory, instead of an object for each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.base.compiled import compiled
from ..core.base.types import Integers

Raw = tuple[str, int, bytes]  # topic, log time [ns], serialised message
Bytes = NDArray[np.uint8]
_GROUP = 1024  # messages that are put together, where they come one by one
_MESSAGE = 5  # opcode of MCAP; its record: channel 2, sequence 4, log time 8, publish time 8 bytes, message
_LAST = 2**63 - 1  # log time of messages whose own, of a damaged file, is later than that [ns]
_RECORD, _HEADER = 9, 22  # bytes of opcode and length, of what comes before the message


@dataclass
class RawBlock:
    """Messages in the order in which they are to be taken.

    Attributes:
        topics: names.
        data: all bytes.
        topic: (n,) index in `topics` of each message.
        log_time: (n,) [ns].
        start, end: (n,) where each lies in `data`.
    """

    topics: Sequence[str]
    data: bytes
    topic: Integers
    log_time: Integers
    start: Integers
    end: Integers

    def __len__(self) -> int:
        return len(self.topic)

    def __iter__(self) -> Iterator[Raw]:
        columns = (self.topic.tolist(), self.log_time.tolist(), self.start.tolist(), self.end.tolist())
        for topic, log_time, start, end in zip(*columns, strict=True):
            yield self.topics[topic], log_time, self.data[start:end]

    def take(self, which: Integers | slice) -> RawBlock:
        """Some of the messages; the bytes stay as they are."""
        return RawBlock(
            self.topics, self.data, self.topic[which], self.log_time[which], self.start[which], self.end[which]
        )

    def pieces(self, size: int) -> Iterator[RawBlock]:
        """Its messages, at most `size` at a time."""
        for first in range(0, len(self), size):
            yield self.take(slice(first, first + size))


def grouped(messages: Iterable[Raw]) -> Iterator[RawBlock]:
    """Blocks of messages that come one by one; what came before an error is given out before it is raised."""
    group: list[Raw] = []
    try:
        for message in messages:
            group.append(message)
            if len(group) >= _GROUP:
                full, group = group, []
                yield block_of(full)
    except GeneratorExit:
        raise
    except Exception:
        if group:
            yield block_of(group)
        raise
    if group:
        yield block_of(group)


def block_of(messages: Sequence[Raw]) -> RawBlock:
    """A block of messages."""
    index = {topic: i for i, topic in enumerate(dict.fromkeys(topic for topic, *_ in messages))}
    end = np.cumsum([len(raw) for *_, raw in messages], dtype=np.int64)
    return RawBlock(
        tuple(index),
        b"".join([raw for *_, raw in messages]),
        np.array([index[topic] for topic, *_ in messages], dtype=np.int64),
        np.array([min(log_time, _LAST) for _, log_time, _ in messages], dtype=np.int64),
        np.concatenate(([0], end[:-1])),
        end,
    )


def block_of_records(data: bytes, channels: dict[int, str]) -> RawBlock:
    """The messages of some channels in the records of a chunk of an MCAP file, as they were written.

    Raises:
        ValueError: a record is longer than what there is.
    """
    topics = tuple(dict.fromkeys(channels.values()))
    of_channel = np.full(2**16, -1, dtype=np.int64)
    of_channel[list(channels)] = [topics.index(topic) for topic in channels.values()]
    view = np.frombuffer(data, dtype=np.uint8)
    count = _scan(view, of_channel, np.empty((0, 4), dtype=np.int64))
    if count < 0:
        raise ValueError("a record is longer than its chunk")
    found = np.empty((count, 4), dtype=np.int64)
    _scan(view, of_channel, found)
    return RawBlock(topics, data, *found.T.copy())


@compiled
def _little_endian(data: Bytes, offset: int, size: int) -> int:
    value = 0
    for i in range(size):
        value |= int(data[offset + i]) << (8 * i)
    return value


@compiled
def _scan(data: Bytes, of_channel: Integers, out: Integers) -> int:
    """Write topic, log time, start and end of each message, as far as there is room; the number of messages, or -1."""
    count, offset, end = 0, 0, data.shape[0]
    while offset < end:
        if end - offset < _RECORD:
            return -1
        length = _little_endian(data, offset + 1, 8)
        start = offset + _RECORD
        if length < 0 or length > end - start:
            return -1
        if data[offset] == _MESSAGE and length >= _HEADER:
            topic = of_channel[_little_endian(data, start, 2)]
            if topic >= 0:
                if count < out.shape[0]:
                    log_time = _little_endian(data, start + 6, 8)
                    out[count, 0], out[count, 1] = topic, log_time if log_time >= 0 else _LAST
                    out[count, 2], out[count, 3] = start + _HEADER, start + length
                count += 1
        offset = start + length
    return count


@compiled
def alike(data: Bytes, start: Integers, first: int, last: int) -> bool:
    """Whether all messages have the same bytes from `first` to `last` - 1 of each."""
    for k in range(1, start.shape[0]):
        for i in range(first, last):
            if data[start[k] + i] != data[start[0] + i]:
                return False
    return True


@compiled
def _cut_out(data: Bytes, start: Integers, offset: int, out: Bytes) -> None:
    for k in range(start.shape[0]):
        first = start[k] + offset
        for i in range(out.shape[1]):
            out[k, i] = data[first + i]


def numbers(data: Bytes, start: Integers, offset: int, kind: str, count: int) -> NDArray[np.generic]:
    """Numbers (n, count) of a kind of numpy at an offset in each message, which need not be aligned there."""
    dtype = np.dtype(kind)
    out = np.empty((len(start), count * dtype.itemsize), dtype=np.uint8)
    _cut_out(data, start, offset, out)
    return out.view(dtype)
