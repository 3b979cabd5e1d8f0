# SPDX-License-Identifier: BSD-3-Clause
"""An MCAP file that ends too early or is damaged: every whole message before that place.

A recording that was cut off (power, full disk, a copy that broke) has no index at its end, and the usual readers
refuse it. Here the records are read one after the other, and a chunk that is cut off gives what is whole in it.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from .blocks import Raw
from .chunks import CHUNK, MESSAGE, RECORD, decompressed

MAGIC = b"\x89MCAP0\r\n"


class TruncatedMcap:
    """Messages of one file in the order of the file, in bounded memory.

    The constructor reads through the whole file once, so that what is missing is known before the work begins.

    Attributes:
        topics: name to type.
        definitions: type to its message definition, as the bag has it.
        counts: topic to number of messages.
        start_ns, end_ns: log times of the first and last message; 0 without messages.
        usable_bytes: how far the records are whole.
        reason: why it does not go on from there; empty if the file is whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self.definitions: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.start_ns = self.end_ns = 0
        self.usable_bytes = 0
        self.reason = ""
        for topic, log_time, _ in self.messages():
            self.counts[topic] = self.counts.get(topic, 0) + 1
            self.start_ns = min(self.start_ns or log_time, log_time)
            self.end_ns = max(self.end_ns, log_time)

    def messages(self) -> Iterator[Raw]:
        """Topic, log time [ns] and serialised message, up to the place where the file ends or is damaged."""
        self.reason = ""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, str] = {}
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                self.reason = "it does not begin as an MCAP file"
                return
            for opcode, body, whole in _records(file, self.path.stat().st_size):
                if opcode == Opcode.CHUNK:
                    yield from self._chunk(body, whole)
                elif whole:
                    yield from self._record(opcode, body)
                if not whole:
                    self.reason = self.reason or "it ends within a record"
                if self.reason:
                    return
                self.usable_bytes = file.tell()
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):  # what follows is the index
                    return
            self.reason = "its end is missing"

    def _record(self, opcode: int, body: bytes) -> Iterator[Raw]:
        try:
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, _ = MESSAGE.unpack_from(body)
                if channel in self._channels:
                    yield self._channels[channel], log_time, body[MESSAGE.size :]
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(io.BytesIO(body)))
                if schema.encoding in ("ros2msg", "ros2idl"):
                    self._schemas[schema.id] = schema
                if schema.encoding == "ros2msg":
                    self.definitions[schema.name] = schema.data.decode()
            elif opcode == Opcode.CHANNEL:
                record = Channel.read(ReadDataStream(io.BytesIO(body)))
                if record.schema_id in self._schemas:  # others hold no ROS messages
                    self._channels[record.id] = record.topic
                    self.topics[record.topic] = self._schemas[record.schema_id].name
        except Exception as error:  # damaged bytes fail in any way
            self.reason = f"damaged: {type(error).__name__} {' '.join(str(error).split())[:80]}"

    def _chunk(self, body: bytes, whole: bool) -> Iterator[Raw]:
        try:
            _, _, size, crc = CHUNK.unpack_from(body)
            (length,) = struct.unpack_from("<I", body, CHUNK.size)
            start = CHUNK.size + 4 + length
            data = decompressed(body[CHUNK.size + 4 : start], body[start + 8 :])
        except Exception as error:
            self.reason = f"damaged: {' '.join(str(error).split())[:80]}"
            return
        if whole and (len(data) != size or (crc and crc32(data) != crc)):
            self.reason = "damaged: the checksum of a chunk is wrong"
            return
        for opcode, inner, complete in _records(io.BytesIO(data), len(data)):
            if complete:
                yield from self._record(opcode, inner)


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes, bool]]:
    """Opcode, content and whether it is whole, of each record; damaged lengths never ask for more than there is."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        opcode, length = RECORD.unpack(head)
        body = file.read(min(length, max(size - file.tell(), 0)))
        yield opcode, body, len(body) == length
    if head:
        yield 0, b"", False
