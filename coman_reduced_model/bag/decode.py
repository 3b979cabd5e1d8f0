# SPDX-License-Identifier: BSD-3-Clause
"""Serialised messages (CDR) straight to core types, for the streams that come hundreds of times a second.

A message of a stream has the same strings as the one before it; so their bytes are compared, not parsed, and the
numbers lie at known offsets. That is some five times faster than a general decoder, which does the rest:
messages of other types or of the other byte order.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from ..core.streams import Refused
from ..core.types import Array, ImuMessage, JointMessage, WrenchMessage
from ..messages import FROM, IMU_TYPE, INPUT_TYPES, JOINT_STATE, WRENCH_STAMPED
from .types import typestore

_LITTLE_ENDIAN = b"\x00\x01"
_STAMP = struct.Struct("<iI")  # at 4: after the encapsulation header, to which alignments are relative
_COUNT = struct.Struct("<I")
_WRENCH = struct.Struct("<6d")
_STRINGS = 12  # offset of the first string, the frame


def _align(offset: int, size: int) -> int:
    return offset + (4 - offset) % size


def _string(raw: bytes, offset: int) -> tuple[str, int]:
    """A string and the offset after it."""
    (length,) = _COUNT.unpack_from(raw, offset)
    end = offset + 4 + length
    if end > len(raw):
        raise ValueError("a string is longer than the message")
    return raw[offset + 4 : end - 1].decode(), end


class _Joints:
    """sensor_msgs/JointState."""

    def __init__(self) -> None:
        self._strings = b""
        self._end = _STRINGS + 1  # a slice that no message matches
        self._names: tuple[str, ...] = ()

    def __call__(self, raw: bytes) -> JointMessage:
        if raw[_STRINGS : self._end] != self._strings:
            self._learn(raw)
        sec, nanosec = _STAMP.unpack_from(raw, 4)
        position, offset = self._doubles(raw, self._end)
        velocity, offset = self._doubles(raw, offset)
        effort, offset = self._doubles(raw, offset)
        return JointMessage(
            sec * 1_000_000_000 + nanosec,
            self._names,
            position,
            velocity if len(velocity) else None,
            effort if len(effort) else None,
        )

    def _learn(self, raw: bytes) -> None:
        _, offset = _string(raw, _STRINGS)
        offset = _align(offset, 4)
        (count,) = _COUNT.unpack_from(raw, offset)
        offset += 4
        names = []
        for _ in range(count):
            name, offset = _string(raw, _align(offset, 4))
            names.append(name)
        offset = _align(offset, 4)
        self._strings, self._end, self._names = raw[_STRINGS:offset], offset, tuple(names)

    @staticmethod
    def _doubles(raw: bytes, offset: int) -> tuple[Array, int]:
        (count,) = _COUNT.unpack_from(raw, offset)
        if not count:
            return _EMPTY, offset + 4
        start = _align(offset + 4, 8)
        return np.frombuffer(raw, "<f8", count, start), start + 8 * count


_EMPTY = np.empty(0)


class _Wrench:
    """geometry_msgs/WrenchStamped."""

    def __init__(self) -> None:
        self._strings = b""
        self._end = _STRINGS + 1
        self._frame_id = ""

    def __call__(self, raw: bytes) -> WrenchMessage:
        if raw[_STRINGS : self._end] != self._strings:
            self._frame_id, self._end = _string(raw, _STRINGS)
            self._strings = raw[_STRINGS : self._end]
        sec, nanosec = _STAMP.unpack_from(raw, 4)
        values = np.frombuffer(raw, "<f8", 6, _align(self._end, 8))
        return WrenchMessage(sec * 1_000_000_000 + nanosec, self._frame_id, values[:3], values[3:])


class _Imu:
    """sensor_msgs/Imu."""

    def __init__(self) -> None:
        self._strings = b""
        self._end = _STRINGS + 1
        self._frame_id = ""

    def __call__(self, raw: bytes) -> ImuMessage:
        if raw[_STRINGS : self._end] != self._strings:
            self._frame_id, self._end = _string(raw, _STRINGS)
            self._strings = raw[_STRINGS : self._end]
        sec, nanosec = _STAMP.unpack_from(raw, 4)
        # Orientation 4, its covariance 9, angular velocity 3, covariance 9, linear acceleration 3, covariance 9.
        values = np.frombuffer(raw, "<f8", 37, _align(self._end, 8))
        orientation = values[:4] if values[4] >= 0.0 else None
        stamp_ns = sec * 1_000_000_000 + nanosec
        return ImuMessage(stamp_ns, self._frame_id, orientation, values[13:16], values[25:28])


_FAST: dict[str, Callable[[], Callable[[bytes], Any]]] = {JOINT_STATE: _Joints, WRENCH_STAMPED: _Wrench, IMU_TYPE: _Imu}


def decoder(stream: str, store: Typestore | None = None) -> Callable[[bytes], Any]:
    """What turns the serialised messages of one stream (a key of messages.INPUT_TYPES) into core types.

    The result raises Refused for bytes that are no such message. It remembers the last strings: one a stream.
    """
    kind = INPUT_TYPES[stream]
    definitions = store or typestore()
    convert = FROM[stream]
    fast = _FAST[kind]() if kind in _FAST else None

    def decode(raw: bytes) -> Any:
        try:
            if fast is not None and raw[:2] == _LITTLE_ENDIAN:
                return fast(raw)
            return convert(definitions.deserialize_cdr(raw, kind))
        except Refused:
            raise
        except Exception as error:  # struct, numpy, rosbags and codecs each have their own
            raise Refused(
                "malformed", f"{len(raw)} bytes are no {kind}: {' '.join(str(error).split())[:120]}"
            ) from None

    return decode
