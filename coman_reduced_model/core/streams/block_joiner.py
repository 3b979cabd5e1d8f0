# SPDX-License-Identifier: BSD-3-Clause
"""The joiner, for whole blocks of messages at once: the same Samples, bit for bit, as one message after the other.

Recordings are nearly all alike messages with increasing stamps. For these, which messages have come when a joint state
is complete, and which two are around it, are searches in sorted stamps. A block with anything else in it is
`Irregular`: nothing of it is taken, and its messages go through the joiner one by one.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ...errors import RobotError
from ..base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..base.types import Array, Foot, ImuMessage, Integers, Phase, PlannedSteps, Reference, Sample
from .blocks import Block, ImuBlock, Irregular, JointBlock, ReferenceBlock, WrenchBlock
from .joiner import Joiner
from .joint_map import JointState
from .mixing import brackets, mix_rows
from .preview import later
from .stream import CAPACITY, Stream, all_usable_rows, smoothed

_NONE = np.empty(0, dtype=np.int64)
_NEVER = np.iinfo(np.int64).max
_FEET = {name: foot for foot, name in WRENCHES.items()}
_PHASES = {int(phase): phase for phase in Phase}  # faster than Phase()
_PLAIN = 1e8  # below it, all vectors of a plan are usable


@dataclass
class _Lane:
    """A stream in a block: what waited in it, then what the block brings.

    Attributes:
        stamps, arrival: (n,) true stamps, and arrivals; -1: before the block.
        rows: values as arrays, one row a message; joint states: q, qd, tau; IMU: none.
        value: by index in the block, what the joiner holds of a message; arrays may be part of `rows`.
        commit: what is remembered of the values once the block is taken.
    """

    stream: Stream
    stamps: Integers
    arrival: Integers
    rows: tuple[Array | None, ...] = ()
    value: Callable[[int], Any] = lambda index: None
    commit: Callable[[], None] = lambda: None
    waited: int = 0

    @property
    def new(self) -> Integers:
        """Stamps that the block brings."""
        return self.stamps[self.waited :]

    @property
    def came(self) -> Integers:
        """Their arrivals."""
        return self.arrival[self.waited :]

    def waits(self, rows: tuple[Array | None, ...]) -> None:
        """Put what waits in the stream before what the block brings; `rows`: its values, like the others."""
        items = self.stream.items
        self.waited = len(items)
        self.stamps = np.concatenate((np.array([stamp for stamp, _ in items], dtype=np.int64), self.stamps))
        self.arrival = np.concatenate((np.full(len(items), -1), self.arrival))
        pairs = zip(rows, self.rows or (None,) * len(rows), strict=True)
        self.rows = tuple(a if b is None else b if not len(items) else np.concatenate((a, b)) for a, b in pairs)  # type: ignore[arg-type]

    def held(self, index: int) -> Any:
        """The value with an index in `stamps`."""
        return self.stream.items[index][1] if index < self.waited else self.value(index - self.waited)

    def leave(self, stamp: int | None) -> None:
        """Take the block into the stream; up to a stamp, all samples have been given out."""
        first = 0 if stamp is None else max(0, int(np.searchsorted(self.stamps, stamp, side="right")) - 1)
        kept = [(int(self.stamps[i]), copy.deepcopy(self.held(i))) for i in range(first, len(self.stamps))]
        self.stream.items.clear()
        self.stream.items.extend(kept)


class _Found(NamedTuple):
    """Places of the two messages around each sample; -1: none, or the first is taken as it is."""

    first: Integers
    second: Integers


class BlockJoiner(Joiner):
    """A joiner that takes blocks as well as messages, in any order."""

    def add_block(self, blocks: Mapping[str, Block]) -> list[Sample]:
        """The Samples that a block of messages completes, oldest first.

        Args:
            blocks: by stream; their arrivals are places in one order.

        Raises:
            Irregular: nothing has been taken; add the messages one after the other.
        """
        if CONTACTS in self.incomplete or self.streams[CONTACTS].items:  # few robots have these
            raise Irregular
        lanes = {name: self._lane(name, blocks.get(name)) for name in self.streams if name != CONTACTS}
        joints, waiting = lanes[JOINTS], len(self._waiting)
        at = np.concatenate((np.array([stamp for stamp, _ in self._waiting], dtype=np.int64), joints.stamps))
        if len(at) > CAPACITY:
            raise Irregular
        for name, lane in lanes.items():
            if name != JOINTS:
                lane.waits(self._waiting_rows(name, lane))
        released = self._released(at, waiting, lanes)
        count = len(released)
        states = [state for _, state in self._waiting] + [joints.value(i) for i in range(len(joints.stamps))]
        samples = self._samples(at[:count], states[:count], released, lanes)
        self._watch_block(lanes)
        self._count_overdue_of(lanes, at, released)
        for name, lane in lanes.items():
            if len(lane.new):
                lane.stream.accept_all(lane.new)
            lane.commit()
            if name != JOINTS:
                lane.leave(int(at[count - 1]) if count else None)
        self._waiting.clear()
        self._waiting.extend(zip(at[count:].tolist(), copy.deepcopy(states[count:]), strict=True))
        return samples

    # --- what a block brings, checked: nothing is changed yet ---

    def _lane(self, name: str, block: Block | None) -> _Lane:
        stream = self.streams[name]
        if block is None or not len(block):
            return _Lane(stream, _NONE, _NONE)
        lane = _Lane(stream, np.where(block.stamp_ns > 0, block.stamp_ns - stream.late, block.stamp_ns), block.arrival)
        if not stream.follows(lane.stamps) or len(stream.items) + len(block) > CAPACITY:
            raise Irregular
        if isinstance(block, JointBlock):
            self._add_states(name, block, lane)
        elif isinstance(block, WrenchBlock):
            self._add_wrenches(_FEET[name], block, lane)
        elif isinstance(block, ReferenceBlock):
            self._add_references(block, lane)
        else:
            assert isinstance(block, ImuBlock)
            self._add_imus(block, lane)
        return lane

    def _add_states(self, name: str, block: JointBlock, lane: _Lane) -> None:
        found = self._maps[name].sort_rows(block.names, block.position, block.velocity, block.effort)
        if found is None:
            raise Irregular
        q, qd, tau = found
        if not self.possible.joint_rows(name, lane.stamps, q, qd):
            raise Irregular
        differentiator = self._differentiators[name]
        if qd is None:
            differentiator = copy.deepcopy(differentiator)
            made = [differentiator.update(*item) for item in zip(lane.stamps.tolist(), q, strict=True)]
            if made[0] is None:
                raise Irregular
            qd = np.array(made)
            if (np.abs(qd) > self.possible.limits.speed).any():
                raise Irregular
        torques = [None] * len(q) if tau is None else list(tau)
        states = [JointState(*row) for row in zip(q, qd, torques, strict=True)]

        def commit() -> None:
            self.possible.remember(name, int(lane.stamps[-1]), q[-1])
            self._differentiators[name] = differentiator

        lane.rows, lane.value, lane.commit = (q, qd), states.__getitem__, commit

    def _add_wrenches(self, foot: Foot, block: WrenchBlock, lane: _Lane) -> None:
        matrix = self._wrench_maps.get((foot, block.frame_id))
        if matrix is None:
            matrix = self._wrench_map(foot, block.frame_id)
        out = np.empty((len(block), 6))
        if isinstance(matrix, RobotError) or not self.possible.wrench_rows(matrix, block.wrench, out):
            raise Irregular
        lane.rows, lane.value = (out,), out.__getitem__

    def _add_references(self, block: ReferenceBlock, lane: _Lane) -> None:
        soles = np.array(block.soles)
        plain = all((np.abs(values) < _PLAIN).all() for values in (block.points, soles, block.previews))
        places = soles[:, :, :3, 3]
        if not plain or not self.possible.surely_reference(block.points, places, block.previews, block.preview_dt):
            raise Irregular
        dt = block.preview_dt
        if block.steps is not None and not self.possible.surely_soles(block.steps[0], block.previews[:, 0]):
            raise Irregular
        points, previews, stamps = list(block.points), list(block.previews), block.stamp_ns.tolist()

        @cache  # a plan that serves several samples is one object, as without blocks
        def value(i: int) -> Reference:
            com, com_vel, com_acc, zmp = points[i]
            phase, (ahead, ahead_vel) = _PHASES[block.phase[i]], previews[i]
            steps = None
            if block.steps is not None:
                true = lane.stream.true_stamp(stamps[i])
                steps = PlannedSteps(true, dt, ahead, block.steps[0][i], block.steps[1][i])
            return Reference(
                stamps[i],
                com,
                com_vel,
                com_acc,
                zmp,
                *block.soles[i],
                phase,
                block.step[i],
                dt,
                ahead,
                ahead_vel,
                steps,
            )

        lane.rows, lane.value = (block.points, block.previews), value

    def _add_imus(self, block: ImuBlock, lane: _Lane) -> None:
        turns, shakes = block.angular_velocity, block.linear_acceleration
        if not (all_usable_rows(turns) and all_usable_rows(shakes) and self.possible.surely_imu(turns, shakes)):
            raise Irregular
        stamps = block.stamp_ns.tolist()

        @cache
        def value(i: int) -> ImuMessage:
            orientation = block.orientation[i] if block.oriented[i] else None
            return ImuMessage(stamps[i], block.frame_id, orientation, turns[i], shakes[i])

        lane.value = value

    def _waiting_rows(self, name: str, lane: _Lane) -> tuple[Array | None, ...]:
        """Values that wait in a stream, as in `_Lane.rows`."""
        values = [value for _, value in lane.stream.items]
        n = len(values)
        if name == IMU:
            return ()
        if name == MOTORS:
            size = (n, len(self._robot.joint_names))
            return np.array([v.q for v in values]).reshape(size), np.array([v.qd for v in values]).reshape(size)
        if name != REFERENCE:
            return (np.array(values).reshape(n, 6),)
        alike = {(v.preview_dt, len(v.preview_com)) for v in [*values, *([lane.value(0)] if lane.rows else [])]}
        if len(alike) > 1:
            raise Irregular
        k = max((count for _, count in alike), default=0)
        points = np.array([(v.com, v.com_vel, v.com_acc, v.zmp) for v in values]).reshape(n, 4, 3)
        return points, np.array([(v.preview_com, v.preview_com_vel) for v in values]).reshape(n, 2, k, 3)

    # --- which joint states are complete, and when ---

    def _released(self, at: Integers, waiting: int, lanes: Mapping[str, _Lane]) -> Integers:
        """(count,) arrival of the message that completes each of the joint states `at`, as far as they are complete."""
        joints = lanes[JOINTS]
        ready = np.concatenate((np.full(waiting, -1), joints.arrival))
        for stream in self._expected:
            lane = lanes[stream.name]
            since = _arrival(lane, np.searchsorted(lane.new, at))
            if stream.last is not None:
                since[at <= stream.last] = -1
            ready = np.maximum(ready, since)
        overdue = _arrival(joints, np.searchsorted(joints.stamps, at + self._max_wait, side="right"))
        released = np.maximum.accumulate(np.minimum(ready, overdue))
        return released[: np.searchsorted(released, _NEVER)]

    def _watch_block(self, lanes: Mapping[str, _Lane]) -> None:
        """`_watch_clocks` for all joint states of a block."""
        joints = lanes[JOINTS]
        if not len(joints.stamps):
            return
        for stream in self._expected:
            lane, name = lanes[stream.name], stream.name
            arrived = np.searchsorted(lane.came, joints.arrival)
            known = (arrived > 0) | (stream.last is not None)
            seen = np.where(known, stream.accepted + arrived, self._seen[name])
            fresh = known & (seen != np.concatenate(([self._seen[name]], seen[:-1])))
            self._seen[name] = int(seen[-1])
            if fresh.any():
                last = np.concatenate(([stream.last or 0], lane.new))[arrived[fresh]]
                leads = (last + stream.late - joints.stamps[fresh] - joints.stream.late) * 1e-9
                self.clock_lead_s[name] = smoothed(self.clock_lead_s.get(name, np.nan), leads)

    def _count_overdue_of(self, lanes: Mapping[str, _Lane], at: Integers, released: Integers) -> None:
        """`Stream.take` counts, for all messages of a block; `at`: stamps of joint states, the released ones first."""
        given = np.concatenate(([-_NEVER // 2 if self._given is None else self._given], at[: len(released)]))
        for name, lane in lanes.items():
            if name != JOINTS and len(lane.new):
                ages = given[np.searchsorted(released, lane.came)] - lane.new
                lane.stream.count_overdue(ages[ages > 0].tolist())
        self._given = int(given[-1]) if len(released) else self._given

    # --- giving samples out ---

    def _samples(
        self, at: Integers, states: list[JointState], released: Integers, lanes: Mapping[str, _Lane]
    ) -> list[Sample]:
        if not len(at):
            return []
        found = {}
        for name, lane in lanes.items():
            if name != JOINTS:
                reach = lane.stream.max_age if name == IMU else self._reach
                found[name] = _find(lane, at, released, reach)
        left: list[Array | None] = [None] * len(at)
        right = left
        if self._measures_wrenches:
            left, right = (_mixed(lanes[name], at, found[name])[0] for name in WRENCHES.values())
        motor_q, motor_qd = self._motors_at(at, states, lanes[MOTORS], found[MOTORS])
        plans = _references(lanes[REFERENCE], at, found[REFERENCE])
        imus = _imus(lanes[IMU], at, found[IMU])
        for stream, _ in self._fields:
            self.incomplete[stream.name] += int((found[stream.name].first < 0).sum())
        return [
            Sample(stamp, state.q, state.qd, state.tau, *others)
            for stamp, state, *others in zip(
                at.tolist(), states, motor_q, motor_qd, left, right, plans, imus, strict=True
            )
        ]

    def _motors_at(
        self, at: Integers, states: list[JointState], lane: _Lane, found: _Found
    ) -> tuple[list[Array | None], ...]:
        motor_q, motor_qd = _mixed(lane, at, found)
        if self._maps[MOTORS].partial:
            for state, q, qd in zip(states, motor_q, motor_qd, strict=True):
                if q is not None:
                    rigid = np.isnan(q)
                    q[rigid], qd[rigid] = state.q[rigid], state.qd[rigid]  # type: ignore[index]
        return motor_q, motor_qd


def _arrival(lane: _Lane, index: Integers) -> Integers:
    """Arrivals of the messages of a block with these places in it; beyond its end, never."""
    return np.append(lane.came, _NEVER)[index]


def _find(lane: _Lane, at: Integers, released: Integers, reach: int) -> _Found:
    """The messages around each sample, of those that have come when it is released."""
    available = np.searchsorted(lane.arrival, released, side="right")
    found = _Found(np.empty(len(at), dtype=np.int64), np.empty(len(at), dtype=np.int64))
    brackets(lane.stamps, available, at, lane.stream.max_age, reach, found.first, found.second)
    return found


def _mixed(lane: _Lane, at: Integers, found: _Found) -> list[list[Array | None]]:
    """The values of a stream at each sample, for each of its arrays."""
    result: list[list[Array | None]] = []
    some = found.first >= 0
    for rows in lane.rows:
        assert rows is not None
        out, size = np.empty((len(at), *rows.shape[1:])), math.prod(rows.shape[1:])
        mix_rows(rows.reshape(len(rows), size), lane.stamps, at, *found, out.reshape(len(at), size))
        result.append(
            list(out) if some.all() else [row if there else None for row, there in zip(out, some, strict=True)]
        )
    return result


def _references(lane: _Lane, at: Integers, found: _Found) -> list[Reference | None]:
    points, previews = _mixed(lane, at, found)
    plans: list[Reference | None] = []
    for k, (stamp, i, j) in enumerate(zip(at.tolist(), found.first.tolist(), found.second.tolist(), strict=True)):
        if i < 0:
            plans.append(None)
            continue
        old = int(lane.stamps[i])
        if j < 0 or old == stamp:
            plans.append(later(lane.held(i), stamp - old))
            continue
        nearer = lane.held(j if (stamp - old) / (int(lane.stamps[j]) - old) > 0.5 else i)
        com, com_vel, com_acc, zmp = points[k]  # type: ignore[misc]
        ahead, ahead_vel = previews[k]  # type: ignore[misc]
        plans.append(
            Reference(
                stamp, com, com_vel, com_acc, zmp, nearer.T_odom_left, nearer.T_odom_right, nearer.phase, nearer.step,
                nearer.preview_dt, ahead, ahead_vel, nearer.steps,
            )
        )  # fmt: skip
    return plans


def _imus(lane: _Lane, at: Integers, found: _Found) -> list[ImuMessage | None]:
    """The nearest ones."""
    stamps = lane.stamps
    nearest = [
        j if j >= 0 and stamp - stamps[i] > stamps[j] - stamp else i
        for stamp, i, j in zip(at.tolist(), found.first.tolist(), found.second.tolist(), strict=True)
    ]
    return [lane.held(i) if i >= 0 else None for i in nearest]
