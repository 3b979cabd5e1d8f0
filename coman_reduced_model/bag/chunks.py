# SPDX-License-Identifier: BSD-3-Clause
"""Messages of whole MCAP files, chunk by chunk by the file's index: five times faster than a general reader."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from .blocks import RawBlock, block_of, block_of_records

CHUNK = struct.Struct("<QQQI")  # start and end time, size, checksum; then the compression and the records, as strings
RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
LARGEST = 256 * 2**20  # bytes of a chunk: rosbag2 writes some megabytes; a small file must not fill the memory
GROWTH = 100  # times its size that a compressed file may grow to, beside that: recordings grow some ten times
_ZSTD = b"\x28\xb5\x2f\xfd"
_PART = 16 * 2**10  # bytes that are decompressed at once
_TOO_LARGE = f"a chunk of more than {LARGEST >> 20} MB"


def indexed_blocks(path: Path, topics: Collection[str]) -> Iterator[RawBlock] | None:
    """Messages of some topics in the order of their log times, in memory of a few chunks; None without an index.

    Raises (while iterating):
        Exception: of some kind, where the file is damaged; what came before is good.
    """
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or not summary.chunk_indexes:
        return None
    channels = {key: each.topic for key, each in summary.channels.items() if each.topic in topics}
    # A chunk without an index of its messages may hold any.
    chunks = [
        each
        for each in summary.chunk_indexes
        if not each.message_index_offsets or not channels.keys().isdisjoint(each.message_index_offsets)
    ]
    _refuse_large(chunks)
    return _in_order(path, sorted(chunks, key=lambda each: each.message_start_time), channels)


def grows_unchecked(path: Path) -> bool:
    """Whether a general reader would decompress a file, or its chunks to look for an index, however large they grow."""
    try:
        with path.open("rb") as file:
            if file.read(4) == _ZSTD:
                return True
            file.seek(0)
            summary = make_reader(file).get_summary()
            return summary is None or not summary.chunk_indexes and _has_compressed_chunks(file)
    except Exception:  # no MCAP file, or a damaged one
        return path.suffix == ".mcap"


def _has_compressed_chunks(file: BinaryIO) -> bool:
    file.seek(8)  # the magic bytes
    while len(head := file.read(RECORD.size)) == RECORD.size:
        opcode, length = RECORD.unpack(head)
        after = file.tell() + length
        if opcode == Opcode.CHUNK:
            file.seek(CHUNK.size, 1)
            return file.read(4) != b"\0\0\0\0"
        if opcode == Opcode.DATA_END:
            return False
        file.seek(after)
    return False


def _in_order(path: Path, chunks: list[ChunkIndex], channels: dict[int, str]) -> Iterator[RawBlock]:
    held: RawBlock | None = None
    with path.open("rb") as file:
        for i, chunk in enumerate(chunks):
            block = block_of_records(_read(file, chunk), channels)
            if held is not None:
                block = block_of([*held, *block])
            block = block.take(np.argsort(block.log_time, kind="stable"))
            # Chunks may overlap in time: what the next one may come before has to wait for it.
            last = i + 1 == len(chunks)
            ready = len(block)
            if not last:
                ready = int(np.searchsorted(block.log_time, chunks[i + 1].message_start_time, side="right"))
            held = block.take(slice(ready, None)) if ready < len(block) else None
            yield block.take(slice(0, ready))


def _read(file: BinaryIO, chunk: ChunkIndex) -> bytes:
    """The records of a chunk.

    Raises:
        Exception: of some kind, if it is damaged.
    """
    file.seek(chunk.chunk_start_offset + RECORD.size)
    _, _, size, crc = CHUNK.unpack(file.read(CHUNK.size))
    file.seek(4 + len(chunk.compression) + 8, 1)
    data = decompressed(chunk.compression.encode(), file.read(chunk.compressed_size))
    if len(data) != size or (crc and crc32(data) != crc):
        raise ValueError("the checksum of a chunk is wrong")
    return data


def decompressed(method: bytes, data: bytes) -> bytes:
    """The records of a chunk, which may be cut off: as far as they go, and no more than LARGEST.

    Raises:
        Exception: of some kind, if it is damaged or larger.
    """
    if method == b"":
        return data
    if method == b"lz4":
        out = lz4.frame.LZ4FrameDecompressor().decompress(data, LARGEST + 1)
    elif method == b"zstd":
        out = b"".join(_zstd(data))
    else:
        raise ValueError(f"compression {method!r} is not known")
    if len(out) > LARGEST:
        raise ValueError(_TOO_LARGE)
    return out


def plain(blocks: Iterable[RawBlock]) -> Iterator[RawBlock]:
    """The same blocks with messages as they were before each was compressed, if they were; no plain one begins so."""
    for block in blocks:
        if len(block) and block.data[int(block.start[0]) : int(block.start[0]) + len(_ZSTD)] == _ZSTD:
            block = block_of([(topic, log_time, _opened(raw)) for topic, log_time, raw in block])
        yield block


def _opened(message: bytes) -> bytes:
    """What was compressed; of a damaged message what there is, which is then counted as none."""
    try:
        return decompressed(b"zstd", message)
    except Exception:
        return message


def _zstd(data: bytes) -> Iterator[bytes]:
    """Parts of what was compressed; a file that is cut off ends without an error."""
    decompress, size = zstandard.ZstdDecompressor().decompressobj().decompress, 0
    for start in range(0, len(data), _PART):  # no part grows by more than some thousand times
        part = decompress(data[start : start + _PART])
        size += len(part)
        if size > LARGEST:
            raise ValueError(_TOO_LARGE)
        yield part


def _refuse_large(chunks: list[ChunkIndex]) -> None:
    """Raises ValueError if a chunk says that it is larger than LARGEST."""
    if any(max(each.uncompressed_size, each.chunk_length) > LARGEST for each in chunks):
        raise ValueError(_TOO_LARGE)
