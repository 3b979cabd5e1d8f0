# SPDX-License-Identifier: BSD-3-Clause
"""Layout of serialised messages (CDR): which numbers come where.

It depends on strings and lengths alone, and those hardly ever change: a format is made once and the numbers are packed
into it. Message objects in between would cost several times as much.
"""

from __future__ import annotations

import struct

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


def header_values(stamp_ns: int, frame: bytes) -> tuple[int, int, int, bytes]:
    """What fills `Layout.header`."""
    return stamp_ns // SECOND, stamp_ns % SECOND, len(frame), frame


def cdr_string(text: str) -> bytes:
    """A string as it is serialised, without its length."""
    return text.encode() + b"\0"
