# SPDX-License-Identifier: BSD-3-Clause
"""Blocks of serialised messages (CDR) to blocks of core types, where all messages of a stream are laid out alike.

The first message says where the numbers are; the others must have the same length, strings and counts.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

import numpy as np
from rosbags.typesys.store import Typestore

from ..core.base.pose import matrix
from ..core.base.types import Array, Integers
from ..core.streams.blocks import Block, ImuBlock, Irregular, JointBlock, ReferenceBlock, WrenchBlock
from ..messages import COM_REFERENCE, IMU_TYPE, INPUT_TYPES, JOINT_STATE, ODOM, WRENCH_STAMPED
from .blocks import Bytes, RawBlock, alike, numbers
from .decode import COUNT, LITTLE_ENDIAN, STRINGS, align, joint_names, string
from .types import typestore

_ROUNDING = 1e-9  # of a squared length: nearer to a limit, rounding could matter
_PREVIEW = 8 * 26  # bytes from the first number of a plan to its phase


class _Rows:
    """The messages of one stream in a block."""

    def __init__(self, block: RawBlock, which: Integers, view: Bytes) -> None:
        self.arrival = which
        self.start = block.start[which]
        self.view = view
        self.size = int(block.end[which[0]] - self.start[0])
        self.first = block.data[self.start[0] : self.start[0] + self.size]
        if (block.end[which] - self.start != self.size).any() or self.first[:2] != LITTLE_ENDIAN:
            raise Irregular
        self.check(0, 2)

    def check(self, first: int, last: int) -> None:
        """Refuse a block whose messages differ in these bytes."""
        if last > self.size or not alike(self.view, self.start, first, last):
            raise Irregular

    def array(self, offset: int, count: int, kind: str = "<f8") -> Array:
        """Numbers (n, count) at an offset."""
        if offset + count * np.dtype(kind).itemsize > self.size:
            raise Irregular
        return numbers(self.view, self.start, offset, kind, count)  # type: ignore[return-value]

    def stamps(self) -> Integers:
        """(n,) [ns]."""
        seconds, nanoseconds = (self.array(at, 1, kind)[:, 0].astype(np.int64) for at, kind in ((4, "<i4"), (8, "<u4")))
        return seconds * 1_000_000_000 + nanoseconds

    def count(self, offset: int) -> int:
        """The length of a sequence, the same in all messages."""
        self.check(offset, offset + 4)
        return int(COUNT.unpack_from(self.first, offset)[0])

    def sequence(self, offset: int) -> tuple[Array | None, int]:
        """Numbers (n, m) after their count, and the offset after them; None without any."""
        count = self.count(offset)
        offset += 4
        if not count:
            return None, offset
        offset = align(offset, 8)
        return self.array(offset, count), offset + 8 * count

    def frame(self) -> tuple[str, int]:
        """The frame, the same in all messages, and the offset of the numbers after it."""
        frame_id, end = string(self.first, STRINGS)
        self.check(STRINGS, end)
        return frame_id, align(end, 8)


def _joints(rows: _Rows) -> JointBlock:
    names, offset = joint_names(rows.first)
    rows.check(STRINGS, offset)
    arrays = []
    for _ in range(3):
        values, offset = rows.sequence(offset)
        arrays.append(values)
    position, velocity, effort = arrays
    if position is None:
        raise Irregular
    return JointBlock(rows.arrival, rows.stamps(), names, position, velocity, effort)


def _wrenches(rows: _Rows) -> WrenchBlock:
    frame_id, offset = rows.frame()
    return WrenchBlock(rows.arrival, rows.stamps(), frame_id, rows.array(offset, 6))


def _imus(rows: _Rows) -> ImuBlock:
    frame_id, offset = rows.frame()
    # Orientation 4, its covariance 9, angular velocity 3, covariance 9, linear acceleration 3, covariance 9.
    values = rows.array(offset, 37)
    square = np.square(values[:, :4]).sum(axis=1)
    if not (np.abs(square[:, None] - (0.9, 1.1)) > _ROUNDING).all():
        raise Irregular
    oriented = (values[:, 4] >= 0.0) & (square > 0.9) & (square < 1.1)
    orientation, turns, shakes = (np.ascontiguousarray(values[:, k : k + n]) for k, n in ((0, 4), (13, 3), (25, 3)))
    return ImuBlock(rows.arrival, rows.stamps(), frame_id, orientation, oriented, turns, shakes)


def _references(rows: _Rows) -> ReferenceBlock:
    frame_id, start = rows.frame()
    after = start + _PREVIEW
    preview_dt = rows.array(after + 8, 1)[:, 0]
    phase, step = rows.array(after, 1, "<u1")[:, 0], rows.array(after + 4, 1, "<i4")[:, 0]
    position, offset = rows.sequence(after + 16)
    velocity, offset = rows.sequence(offset)
    feet, offset = rows.sequence(offset)
    phases = rows.array(offset + 4, rows.count(offset), "<u1")
    shape = (len(phase), -1, 3)
    if (position is None) != (velocity is None) or frame_id.lstrip("/") != ODOM or (phase > 3).any():
        raise Irregular
    previews = np.empty((len(phase), 2, 0, 3))
    if position is not None and velocity is not None:
        if position.shape != velocity.shape or position.shape[1] % 3 or not 0.0 < preview_dt[0] < np.inf:
            raise Irregular
        previews = np.stack((position.reshape(shape), velocity.reshape(shape)), axis=1)
    if (preview_dt != preview_dt[0]).any():
        raise Irregular
    steps = None
    if feet is not None or phases.shape[1]:
        k = previews.shape[2]
        if feet is None or feet.shape[1] != 14 * k or phases.shape[1] != k or (phases > 3).any():
            raise Irregular
        steps = feet.reshape(-1, k, 14), phases.astype(np.int64)
    left, right = (_poses(rows, start + 8 * k) for k in (12, 19))
    return ReferenceBlock(
        rows.arrival,
        rows.stamps(),
        rows.array(start, 12).reshape(-1, 4, 3),
        list(zip(left, right, strict=True)),
        phase.tolist(),
        step.tolist(),
        float(preview_dt[0]),
        previews,
        steps,
    )


def _poses(rows: _Rows, offset: int) -> list[Array]:
    """Matrices (4, 4) of poses; a foot that stands has that of the message before."""
    poses = rows.array(offset, 7)
    moved = np.ones(len(poses), dtype=bool)
    moved[1:] = (poses[1:] != poses[:-1]).any(axis=1)
    found: list[Array] = []
    for pose, new in zip(poses.tolist(), moved.tolist(), strict=True):
        found.append(matrix(*pose) if new else found[-1])
    return found


_KINDS: dict[str, Callable[[_Rows], Block]] = {
    JOINT_STATE: _joints,
    WRENCH_STAMPED: _wrenches,
    IMU_TYPE: _imus,
    COM_REFERENCE: _references,
}


def decode_block(block: RawBlock, streams: Mapping[str, str], store: Typestore) -> dict[str, Block]:
    """The messages of a block by stream; `streams` by topic, `store` with the definitions of the bag.

    Raises:
        Irregular: the messages of a stream are not alike, of another definition than ours, or seldom (FootContacts).
    """
    view, found = np.frombuffer(block.data, dtype=np.uint8), {}
    for index, topic in enumerate(block.topics):
        which = np.flatnonzero(block.topic == index)
        if not len(which):
            continue
        kind = INPUT_TYPES[streams[topic]]
        older = store.fielddefs[kind][1] != typestore().fielddefs[kind][1]
        if older or kind not in _KINDS:
            raise Irregular
        try:
            found[streams[topic]] = _KINDS[kind](_Rows(block, which, view))
        except (struct.error, ValueError) as error:  # a message that is none
            raise Irregular from error
    return found
