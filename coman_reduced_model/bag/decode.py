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

from ..core.base.pose import matrix
from ..core.base.types import Array, ImuMessage, JointMessage, Reference, WrenchMessage
from ..core.streams.stream import Refused
from ..messages import (
    COM_REFERENCE,
    FROM,
    IMU_TYPE,
    INPUT_TYPES,
    JOINT_STATE,
    WRENCH_STAMPED,
    known_orientation,
    plan,
)
from .types import typestore

LITTLE_ENDIAN = b"\x00\x01"
_STAMP = struct.Struct("<iI")  # at 4: after the encapsulation header, to which alignments are relative
COUNT = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_PLAN = struct.Struct("<B3xidI")  # phase, step, preview_dt, number of preview positions
_DOUBLE = np.dtype("<f8")
STRINGS = 12  # offset of the first string, the frame


def align(offset: int, size: int) -> int:
    """The next offset in a message that is a multiple of a size, counted from after the encapsulation header."""
    return offset + (4 - offset) % size


def string(raw: bytes, offset: int) -> tuple[str, int]:
    """A string and the offset after it."""
    (length,) = COUNT.unpack_from(raw, offset)
    end = offset + 4 + length
    if end > len(raw):
        raise ValueError("a string is longer than the message")
    return raw[offset + 4 : end - 1].decode(), end


def _floats(raw: bytes, offset: int, count: int) -> Array:
    """Numbers of a message as an array like any other: those in the message are neither aligned nor writable.

    Compiled code would be compiled once more for such arrays.
    """
    return np.frombuffer(raw, _DOUBLE, count, offset).copy()


class _Header:
    """Seconds, nanoseconds and strings, which begin nearly every message."""

    def __init__(self) -> None:
        self._strings = b""
        self._end = STRINGS + 1  # a slice that no message matches

    def _stamp(self, raw: bytes) -> int:
        """The stamp [ns]; learns the strings if they are not those of the last message."""
        if raw[STRINGS : self._end] != self._strings:
            self._end = self._learn(raw)
            self._strings = raw[STRINGS : self._end]
        sec, nanosec = _STAMP.unpack_from(raw, 4)
        stamp: int = sec * 1_000_000_000 + nanosec
        return stamp

    def _learn(self, raw: bytes) -> int:
        """Read the strings; the offset after them."""
        self._frame_id, end = string(raw, STRINGS)
        return end


class _Joints(_Header):
    """sensor_msgs/JointState."""

    def __call__(self, raw: bytes) -> JointMessage:
        stamp = self._stamp(raw)
        arrays: list[Array | None] = []
        offset = self._end
        for _ in range(3):
            (count,) = COUNT.unpack_from(raw, offset)
            offset += 4
            if count:
                offset = align(offset, 8)
                arrays.append(_floats(raw, offset, count))
                offset += 8 * count
            else:
                arrays.append(None)
        position, velocity, effort = arrays
        return JointMessage(stamp, self._names, _EMPTY if position is None else position, velocity, effort)

    def _learn(self, raw: bytes) -> int:
        self._names, end = joint_names(raw)
        return end


def joint_names(raw: bytes) -> tuple[tuple[str, ...], int]:
    """Joints of a sensor_msgs/JointState, and the offset of the count of its positions."""
    _, offset = string(raw, STRINGS)
    offset = align(offset, 4)
    (count,) = COUNT.unpack_from(raw, offset)
    offset += 4
    names = []
    for _ in range(count):
        name, offset = string(raw, align(offset, 4))
        names.append(name)
    return tuple(names), align(offset, 4)


_EMPTY = np.empty(0)


class _Wrench(_Header):
    """geometry_msgs/WrenchStamped."""

    def __call__(self, raw: bytes) -> WrenchMessage:
        stamp = self._stamp(raw)
        values = _floats(raw, align(self._end, 8), 6)
        return WrenchMessage(stamp, self._frame_id, values[:3], values[3:])


class _Imu(_Header):
    """sensor_msgs/Imu."""

    def __call__(self, raw: bytes) -> ImuMessage:
        stamp = self._stamp(raw)
        # Orientation 4, its covariance 9, angular velocity 3, covariance 9, linear acceleration 3, covariance 9.
        values = _floats(raw, align(self._end, 8), 37)
        return ImuMessage(stamp, self._frame_id, known_orientation(values[:4], values[4]), values[13:16], values[25:28])


class _Reference(_Header):
    """coman_reduced_model_msgs/ComReference, as this version defines it."""

    def __init__(self) -> None:
        super().__init__()
        self._soles = [(b"", _EMPTY), (b"", _EMPTY)]  # a foot that stands has the pose of the last message

    def __call__(self, raw: bytes) -> Reference:
        stamp = self._stamp(raw)
        start = align(self._end, 8)
        point = _floats(raw, start, 12)
        phase, step, preview_dt, count = _PLAN.unpack_from(raw, start + 8 * 26)
        position, offset = self._preview(raw, start + 8 * 26 + _PLAN.size, count)
        (count,) = COUNT.unpack_from(raw, offset)
        velocity, offset = self._preview(raw, offset + 4, count)
        (count,) = COUNT.unpack_from(raw, offset)
        feet, offset = self._preview(raw, offset + 4, count)
        (count,) = COUNT.unpack_from(raw, offset)
        return plan(
            stamp,
            self._frame_id,
            (point[:3], point[3:6], point[6:9], point[9:12]),
            (self._sole(0, raw, start + 8 * 12), self._sole(1, raw, start + 8 * 19)),
            phase,
            step,
            preview_dt,
            (position, velocity, feet, np.frombuffer(raw, np.uint8, count, offset + 4)),
        )

    def _sole(self, index: int, raw: bytes, offset: int) -> Array:
        data = raw[offset : offset + _POSE.size]
        before, T = self._soles[index]
        if data != before:
            T = matrix(*_POSE.unpack(data))
            self._soles[index] = data, T
        return T

    @staticmethod
    def _preview(raw: bytes, offset: int, count: int) -> tuple[Array, int]:
        if not count:
            return _EMPTY, offset
        offset = align(offset, 8)
        return _floats(raw, offset, count), offset + 8 * count


_FAST: dict[str, Callable[[], Callable[[bytes], Any]]] = {
    JOINT_STATE: _Joints,
    WRENCH_STAMPED: _Wrench,
    IMU_TYPE: _Imu,
    COM_REFERENCE: _Reference,
}


def decoder(stream: str, store: Typestore | None = None) -> Callable[[bytes], Any]:
    """What turns the serialised messages of one stream (a key of messages.INPUT_TYPES) into core types.

    The result raises Refused for bytes that are no such message. It remembers the last strings: one a stream.
    """
    kind = INPUT_TYPES[stream]
    definitions = store or typestore()
    convert = FROM[stream]
    # A bag may bring another definition of our messages, from an older version.
    known = kind in _FAST and definitions.fielddefs[kind][1] == typestore().fielddefs[kind][1]
    fast = _FAST[kind]() if known else None

    def decode(raw: bytes) -> Any:
        try:
            if fast is not None and raw[:2] == LITTLE_ENDIAN:
                return fast(raw)
            return convert(definitions.deserialize_cdr(raw, kind))
        except Refused:
            raise
        except Exception as error:  # struct, numpy, rosbags and codecs each have their own
            raise Refused(
                "malformed", f"{len(raw)} bytes are no {kind}: {' '.join(str(error).split())[:120]}"
            ) from None

    return decode
