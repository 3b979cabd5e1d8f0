# SPDX-License-Identifier: BSD-3-Clause
"""Joins the streams by stamp: messages in, one Sample for each joint state out.

A joint state at time t waits until every *expected* stream has a message with a stamp of t or later: both wrenches,
or what they are computed from, and the motor states or the reference if the prediction needs them. If one is late or
gone, it waits until a joint state `streams.max_wait` newer has come. Other streams never delay anything: their nearest
message so far is taken. Streams with equal stamps therefore complete at once; a slower stream delays by its period.

Values at t are interpolated between the two messages around it; where only one is near enough, it is taken as it
is; where none is, the value is None. A message later than t counts only within half of `max_wait`. So long as
the streams arrive at most that far apart, Samples do not depend on the order of arrival, to the last bit: each
stream is judged by itself (`streams.Stream`), and what is joined is decided by stamps that have surely come.

Effects may know that the stamps of a stream are late (`encoder_delay`, `wrench_delay`). It is taken off as messages
come in: all else, the stamps of Samples included, is in true time, and joint states wait for late streams that much
longer.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import RobotError
from ..base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..base.types import Array, ContactMessage, Foot, ImuMessage, JointMessage, Reference, Sample, WrenchMessage
from ..config.schema import Config
from ..robot.limits import limits_of
from .differentiate import Differentiator
from .expected import expected_streams
from .joint_map import JointMap, JointState
from .mixing import all_usable, mix, mixed, to_sole
from .possible import Possible
from .preview import later
from .stream import (
    CAPACITY,
    Item,
    Refused,
    Rejections,
    Stream,
    fault,
    usable,
)

if TYPE_CHECKING:
    from ..robot.robot import Robot


class Joiner:
    """Joins one robot's streams. Each `add_*` returns the Samples that are complete now, oldest first.

    Attributes:
        streams: by name, for rates and ages.
        rejections: what was not used and why.
        incomplete: by stream, the number of Samples that went without an expected value.
        possible: what a robot can do at most; messages beyond are refused.
        extra_joints: joints in messages that the URDF lacks (ignored).
        clock_lead_s: by expected stream, how far its stamps are ahead of those of the joint states as they arrive,
            smoothed; about zero if clocks agree and nothing is delayed.
    """

    def __init__(self, robot: Robot, config: Config, delays: Mapping[str, float] | None = None) -> None:
        """Streams as a configuration limits them; `delays`: by stream, how much its stamps are late [s]."""
        limits = config.streams
        self._robot = robot
        self._max_wait = round(limits.max_wait * 1e9)
        self._reach = self._max_wait // 2
        self._gap = round(limits.restart_gap * 1e9)
        self.rejections = Rejections()
        gravity = config.robot.gravity
        weight = config.support.weight or robot.mass * gravity
        self.possible = Possible(robot, limits_of(robot, gravity, weight), limits.restart_gap)

        def stream(name: str, max_age_s: float) -> Stream:
            # What may be this old comes this seldom: a gap of that length is no jump.
            return Stream(name, max_age_s, max(limits.restart_gap, max_age_s), self.rejections)

        self._joints = stream(JOINTS, 0.0)
        self._motors = stream(MOTORS, limits.max_motor_age)
        self._wrenches = {foot: stream(name, limits.max_wrench_age) for foot, name in WRENCHES.items()}
        self._reference = stream(REFERENCE, limits.max_reference_age)
        self._imu = stream(IMU, limits.max_wrench_age)
        self._contacts = stream(CONTACTS, limits.max_wrench_age)
        self._others = (*self._wrenches.values(), self._motors, self._reference, self._imu, self._contacts)
        self.streams = {each.name: each for each in (self._joints, *self._others)}
        self._measures_wrenches = limits.wrench_source == "sensors"
        self._fields = [(self.streams[name], field) for name, field in expected_streams(config).items()]
        self._expected = tuple(each for each, _ in self._fields)
        for each in self.streams.values():
            each.margin = 0 if each in self._expected else each.max_age
            each.late = round(1e9 * (delays or {}).get(each.name, 0.0))
        self._max_wait += max((0, *(each.late - self._joints.late for each in self._expected)))
        self.incomplete = {each.name: 0 for each in self._expected}
        self.clock_lead_s: dict[str, float] = {}
        self._seen = dict.fromkeys(self.incomplete, 0)

        legs = config.robot.left.joints + config.robot.right.joints
        size = len(robot.joint_names)
        # A joint outside the legs without motor-side encoder is rigid: its motor has the link's position, by _sample.
        self._maps = {JOINTS: JointMap(robot.joint_names, legs), MOTORS: JointMap(robot.joint_names, legs, math.nan)}
        self._differentiators = {
            name: Differentiator(limits.velocity_window, limits.restart_gap, size) for name in self._maps
        }
        self._waiting: deque[Item] = deque()
        self._given: int | None = None  # stamp of the last sample, since the joint states went back
        self._wrench_maps: dict[tuple[Foot, str], Array | RobotError] = {}

    @property
    def extra_joints(self) -> tuple[str, ...]:
        """Joints that messages listed and the URDF lacks."""
        return tuple(sorted(set().union(*(each.extra for each in self._maps.values()))))

    @property
    def unlisted_joints(self) -> tuple[str, ...]:
        """Joints of the URDF that no joint state listed: held at zero."""
        return self._maps[JOINTS].unlisted

    @property
    def waiting(self) -> int:
        """Joint states that wait for other streams."""
        return len(self._waiting)

    def add_joint(self, message: JointMessage) -> list[Sample]:
        """A joint state, link side."""
        accepted = self._joint_items(self._joints, message)
        if not accepted:
            return []
        samples = self._restart(accepted[0][0]) if self._joints.jumped else []
        self._watch_clocks()
        for stamp, state in accepted:
            if self._usable(JOINTS, stamp, state):
                self._waiting.append((stamp, state))
        return samples + self._ready() if samples else self._ready()

    def add_motor(self, message: JointMessage) -> list[Sample]:
        """A joint state, motor side."""
        accepted = self._joint_items(self._motors, message)
        samples = self._went_back(self._motors) if self._motors.jumped else []
        self._motors.take([item for item in accepted if self._usable(MOTORS, *item)], self._given)
        return samples + self._ready()

    def add_wrench(self, foot: Foot, message: WrenchMessage) -> list[Sample]:
        """What the ground exerts on a foot."""
        stream = self._wrenches[foot]
        stream.received += 1
        wrench_map = self._wrench_maps.get((foot, message.frame_id))
        if wrench_map is None:
            wrench_map = self._wrench_map(foot, message.frame_id)
        if isinstance(wrench_map, RobotError):
            good = usable(message.force) and usable(message.torque)
        else:
            wrench = np.empty(6)
            good = to_sole(wrench_map, message.force, message.torque, wrench)
        if not good:
            values = np.concatenate((message.force, message.torque))
            return self._reject_values(stream, values, f"force {message.force}, torque {message.torque}")
        if isinstance(wrench_map, RobotError):
            self._reject(stream, "frame", str(wrench_map))
            return []
        return self._add_possible(stream, self.possible.wrench, message.stamp_ns, wrench)

    def add_reference(self, message: Reference) -> list[Sample]:
        """A point of the planned motion."""
        self._reference.received += 1
        values = (
            message.com,
            message.com_vel,
            message.com_acc,
            message.zmp,
            message.T_odom_left,
            message.T_odom_right,
            message.preview_com,
            message.preview_com_vel,
        )
        if message.preview_com_vel.shape != message.preview_com.shape:
            lengths = (
                f"{len(message.preview_com)} positions and {len(message.preview_com_vel)} velocities in its preview"
            )
            self._reject(self._reference, "length", lengths)
            return []
        steps = message.steps
        if steps is not None and not (len(steps.com) == len(steps.soles) == len(steps.phase) and usable(steps.soles)):
            self._reject(self._reference, "length", "the soles of its preview are no numbers, or not one a point")
            return []
        if not all_usable(*values):
            worst = next(each for each in values if not usable(each))
            return self._reject_values(self._reference, worst, f"a vector of it is {worst[:3]}")
        if steps is not None:
            message = replace(message, steps=replace(steps, stamp_ns=self._reference.true_stamp(message.stamp_ns)))
        return self._add_possible(self._reference, self.possible.reference, message.stamp_ns, message)

    def add_imu(self, message: ImuMessage) -> list[Sample]:
        """Orientation and rates of the trunk."""
        self._imu.received += 1
        for values in (message.angular_velocity, message.linear_acceleration):
            if not usable(values):
                return self._reject_values(self._imu, values, f"a vector of it is {values}")
        return self._add_possible(self._imu, self.possible.imu, message.stamp_ns, message)

    def add_contacts(self, message: ContactMessage) -> list[Sample]:
        """Which feet are on the ground."""
        self._contacts.received += 1
        return self._add(self._contacts, message.stamp_ns, message)

    def flush(self) -> list[Sample]:
        """The end: joint states that still wait become Samples with what is there."""
        for stream in self.streams.values():
            stream.finish()
        return self._drain()

    # --- taking messages in ---

    def _reject(self, stream: Stream, reason: str, sentence: str) -> None:
        self.rejections.add(stream.name, reason, sentence)

    def _reject_values(self, stream: Stream, values: Array, sentence: str) -> list[Sample]:
        self._reject(stream, fault(float(values.sum())), " ".join(sentence.split()))
        return []

    def _add_possible(self, stream: Stream, check: Callable[[Any], None], stamp: int, value: Any) -> list[Sample]:
        try:
            check(value)
        except Refused as refused:
            self._reject(stream, refused.reason, str(refused))
            return []
        return self._add(stream, stamp, value)

    def _add(self, stream: Stream, stamp: int, value: object) -> list[Sample]:
        accepted = stream.accept(stream.true_stamp(stamp), value)
        samples = self._went_back(stream) if stream.jumped else []
        stream.take(accepted, self._given)
        if stream not in self._expected:  # nothing waits for it
            return samples
        return samples + self._ready() if samples else self._ready()

    def _joint_items(self, stream: Stream, message: JointMessage) -> tuple[Item, ...]:
        stream.received += 1
        try:
            state = self._maps[stream.name].sort(message)
        except Refused as refused:
            self._reject(stream, refused.reason, str(refused))
            return ()
        return stream.accept(stream.true_stamp(message.stamp_ns), state)

    def _usable(self, name: str, stamp: int, state: JointState) -> bool:
        """Whether a joint state is possible; a velocity that it does not give is filled in."""
        try:
            self.possible.joints(name, stamp, state)
            if state.qd is None:
                state.qd = self._velocity(name, stamp, state.q)
        except Refused as refused:
            self.streams[name].withdraw(refused.reason, str(refused))
            return False
        return True

    def _velocity(self, name: str, stamp: int, q: Array) -> Array:
        """Differentiated positions.

        Raises:
            Refused: there is but one, or no joint is that fast.
        """
        qd = self._differentiators[name].update(stamp, q)
        if qd is None:
            raise Refused("no_velocity", "gives no velocities, and one position makes none")
        self.possible.speeds(qd)
        return qd

    def _wrench_map(self, foot: Foot, frame_id: str) -> Array | RobotError:
        """(6, 6) matrix from wrenches in a frame to the sole's, or why there is none."""
        result: Array | RobotError
        try:
            unit = np.eye(6)
            result = np.array([self._robot.wrench_to_sole(foot, frame_id, e[:3], e[3:]) for e in unit]).T.copy()
        except RobotError as error:
            result = error
        if len(self._wrench_maps) >= 64:  # a broken driver may name another frame every time
            self._wrench_maps.clear()
        self._wrench_maps[foot, frame_id] = result
        return result

    # --- clocks that differ or go back ---

    def _watch_clocks(self) -> None:
        """Compare clocks at a joint state, with the streams that came since the last: one that stopped is no clock.

        Nor is one that a restart has emptied (`last` is None): what came before belongs to the run before.
        """
        for stream in self._expected:
            if stream.last is not None and stream.accepted != self._seen[stream.name]:
                self._seen[stream.name] = stream.accepted
                # What the clocks say, whatever is known of them: a configured delay is no news.
                lead = (stream.last + stream.late - self._joints.last - self._joints.late) * 1e-9  # type: ignore[operator]
                before = self.clock_lead_s.get(stream.name, lead)
                self.clock_lead_s[stream.name] = before + 0.05 * (lead - before)

    def _restart(self, stamp: int) -> list[Sample]:
        """The joint states went back (bag loop): finish what waits, forget what belongs to the run before."""
        self._joints.jumped = False
        samples = self._drain()
        for stream in self._others:
            stream.went_back = False
            if stream.last is not None and stream.last > stamp + self._gap:
                stream.start_afresh()
                if stream is self._motors:  # its first message was known by its stamp alone
                    first = tuple(stream.items)
                    stream.items.clear()
                    stream.items.extend(item for item in first if self._usable(MOTORS, *item))
        self.clock_lead_s.clear()
        self._given = None
        return samples

    def _went_back(self, stream: Stream) -> list[Sample]:
        """Another stream went back: its messages so far serve the joint states that wait, and no others."""
        stream.jumped = False
        samples = self._drain()
        stream.items.clear()
        return samples

    # --- giving samples out ---

    def _ready(self) -> list[Sample]:
        samples: list[Sample] = []
        waiting = self._waiting
        while waiting:
            stamp = waiting[0][0]
            overdue = self._joints.last - stamp > self._max_wait or len(waiting) > CAPACITY  # type: ignore[operator]
            if not overdue:
                for stream in self._expected:
                    if stream.last is None or stream.last < stamp:
                        return samples
            samples.append(self._sample(*waiting.popleft()))
        return samples

    def _drain(self) -> list[Sample]:
        samples = [self._sample(*item) for item in self._waiting]
        self._waiting.clear()
        return samples

    def _sample(self, stamp: int, state: JointState) -> Sample:
        self._given = stamp
        sample = Sample(
            stamp,
            state.q,
            state.qd,  # type: ignore[arg-type]
            state.tau,
        )
        if self._measures_wrenches:
            sample.left_wrench, sample.right_wrench = (self._wrench_at(foot, stamp) for foot in WRENCHES)
        if self._contacts.items:
            sample.contacts = self._contacts.latest(stamp)
        if self._motors.items:
            self._join_motors(sample)
        if self._reference.items:
            sample.reference = self._reference_at(stamp)
        if self._imu.items:
            sample.imu = self._imu.nearest(stamp)
        for stream, field in self._fields:
            if getattr(sample, field) is None:
                self.incomplete[stream.name] += 1
        return sample

    # What follows copies what it takes as it is: effects correct Samples in place.

    def _wrench_at(self, foot: Foot, stamp: int) -> Array | None:
        before, after = self._wrenches[foot].bracket(stamp, self._reach)
        if before is None:
            return None if after is None else after[1].copy()
        if after is None or before[0] == stamp:
            return before[1].copy()
        wrench = np.empty(6)
        mix(before[1], after[1], (stamp - before[0]) / (after[0] - before[0]), wrench)
        return wrench

    def _join_motors(self, sample: Sample) -> None:
        stamp = sample.stamp_ns
        before, after = self._motors.bracket(stamp, self._reach)
        if before is not None and after is not None and before[0] != stamp:
            weight = (stamp - before[0]) / (after[0] - before[0])
            old, new = before[1], after[1]
            sample.motor_q = old.q + weight * (new.q - old.q)
            sample.motor_qd = old.qd + weight * (new.qd - old.qd)
        elif (found := before or after) is not None:
            sample.motor_q, sample.motor_qd = found[1].q.copy(), found[1].qd.copy()
        if sample.motor_q is not None and self._maps[MOTORS].partial:
            rigid = np.isnan(sample.motor_q)
            sample.motor_q[rigid] = sample.q[rigid]
            sample.motor_qd[rigid] = sample.qd[rigid]  # type: ignore[index]

    def _reference_at(self, stamp: int) -> Reference | None:
        before, after = self._reference.bracket(stamp, self._reach)
        if before is None or after is None or before[0] == stamp:
            found = before or after
            return None if found is None else later(found[1], stamp - found[0])
        return mixed(before[1], after[1], (stamp - before[0]) / (after[0] - before[0]), stamp)
