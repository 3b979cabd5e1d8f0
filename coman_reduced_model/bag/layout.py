# SPDX-License-Identifier: BSD-3-Clause
"""Layout of serialised messages (CDR): which numbers come where.

It depends on strings and lengths alone, and those hardly ever change: a format is made once and the numbers are packed
into it. Message objects in between would cost several times as much.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.base.types import Integers

LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # begins every message; positions count from its end
SECOND = 1_000_000_000  # [ns]


class Layout:
    """A struct format with the padding of CDR: every number at a multiple of its size."""

    def __init__(self) -> None:
        self.format = "<"

    def add(self, kind: str, count: int = 1) -> Layout:
        """A number of values of a kind of `struct`, or a string of that length."""
        size = struct.calcsize(kind)
        padding = -struct.calcsize(self.format) % size
        self.format += f"{padding}x" * bool(padding) + f"{count}{kind}"
        return self

    def header(self, frame: bytes) -> Layout:
        """A std_msgs/Header, filled by `header_values`."""
        return self.add("i").add("I").add("I").add("s", len(frame))

    def doubles(self, count: int) -> Layout:
        """A sequence of doubles: its length, then the numbers."""
        self.add("I")
        return self.add("d", count) if count else self

    def packer(self) -> struct.Struct:
        """What packs values into it."""
        return struct.Struct(self.format)


class Rows:
    """Serialised messages of one layout as rows of bytes, filled a field at a time; padding as in `Layout`."""

    def __init__(self) -> None:
        self._offset = 0
        self._fields: list[tuple[str, str, int, int]] = []  # name, kind of numpy, count, offset
        self._fixed: list[tuple[int, bytes]] = []

    def add(self, name: str, kind: str, count: int = 1) -> Rows:
        """A number of values of a kind of numpy."""
        size = np.dtype(kind).itemsize
        self._offset += -self._offset % size
        self._fields.append((name, f"{count}{kind}" if count != 1 else kind, count, self._offset))
        self._offset += count * size
        return self

    def fixed(self, kind: str, *values: int) -> Rows:
        """Values that are the same in all messages."""
        data = np.array(values, dtype=kind)
        self._offset += -self._offset % data.itemsize
        return self._put(data.tobytes())

    def string(self, text: bytes) -> Rows:
        """A string that is the same in all messages, with its length."""
        return self.fixed("<u4", len(text))._put(text)

    def header(self, frame: bytes, name: str = "stamp") -> Rows:
        """A std_msgs/Header; its stamp is a field."""
        return self.add(name, "<u4", 2).string(frame)

    def _put(self, data: bytes) -> Rows:
        self._fixed.append((self._offset, data))
        self._offset += len(data)
        return self

    def filled(self, stamps_ns: Integers, values: Mapping[str, ArrayLike]) -> NDArray[np.uint8]:
        """Messages (n, size): `stamps_ns` (n,) for every header, and a value (n, ...) for each other field."""
        count, start = len(stamps_ns), len(LITTLE_ENDIAN)
        out = np.zeros((count, start + self._offset), dtype=np.uint8)
        for offset, data in ((-start, LITTLE_ENDIAN), *self._fixed):
            out[:, start + offset : start + offset + len(data)] = np.frombuffer(data, dtype=np.uint8)
        names, kinds, _, offsets = zip(*self._fields, strict=True)
        whole = np.dtype(
            {
                "names": names,
                "formats": kinds,
                "offsets": [start + offset for offset in offsets],
                "itemsize": out.shape[1],
            }
        )
        rows = out.view(whole)[:, 0]
        times = np.stack(np.divmod(stamps_ns, SECOND), axis=1)
        for name, _, size, _ in self._fields:
            value = times if name not in values else np.asarray(values[name])
            rows[name] = value.reshape(count, size) if size != 1 else value.reshape(count)
        return out


def header_values(stamp_ns: int, frame: bytes) -> tuple[int, int, int, bytes]:
    """What fills `Layout.header`."""
    return stamp_ns // SECOND, stamp_ns % SECOND, len(frame), frame


def cdr_string(text: str) -> bytes:
    """A string as it is serialised, without its length."""
    return text.encode() + b"\0"
