# SPDX-License-Identifier: BSD-3-Clause
"""MCAP bags written without ROS, as `ros2 bag` would: definitions, hashes and QoS profiles included."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zstandard
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from ..errors import OutputError
from .types import typestore

_FOREVER = QosTime(9223372036, 854775807)
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode and length of the record; channel, sequence, log and publish time
_CHUNK_SIZE = 2**20  # [bytes] after which a chunk is compressed and written


class _Mcap(McapWriter):
    """The writer of rosbags; a message is packed in one go, and statistics are counted a chunk at a time."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        if self.compression:  # twice as fast as at the usual level, and no larger: numbers hardly compress
            self.compressor = zstandard.ZstdCompressor(level=1).compress

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        bio, channel = self.chunk.bio, connection.id
        self.chunk.msgs[channel].append((timestamp, bio.tell()))
        bio.write(_MESSAGE.pack(5, 22 + len(data), channel, 0, timestamp, timestamp) + data)
        if bio.tell() > _CHUNK_SIZE:
            self.close_chunk()

    def close_chunk(self) -> None:
        chunk = self.chunk
        for messages in chunk.msgs.values():
            stamps = [stamp for stamp, _ in messages]
            chunk.message_start_time = min(chunk.message_start_time, *stamps)
            chunk.message_end_time = max(chunk.message_end_time, *stamps)
        self.message_start_time = min(self.message_start_time, chunk.message_start_time)
        self.message_end_time = max(self.message_end_time, chunk.message_end_time)
        super().close_chunk()
        for channel, messages in chunk.msgs.items():
            self.channel_stats[channel] += len(messages)


class _Writer(Writer):
    STORAGE_PLUGINS = {StoragePlugin.MCAP: _Mcap}

    @property
    def mcap(self) -> _Mcap:
        """The file, while it is open."""
        assert isinstance(self.storage, _Mcap)
        return self.storage

    def close(self) -> None:
        mcap = self.mcap
        if mcap.chunk.bio.tell():
            mcap.close_chunk()
        self.counts.update(mcap.channel_stats)
        self.min_timestamp, self.max_timestamp = mcap.message_start_time, mcap.message_end_time
        super().close()


def qos(depth: int = 10, transient_local: bool = False) -> Qos:
    """A reliable profile, as our nodes offer it."""
    durability = QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability.RELIABLE,
        durability,
        _FOREVER,
        _FOREVER,
        QosLiveliness.AUTOMATIC,
        _FOREVER,
        False,
    )


class BagWriter:
    """A new bag with topics of given types. Use it in a `with` statement.

    Topics named in `latched` are offered transient local (robot descriptions, plans).
    """

    def __init__(self, path: str | Path, topics: Mapping[str, str], latched: tuple[str, ...] = ()) -> None:
        """Create the folder of the bag.

        Args:
            path: folder to create.
            topics: absolute name to message type.
            latched: topics with one lasting message.

        Raises:
            OutputError: the folder exists or cannot be made.
        """
        self.path = Path(path)
        self.counts = dict.fromkeys(topics, 0)
        self._store = typestore()
        try:
            self._writer = _Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
            self._append = self._writer.mcap.write  # the topics are known to be there
        except Exception as error:
            raise OutputError(f"{path}: cannot be written: {' '.join(str(error).split())}") from None
        self._connections = {}
        for topic, kind in topics.items():
            profile = qos(1, True) if topic in latched else qos()
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[profile]
            )

    def write(self, topic: str, log_time_ns: int, message: Any) -> None:
        """Append a message (of bag.types.bag_types())."""
        connection = self._connections[topic]
        self.write_raw(topic, log_time_ns, self._store.serialize_cdr(message, connection.msgtype))

    def write_raw(self, topic: str, log_time_ns: int, data: bytes | memoryview) -> None:
        """Append a message that is serialised already."""
        self._append(self._connections[topic], log_time_ns, data)
        self.counts[topic] += 1

    def close(self) -> None:
        """Write the index; without it the bag counts as cut off."""
        self._writer.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
