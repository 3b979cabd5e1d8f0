# SPDX-License-Identifier: BSD-3-Clause
"""What the motors will do: what the plan asks of them, where its preview says how the feet step.

A robot that sets off or stops repeats no stride, but its plan has all that the stride before would contain: inverse
kinematics of COM and soles gives the joints, their loads give the deflection, by a share of which the motors lead (the
share is found from the motors so far), and the posture gives the equations of motion. They are laid out as the stride
before is (`memory.py`), and simulated in the same way. By how much the motors differ from the plan now stays.
"""

from __future__ import annotations

from copy import copy
from math import exp

import numpy as np

from ...base.compiled import Held, compiled, hold, mul
from ...base.pose import LEVEL
from ...base.types import Array, Foot, Integers, Phase, PlannedDeflection, PlannedSteps, Reference
from ...config.schema import Config
from ...effects.foot_slip import FootSlip
from ...effects.hooks import STANDS, Now
from ...effects.hysteresis import Hysteresis
from ...effects.touchdown_impact import TouchdownImpact
from ...feedforward.feedforward import Feedforward
from ...measured.standing import STEP as KERB
from ...robot.robot import Robot
from ..cartesian import Model
from ..reference import motor_com
from .contact import ROWS, State
from .course import EVERY, Start, along, shift, simulate
from .equations import Equations
from .kinematics import Assembled, terms_size
from .memory import STEP, Memory, empty_memory, keep

_SPACING_NS = 19_000_000  # between points that are used at least
_AT_ONCE = 2  # points that a sample adds at most: inverse kinematics take long
_GAP_NS = 3 * _SPACING_NS  # between two points, from which on the plan is taken from the beginning
_INTERVALS = 0.001, 0.06  # [s] of previews that are used: through points farther apart no motion can be followed
_CAPACITY, _KEPT = 320, 192  # points remembered at most, and how many are kept when there are more
_NEAR_NS = 60_000_000  # a point no farther from now shows by how much the motors lead
_MEMORY = 8.0  # [s] time constant with which the lead is forgotten
_LONGEST = 0.1  # [s] that one sample counts for at most
_MOST = 1.2  # share of the planned deflection that motors lead by at most
_CHANGED, _TURNED = 0.02, 0.05  # [m], [rad] by which a plan may differ from what it was
_OTHER = 3  # points at most at which its phase may: a change of phase falls between two of them
_PAUSE_NS = 200_000_000  # after a plan that differed more, until the next one is taken
_UNKNOWN, _ANOTHER, _STANDS, _STEPS = range(4)  # what the plan says ahead
Times = tuple[int, int, float]  # of `PlannedSteps`: stamps of the message and of the last point [ns], and dt
Points = tuple[Array, Array, Integers]  # of it: com, soles, phase
_REMEMBER = (Hysteresis, TouchdownImpact, FootSlip)  # effects that do
_NO_ACCELERATION, _NO_ZMP = np.zeros(3), np.full(3, np.nan)


def _with_effects_of_its_own(model: Model) -> Model:
    """Slips and blows of now are not those of a point to come, which must not move them either."""
    made = copy(model)
    made.effects = [copy(e) if isinstance(e, _REMEMBER) else e for e in model.effects]
    made.springs = model.springs.of_effects(made.effects)
    return made


class PlannedWalk:
    """Motors and equations of motion to come, and the model simulated through them.

    Attributes:
        stands: whether the plan has no foot in the air, as far as it is known: in the last second, and ahead.
    """

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        """Share the constants of the point-mass model, and its effects but for those that remember what was."""
        self._model = model = _with_effects_of_its_own(model)
        self._robot, self._friction = robot, config.model.friction
        self._feedforward = Feedforward.of(robot, model.springs, model.gravity)
        self._equations = Equations(robot, config, model)
        self._motors = robot.posture()
        self._columns, self._order = robot.idx_v, self._equations.order
        self._legs = np.concatenate((robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]))
        self._soles = np.array([robot.soles[Foot.LEFT], robot.soles[Foot.RIGHT]])
        m = len(self._legs)
        self._state = State(np.zeros(m + 6), np.zeros(m + 6), np.zeros(2 * ROWS))  # of a point
        self._memory = empty_memory(m, _CAPACITY)
        self._held = hold(self._memory)
        self._feet = np.zeros((_CAPACITY, 2, 4, 4))  # planned poses of both soles at the same points
        self._joints = np.zeros((_CAPACITY, 2, m))  # and joints and deflection, the left leg's first
        self._lead = np.zeros(2)  # fading sums: lead times deflection, deflection squared
        self._far_ns = round(1e9 * (max(config.prediction.horizons, default=0.0) + EVERY)) + _GAP_NS
        self._paused_ns = 0  # until then no plan is taken
        self.forget()
        # Compiled or loaded now, not in the middle of a walk.
        zero = State(np.zeros(m + 6), np.zeros(m + 6), np.zeros(2 * ROWS))
        start = Start(0, int(Foot.LEFT), np.zeros(terms_size(m)), zero, np.eye(4))
        nothing = PlannedSteps(0, 0.0, np.zeros((0, 3)), np.zeros((0, 14)), np.zeros(0, dtype=np.int64))
        self._through(start, 0.0, nothing)
        along(np.zeros((2, 6 + m)), 0.0, np.zeros(1), np.eye(4))
        _learn_lead(np.zeros(2), self._memory.stamp, 1, self._joints, 0, np.zeros(len(robot.idx_v)), self._legs, 1.0)

    def forget(self) -> None:
        """Forget the past, slips of springs included, but for the share of the lead."""
        for effect in self._model.effects:
            if isinstance(effect, _REMEMBER):
                effect.reset()
        self.reset()

    def reset(self) -> None:
        """Take the plan from the beginning."""
        self._feedforward.reset()
        self._equations.reset()
        self._n = self._last_ns = 0  # points kept; stamp of the last one that was looked at
        self._before: Assembled | None = None
        self._course_ns = 0
        self._course: Array | None = None  # as in `Stride`
        self._added = False  # a point, at this sample
        self.stands = False

    @property
    def share(self) -> float:
        """Of the planned deflection, by which the motors lead."""
        return min(_MOST, max(0.0, -self._lead[0] / self._lead[1])) if self._lead[1] > 0.0 else 0.0

    def add(self, now: Now, ground: dict[Foot, Array], down: Array) -> None:
        """Take in what the plan of a sample says.

        Args:
            now: this sample.
            ground: by support foot, (3,) under the other sole, as in `contact.Sole`, as far as it is known.
            down: (3,) direction of gravity in odom.
        """
        self._added = False
        plan, paused = now.sample.reference, 0 < self._paused_ns - now.sample.stamp_ns < _PAUSE_NS
        steps = None if plan is None or paused else plan.steps
        if steps is None or now.sample.motor_q is None or not _INTERVALS[0] <= steps.dt <= _INTERVALS[1]:
            if self._last_ns:
                self.reset()
            return
        if down is not LEVEL:  # from the odom of the feet into that of the plan, by the support sole
            assert plan is not None
            down = plan.sole_pose(now.support.support_foot)[:3, :3] @ (now.T_odom_sole[:3, :3].T @ down)
        dt = round(1e9 * steps.dt)
        if not 0 <= self._last_ns - steps.stamp_ns <= (len(steps.com) + 1) * dt:  # it began again, or was away
            self.reset()
            self._last_ns = steps.stamp_ns
        if not self._feedforward.started:
            self._feedforward.start(now.sample.q)
        self._learn(now)
        often = now.dt < 0.5e-9 * _SPACING_NS
        for _ in range(1 if often and self._course is not None else _AT_ONCE):
            k = max(0, -((steps.stamp_ns - self._last_ns - _SPACING_NS) // dt) - 1)
            if k >= len(steps.com) or (self._n and not self._lead[1] > 0.0):
                return
            if self._last_ns - now.sample.stamp_ns > self._far_ns:
                return
            self._last_ns, self._added = steps.stamp_ns + (k + 1) * dt, often
            self._feedforward.set_surroundings(now.sample.motor_q, down)
            planned = self._feedforward.update(_point(steps, k, self._last_ns))
            if planned is not None:
                if self._n and planned.stamp_ns - int(self._memory.stamp[self._n - 1]) > max(_GAP_NS, 2 * dt):
                    self.reset()  # points between are missing: nothing can be followed through the hole
                    return
                self._keep(now, planned, ground, down)
                if not self._lead[1] > 0.0:
                    self._learn(now)

    def ahead(self, now: Now, terms: Assembled, state: State, horizons: Array) -> Array | None:
        """As in `Stride`; None: the plan does not say it, or it says that the robot stands."""
        stamp = now.sample.stamp_ns
        # Beside a point that has just been added there is no time to simulate: where samples come often, the next will.
        late = STEP if self._added and self._course is not None else 0.0
        if not 0.0 <= (stamp - self._course_ns) * 1e-9 < EVERY + late:
            self._course_ns, self._course = stamp, self._simulate(now, terms, state, float(horizons[-1]) + EVERY)
        if self._course is None:
            return None
        return along(self._course, (stamp - self._course_ns) * 1e-9, horizons, now.T_odom_sole)

    def _learn(self, now: Now) -> None:
        """By how much the motors lead."""
        if not self._n or now.sample.motor_q is None:
            return
        keep = exp(-min(max(now.dt, 0.0), _LONGEST) / _MEMORY)
        _learn_lead(
            self._lead, self._memory.stamp, self._n, self._joints, now.sample.stamp_ns, now.sample.motor_q, self._legs,
            keep,
        )  # fmt: skip

    def _keep(self, now: Now, planned: PlannedDeflection, ground: dict[Foot, Array], down: Array) -> None:
        """Keep motors and equations of the point of a planned deflection."""
        plan, q, v = self._feedforward.planned
        if self._n == _CAPACITY:
            for column in (*self._memory, self._feet, self._joints):
                column[:_KEPT] = column[-_KEPT:]
            self._n = _KEPT
        memory, n, sample = self._memory, self._n, now.sample
        assert sample.motor_q is not None and sample.motor_qd is not None
        foot = Foot(int(memory.foot[n - 1])) if n else now.foot
        if plan.phase != Phase.DOUBLE:
            foot = Foot(int(plan.phase))
        double, order = plan.phase == Phase.DOUBLE, self._order[foot]
        links, rates, loads = self._robot.gather(q), v[self._columns], self._feedforward.loads
        theta, theta_rate, state = sample.motor_q.copy(), sample.motor_qd.copy(), self._state
        _set_joints(
            theta, theta_rate, state, links, rates, self._legs, order, self.share * planned.deflection, loads, int(foot)
        )
        sole, other, plane = plan.sole_pose(foot), plan.sole_pose(foot.other), ground[foot]
        if double:
            height = float(sole[:3, 2] @ (other[:3, 3] - sole[:3, 3]))
            if abs(height - plane[0]) > KERB:  # it stands on a step that the plan knows
                plane = np.array((height, *plane[1:]))
        dt = 1e-9 * (planned.stamp_ns - int(memory.stamp[n - 1])) if n else 0.0
        axes, motors = np.ascontiguousarray(sole[:3, :3]), (theta, theta_rate, dt)
        made = self._equations.assemble(now, foot, state, double, plane, down, axes, self._before, motors)
        self._motors.update(theta, theta_rate)
        com = motor_com(self._motors, foot)[0]
        keep(self._held, n, planned.stamp_ns, made.block, int(foot), double, sole, plan.com, axes, com)
        self._feet[n] = plan.T_odom_left, plan.T_odom_right
        self._joints[n] = links[self._legs], planned.deflection
        self._n, self._before = n + 1, made

    def _simulate(self, now: Now, terms: Assembled, state: State, span: float) -> Array | None:
        stamp, plan = now.sample.stamp_ns, now.sample.reference
        self.stands = False
        if self._n < 2 or plan is None or plan.steps is None:
            return None
        start = Start(stamp, int(terms.foot), terms.block, state, now.T_odom_sole)
        found, course = self._through(start, span, plan.steps)
        if found == _ANOTHER:
            self.reset()
            self._paused_ns = stamp + _PAUSE_NS
        self.stands = found == _STANDS
        return course if found == _STEPS else None

    def _through(self, start: Start, span: float, steps: PlannedSteps) -> tuple[int, Array]:
        plan = (steps.stamp_ns, steps.end_ns, steps.dt), (steps.com, steps.soles, steps.phase)
        made: tuple[int, Array] = _through(
            start, span, *plan, self._held, self._n, self._feet, self._soles, self._friction
        )
        return made


def _point(steps: PlannedSteps, k: int, stamp_ns: int) -> Reference:
    """The k-th point of a preview."""
    left, right = np.empty((2, 4, 4))
    _set_poses(left, right, steps.soles[k])
    phase = Phase(int(steps.phase[k]))
    return Reference(stamp_ns, steps.com[k], _NO_ACCELERATION, _NO_ACCELERATION, _NO_ZMP, left, right, phase, 0)


@compiled
def _set_poses(left: Array, right: Array, soles: Array) -> None:
    """Fill in poses (4, 4) by one of the `soles` of `PlannedSteps` (14,)."""
    _set_pose(left, soles[:7])
    _set_pose(right, soles[7:])


@compiled
def _set_pose(T: Array, sole: Array) -> None:
    """`base.pose.matrix` of a position and a quaternion (7,), into (4, 4)."""
    x, y, z, w = sole[3:]
    norm = x * x + y * y + z * z + w * w
    s = 2.0 / norm if norm > 1e-12 else np.nan
    T[0, 0], T[0, 1], T[0, 2] = 1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)
    T[1, 0], T[1, 1], T[1, 2] = s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)
    T[2, 0], T[2, 1], T[2, 2] = s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)
    for i in range(3):
        T[i, 3], T[3, i] = sole[i], 0.0
    T[3, 3] = 1.0


@compiled
def _set_joints(
    theta: Array, theta_rate: Array, state: State, links: Array, rates: Array, legs: Array, order: Integers,
    lead: Array, loads: Array, foot: int,
) -> None:  # fmt: skip
    """Fill in motors (nj,) of the legs and the state of a point with joints links, rates (nj,) [rad], [rad/s].

    Args:
        legs, order: (m,) indices of the legs' joints, the left leg's and the support leg's first.
        lead: (m,) by which the motors lead, as in `legs` [rad].
        loads: (2,) of the left and the right foot [N].
        foot: the support foot.
    """
    for j in range(legs.shape[0]):
        theta[legs[j]], theta_rate[legs[j]] = links[legs[j]] - lead[j], rates[legs[j]]
        state.y[j], state.w[j] = links[order[j]], rates[order[j]]
    for corner in range(4):
        state.P[corner], state.P[ROWS + corner] = loads[foot - 1], loads[2 - foot]


@compiled
def _learn_lead(
    lead: Array, stamps: Integers, n: int, joints: Array, stamp: int, motor_q: Array, legs: Array, keep: float
) -> None:
    """`PlannedWalk._learn`: sums `lead` (2,), of which a share is kept, by the first of n points that is not before."""
    i = n - 1
    while i > 0 and stamps[i - 1] >= stamp:
        i -= 1
    if abs(stamps[i] - stamp) > _NEAR_NS:
        return
    lead *= keep
    for j in range(legs.shape[0]):
        deflection = joints[i, 1, j]
        lead[0] += (motor_q[legs[j]] - joints[i, 0, j]) * deflection
        lead[1] += deflection * deflection


@compiled
def _through(
    start: Start, span: float, times: Times, plan: Points, memory: Held, n: int, feet: Array, soles: Array,
    friction: float,
) -> tuple[int, Array]:  # fmt: skip
    """The model simulated through the planned steps, as far as the plan is still what it was but for its COM.

    Args:
        start, n, soles, friction: as in `simulate`.
        span: how far ahead [s].
        times, plan: of the present plan.
        memory: `Memory` of points.
        feet: (n, 2, 4, 4) poses of the soles there.

    Returns:
        `_STEPS` with a course as in `Stride`; else without: `_UNKNOWN`, points of it are missing; `_ANOTHER`, the plan
        is another one; `_STANDS`, it has no foot in the air.
    """
    past, stamp = memory.value, start.stamp
    stamps, course = past.stamp[:n], np.empty((0, 6 + past.theta.shape[1]))
    if not (n > 1 and stamps[0] <= stamp and stamp + 1e9 * span <= stamps[n - 1] + _SPACING_NS):
        return _UNKNOWN, course
    (begins, ends, dt), (com, poses, phase) = times, plan
    first = int(np.searchsorted(stamps, begins + int(np.rint(1e9 * dt))))
    change = np.empty((max(0, int(np.searchsorted(stamps, ends, "right")) - first), 3))
    if not change.shape[0] or not _replanned(change, past, feet, (first, begins, dt), com, poses, phase):
        return _ANOTHER, course
    if past.double[np.searchsorted(stamps, stamp - int(1e9 * STANDS)) : n].all():
        return _STANDS, course
    sole = feet[max(0, int(np.searchsorted(stamps, stamp)) - 1), start.foot - 1]
    course = simulate(start, sole, stamp, int(np.ceil(span / STEP)) + 1, past, n, soles, friction, True)
    moved, k = np.empty((course.shape[0], 3)), 0
    for i in range(moved.shape[0]):  # linear between points, as at the last one beyond it; all stamps as floats
        t = stamp + 1e9 * STEP * i
        while k + 2 < change.shape[0] and stamps[first + k + 1] <= t:
            k += 1
        j = min(k + 1, change.shape[0] - 1)
        begin, end = float(stamps[first + k]), float(stamps[first + j])
        w = min(1.0, max(0.0, (t - begin) / (end - begin))) if j > k else 0.0
        for axis in range(3):
            moved[i, axis] = (1.0 - w) * change[k, axis] + w * change[j, axis]
    shift(course, moved, mul(start.T_odom_sole[:3, :3], sole[:3, :3].T))
    return _STEPS, course


@compiled
def _replanned(
    change: Array, past: Memory, feet: Array, at: tuple[int, int, float], com: Array, soles: Array, phase: Integers
) -> bool:
    """Fill in by how much (k, 3) [m] a plan moves the COM at k points of the memory; whether all else is as it was.

    Args:
        change: filled in, against the first of these points.
        past: the points.
        feet: (n, 2, 4, 4) poses of the soles there.
        at: the first of these points; stamp [ns] and spacing [s] of the plan.
        com, soles, phase: of `PlannedSteps`.
    """
    (first, stamp, dt), last = at, com.shape[0] - 1
    others, moved, begin = 0, np.empty(9), np.empty(9)
    for k in range(change.shape[0]):
        q = first + k
        place = min(max((past.stamp[q] - stamp) / (1e9 * dt) - 1.0, 0.0), float(last))
        i, near = min(int(place), max(last - 1, 0)), int(np.rint(place))
        w, j = place - i, min(i + 1, last)
        others += phase[near] != (3 if past.double[q] else past.foot[q])
        for foot in range(2):
            if not _as_before(soles[near, 7 * foot : 7 * foot + 7], feet[q, foot]):
                return False
            for axis in range(3):
                a = 7 * foot + axis
                moved[3 + 3 * foot + axis] = (1.0 - w) * soles[i, a] + w * soles[j, a] - feet[q, foot, axis, 3]
        for axis in range(3):
            moved[axis] = (1.0 - w) * com[i, axis] + w * com[j, axis] - past.plan[q, axis]
        if k == 0:
            begin[:] = moved
        for axis in range(9):
            if not abs(moved[axis] - begin[axis]) < _CHANGED:
                return False
        for axis in range(3):
            change[k, axis] = moved[axis] - begin[axis]
    return others <= _OTHER


@compiled
def _as_before(sole: Array, T: Array) -> bool:
    """Whether no element of the rotation of a sole (7,) differs by much from that of a pose (4, 4)."""
    now = np.empty((4, 4))
    _set_pose(now, sole)
    for i in range(3):
        for j in range(3):
            if not abs(now[i, j] - T[i, j]) < _TURNED:
                return False
    return True
