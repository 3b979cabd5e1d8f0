# SPDX-License-Identifier: BSD-3-Clause
"""Refuses messages whose values contradict physics: well formed, finite, and yet of no robot like this one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array, ImuMessage, Integers, Reference
from ..robot.limits import Limits
from .joint_map import JointState
from .mixing import to_sole
from .stream import Refused

if TYPE_CHECKING:
    from ..robot.robot import Robot

_SHAKE = 50.0  # times gravity: what an IMU on a trunk may measure at a landing
_UNIT = 0.1  # by which the squared length of a quaternion may differ from 1
_SURE = 1.0 - 1e-9  # of a limit: below it, rounding cannot matter
_LIMIT, _STEP, _SPEED = range(3)


@dataclass
class Refusals:
    """Positions (nj,) that were beyond the limits: where all of them are, their unit is wrong and no single message."""

    count: int
    lowest: Array
    highest: Array


@dataclass(slots=True)
class _Last:
    """The last position that was accepted of a stream."""

    stamp_ns: int
    q: Array


class Possible:
    """What a robot can do at most: checks one message after the other.

    Attributes:
        beyond: by stream of joints, the positions beyond their limits that were refused.
    """

    def __init__(self, robot: Robot, limits: Limits, gap_s: float) -> None:
        """Limits of a robot; after a gap of `gap_s` [s] joints may be anywhere."""
        self._robot = robot
        self.limits = limits
        self._gap = round(gap_s * 1e9)
        self._table = np.array([limits.lower, limits.upper, limits.step, limits.speed])
        self._last: dict[str, _Last] = {}
        self._still = np.zeros(len(robot.joint_names))
        self._turn_rate = 2.0 * math.pi / math.sqrt(limits.reach / 4.0 / limits.gravity)
        self.beyond: dict[str, Refusals] = {}

    def joints(self, stream: str, stamp_ns: int, state: JointState) -> None:
        """Check a joint state of link or motor side.

        Raises:
            Refused: a position beyond its limits, a step in no time, or a speed that no joint has.
        """
        last, q = self._last.get(stream), state.q
        before, dt = q, 0.0
        if last is not None and 0 < stamp_ns - last.stamp_ns <= self._gap:
            before, dt = last.q, (stamp_ns - last.stamp_ns) * 1e-9
        found = impossible(q, before, self._still if state.qd is None else state.qd, dt, self._table)
        if found >= 0:
            self._refuse(stream, *divmod(found, len(q)), state, dt)
        self.remember(stream, stamp_ns, q)

    def speeds(self, qd: Array) -> None:
        """Check velocities (nj,) that were differentiated [rad/s].

        Raises:
            Refused: a speed that no joint has.
        """
        fast = np.abs(qd) > self.limits.speed
        if fast.any():
            self._refuse_speed(int(fast.argmax()), qd)

    def wrench(self, wrench: Array) -> None:
        """Check a wrench (6,) [N, Nm].

        Raises:
            Refused: many times the weight.
        """
        limits = self.limits
        if within(wrench, limits.force, limits.moment):
            return
        force, moment = math.hypot(*wrench[:3]), math.hypot(*wrench[3:])
        if force > limits.force:
            raise Refused(
                "limit", f"a force of {force:.4g} N; above {limits.force:.4g} N no robot of this weight stands"
            )
        raise Refused("limit", f"a moment of {moment:.4g} Nm; no more than {limits.moment:.4g} Nm is plausible")

    def imu(self, message: ImuMessage) -> None:
        """Check angular velocity and acceleration of the trunk.

        Raises:
            Refused: no trunk turns or shakes like that.
        """
        turn, shake = math.hypot(*message.angular_velocity), math.hypot(*message.linear_acceleration)
        if turn > self._turn_rate:
            raise Refused("limit", f"an angular velocity of {turn:.4g} rad/s; no trunk turns as fast")
        if shake > _SHAKE * self.limits.gravity:
            raise Refused("limit", f"an acceleration of {shake:.4g} m/s^2; no trunk is shaken as much")

    def reference(self, message: Reference) -> None:
        """Check a plan against its own soles.

        Raises:
            Refused: a COM, a ZMP or a preview that is out of reach, or faster than any runner.
        """
        limits = self.limits
        soles = np.array((message.T_odom_left[:3, 3], message.T_odom_right[:3, 3]))
        for name, point in (("COM", message.com), ("ZMP", message.zmp)):
            far = min(math.hypot(*(point - sole)) for sole in soles)
            if far > limits.reach:
                raise Refused("limit", f"its {name} is {far:.4g} m from both soles, out of reach")
        fastest = max(map(_longest, (message.com_vel[None], message.preview_com_vel)))
        if fastest > limits.com_speed:
            raise Refused("limit", f"a COM velocity of {fastest:.4g} m/s; no walker is that fast")
        farthest = _longest(message.preview_com - message.com)
        if farthest > limits.reach + limits.com_speed * len(message.preview_com) * message.preview_dt:
            raise Refused("limit", f"its preview ends {farthest:.4g} m from its COM, out of reach")
        if message.steps is not None:
            far, turn = _soles_of(message.steps.soles, message.steps.com)
            if far > limits.reach:
                raise Refused("limit", f"its preview has a sole {far:.4g} m from the COM, out of reach")
            if not turn < _UNIT:
                raise Refused("limit", "its preview has the orientation of a sole that is no unit quaternion")

    def joint_rows(self, stream: str, stamps: Integers, q: Array, qd: Array | None) -> bool:
        """Whether `joints` would take all these states (n, nj), which follow each other."""
        last = self._last.get(stream)
        before, before_ns = (self._still, 0) if last is None else (last.q, last.stamp_ns)
        return all_possible(
            q, np.zeros_like(q) if qd is None else qd, stamps, before, before_ns, self._gap, self._table
        )

    def remember(self, stream: str, stamp_ns: int, q: Array) -> None:
        """The last state that was taken (nj,)."""
        self._last[stream] = _Last(stamp_ns, q.copy())  # effects correct samples in place

    def wrench_rows(self, matrix: Array, wrenches: Array, out: Array) -> bool:
        """Write wrenches (n, 6) by the matrix (6, 6) to their sole; whether all are usable and `wrench` takes them."""
        return sole_rows(matrix, wrenches, self.limits.force, self.limits.moment, out)

    def surely_imu(self, angular_velocity: Array, acceleration: Array) -> bool:
        """Whether `imu` would take all these rates and accelerations (n, 3), with a margin for rounding."""
        turn, shake = _longest(angular_velocity), _longest(acceleration)
        return turn < _SURE * self._turn_rate and shake < _SURE * _SHAKE * self.limits.gravity

    def surely_reference(self, points: Array, soles: Array, previews: Array, preview_dt: float) -> bool:
        """Whether `reference` would take all these plans, with a margin for rounding.

        Args:
            points: (n, 4, 3) COM, its velocity and acceleration, ZMP.
            soles: (n, 2, 3) places of the left and the right sole.
            previews: (n, 2, k, 3) positions, velocities.
            preview_dt: [s].
        """
        limits, k = self.limits, previews.shape[2]
        far = np.square(points[:, None, [0, 3]] - soles[:, :, None]).sum(axis=3).min(axis=1)
        ahead = np.square(previews[:, 0] - points[:, None, 0]).sum(axis=2).max(initial=0.0)
        fastest = max(_longest(points[:, 1]), _longest(previews[:, 1].reshape(-1, 3)))
        if not math.sqrt(far.max()) < _SURE * limits.reach or not fastest < _SURE * limits.com_speed:
            return False
        return math.sqrt(ahead) < _SURE * (limits.reach + limits.com_speed * (k * preview_dt if k else 0.0))

    def surely_soles(self, soles: Array, com: Array) -> bool:
        """The same for the feet of their previews: soles (n, k, 14) and COM (n, k, 3)."""
        far, turn = _soles_of(soles.reshape(-1, 14), com.reshape(-1, 3))
        return far < _SURE * self.limits.reach and turn < _SURE * _UNIT

    def _refuse(self, stream: str, kind: int, i: int, state: JointState, dt: float) -> NoReturn:
        name, limits, q = self._robot.joint_names[i], self.limits, state.q
        if kind == _LIMIT:
            self._remember(stream, q)
            hint = "in degrees? wanted are radians" if abs(q[i]) > 2.0 * math.pi else "are those of the URDF right?"
            text = f"{name} is at {q[i]:.4g} rad, by far beyond its limits (refused below {limits.lower[i]:.3g} and"
            raise Refused("limit", f"{text} above {limits.upper[i]:.3g}): {hint}")
        if kind == _STEP:
            step = q[i] - self._last[stream].q[i]
            raise Refused("step", f"{name} moves by {step:.3g} rad in {1e3 * dt:.3g} ms, which no joint can")
        assert state.qd is not None
        self._refuse_speed(i, state.qd)

    def _refuse_speed(self, i: int, qd: Array) -> NoReturn:
        name, most = self._robot.joint_names[i], self.limits.speed[i]
        raise Refused("speed", f"{name} moves at {qd[i]:.4g} rad/s; above {most:.3g} rad/s nothing is believed")

    def _remember(self, stream: str, q: Array) -> None:
        beyond = self.beyond.setdefault(stream, Refusals(0, q, q))
        beyond.count += 1
        beyond.lowest, beyond.highest = np.fmin(beyond.lowest, q), np.fmax(beyond.highest, q)


@compiled
def impossible(q: Array, last: Array, qd: Array, dt: float, table: Array) -> int:
    """Kind times the number of joints, plus the joint, of the first thing that no joint does; -1: all is possible.

    Where a motor does not exist its values are NaN, and possible. `table` (4, nj): `Limits` lower, upper, step, speed.
    """
    n = q.shape[0]
    for i in range(n):
        if q[i] < table[0, i] or q[i] > table[1, i]:
            return _LIMIT * n + i
        if abs(q[i] - last[i]) > table[2, i] + table[3, i] * dt:
            return _STEP * n + i
        if abs(qd[i]) > table[3, i]:
            return _SPEED * n + i
    return -1


@compiled
def within(wrench: Array, force: float, moment: float) -> bool:
    """Whether force and moment of a wrench (6,) are within limits [N, Nm]."""
    f, m = wrench[:3], wrench[3:]
    return f.dot(f) <= force * force and m.dot(m) <= moment * moment


def _longest(vectors: Array) -> float:
    """Of vectors (n, 3); 0 without any."""
    return float(np.sqrt(np.square(vectors).sum(axis=1)).max(initial=0.0))


def _soles_of(soles: Array, com: Array) -> tuple[float, float]:
    """Of n points: how far a sole (n, 14) is from the COM (n, 3) [m], and how far its quaternion from a unit one."""
    poses = soles.reshape(-1, 2, 7)
    turns = np.abs(np.square(poses[..., 3:]).sum(axis=2) - 1.0)
    return _longest((poses[..., :3] - com[:, None]).reshape(-1, 3)), float(turns.max(initial=0.0))


@compiled
def all_possible(q: Array, qd: Array, stamps: Integers, last: Array, last_ns: int, gap: int, table: Array) -> bool:
    """Whether no joint does what none can, from the state `last` (nj,) at `last_ns` on; 0: there was none."""
    for k in range(q.shape[0]):
        before, before_ns = (q[k - 1], stamps[k - 1]) if k else (last, last_ns)
        since, dt = stamps[k] - before_ns, 0.0
        if before_ns > 0 and 0 < since <= gap:
            dt = since * 1e-9
        else:
            before = q[k]
        if impossible(q[k], before, qd[k], dt, table) >= 0:
            return False
    return True


@compiled
def sole_rows(matrix: Array, wrenches: Array, force: float, moment: float, out: Array) -> bool:
    """Write wrenches (n, 6) by the matrix (6, 6) to their sole; whether all are usable and possible."""
    for k in range(wrenches.shape[0]):
        if not to_sole(matrix, wrenches[k, :3], wrenches[k, 3:], out[k]) or not within(out[k], force, moment):
            return False
    return True
