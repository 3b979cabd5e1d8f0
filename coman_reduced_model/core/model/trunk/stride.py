# SPDX-License-Identifier: BSD-3-Clause
"""What the motors will do: what they did one stride ago, as long as the robot repeats itself.

A prediction ahead needs the future course of the motors, of the phases and of the posture. No message holds them, but
a walking robot repeats itself every two steps. The stride before is remembered sample by sample, as the motors and the
equations of motion that `TrunkModel` assembled there; the state is not: it starts from the measurement and goes its own
way through those equations. Where the robot does not repeat itself (it sets off, stops, or changes its gait) there is
no course, and `Stride.ahead` says so.
"""

from __future__ import annotations

from math import ceil

import numpy as np

from ...base.compiled import Held, all_finite, compiled, hold
from ...base.types import Array, Phase, Reference
from ...effects.hooks import Now
from .contact import ROWS, State
from .course import EVERY, Start, along, shift, simulate
from .kinematics import Assembled
from .memory import SEARCH, STEP, WINDOW, Memory, empty_memory, find_lag, keep, mismatch, nearest

_SPACING = 0.0095  # [s] between remembered samples at least
_CAPACITY, _KEPT = 768, 512  # remembered samples at most, and how many are kept when there are more: 4.8 s and more
_ALIKE = 0.03  # the motors differ by less than this part of their largest range in the stride: it is repeated
_NO_PLAN = np.full(3, np.nan), np.full((3, 3), np.nan)
_NO_PREVIEW = np.zeros(3), np.zeros((0, 3)), 0.0, np.eye(3)
Preview = tuple[Array, Array, float, Array]  # of a plan, see `follow`
_PLAN = 0.02  # [m] by which the plan may differ from that of the stride before


class Stride:
    """Remembers samples, finds the stride before, and simulates the model through it."""

    def __init__(self, friction: float, soles: Array) -> None:
        """`friction` between soles and ground; edges (2, 4) of the left and the right sole [m]."""
        self._friction, self._soles = friction, soles
        self._memory: Memory | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._n = self._last_ns = 0  # remembered samples; stamp of the last one
        self._lag_ns = 0  # to the stride before; 0: no stride known
        self.repeated_ns = 0  # the same of the last stride that was repeated
        self._phase = Phase.FLIGHT
        self._began: dict[tuple[Phase, Phase], int] = {}  # stamp of the last change from one phase to another
        self._course_ns = 0
        # From _course_ns on, every STEP: COM and its deflection in odom, and those of the joints, left leg first.
        self._course: Array | None = None  # (k, 6 + m) [m], [rad]

    def add(self, now: Now, terms: Assembled, reference: Array) -> None:
        """Remember a sample, with the COM (3,) by its motors [m]; at a change of phase, find how long the stride is."""
        stamp, plan = now.sample.stamp_ns, now.sample.reference
        if not all_finite(terms.terms.linear.f):  # of a free run that has diverged
            return
        if self._n == 0 or stamp - self._last_ns >= _SPACING * 1e9:
            planned, sole = _NO_PLAN if plan is None else (plan.com, _axes(plan, now.foot))
            foot, double = int(terms.foot), terms.double
            self._room(terms)
            keep(self._held, self._n, stamp, terms.block, foot, double, now.T_odom_sole, planned, sole, reference)
            self._n, self._last_ns = self._n + 1, stamp
        if (phase := now.support.phase) != self._phase:
            change, self._phase = (self._phase, phase), phase
            before, self._began[change] = self._began.get(change), now.began_ns
            # A foot that only brushes the ground changes the phase as well: the lag of the last stride may still hold.
            lags = (self.repeated_ns, 0 if before is None else now.began_ns - before)
            least = round((WINDOW + SEARCH[-1]) * 1e9)  # a stride is longer than what it is found by
            known = stamp - self._past.stamp[0] - least
            guesses = np.array([lag for lag in lags if least < lag < known], dtype=np.int64)
            self._lag_ns = find_lag(stamp, guesses, self._past, self._n) if len(guesses) else 0

    def ahead(self, now: Now, terms: Assembled, state: State, horizons: Array) -> Array | None:
        """What comes at horizons (k,) ascending [s]; None: the robot does not repeat itself.

        Args:
            now: this sample.
            terms: the equations of motion at it.
            state: the filtered measurement.
            horizons: (k,) ascending [s].

        Returns:
            (j, 6 + m): COM [m] in the support sole, its deflection in the axes of that sole, and the deflections of the
            joints [rad], the left leg's first; of the first j horizons, which are within a stride.
        """
        if self._memory is None:
            return None
        stamp = now.sample.stamp_ns
        horizons = horizons[horizons + EVERY <= (self._last_ns - stamp + self._lag_ns) * 1e-9]
        if not self._lag_ns or not len(horizons):
            return None
        since = (stamp - self._course_ns) * 1e-9
        if self._course is None or not 0.0 <= since < EVERY or since + horizons[-1] > (len(self._course) - 1) * STEP:
            self._course_ns, self._course = stamp, self._simulate(now, terms, state, float(horizons[-1]) + EVERY)
        if self._course is None:
            return None
        return along(self._course, (stamp - self._course_ns) * 1e-9, horizons, now.T_odom_sole)

    @property
    def _past(self) -> Memory:
        assert self._memory is not None
        return self._memory

    def _room(self, terms: Assembled) -> None:
        """Make room for a sample."""
        if self._memory is None:
            m, r = len(terms.terms.theta), 2 * ROWS
            self._memory = empty_memory(m, _CAPACITY)
            self._held = hold(self._memory)
            # Compiled or loaded now, not in the middle of a walk.
            find_lag(0, np.zeros(1, dtype=np.int64), self._memory, 0)
            zero = State(np.zeros(m + 6), np.zeros(m + 6), np.zeros(r))
            self._follow(0, 0, 1, terms, zero, np.eye(4), _NO_PREVIEW)
        if self._n == _CAPACITY:
            for column in self._memory:
                column[:_KEPT] = column[-_KEPT:]
            self._n = _KEPT

    def _simulate(self, now: Now, terms: Assembled, state: State, span: float) -> Array | None:
        past, n, stamp = self._past, self._n, now.sample.stamp_ns
        then = stamp - self._lag_ns
        if not self._lag_ns or then < past.stamp[0] or then + span * 1e9 > past.stamp[n - 1]:
            return None
        plan, preview = now.sample.reference, _NO_PREVIEW
        if plan is not None and plan.preview_dt > 0.0:
            preview = plan.com, plan.preview_com, plan.preview_dt, _axes(plan, now.foot)
        points = ceil(span / STEP) + 1
        course = self._follow(stamp, then, points, terms, state, now.T_odom_sole, preview)
        if not len(course):
            return None
        self.repeated_ns = self._lag_ns
        return course

    def _follow(
        self, stamp: int, then: int, points: int, terms: Assembled, state: State, T_odom_sole: Array, preview: Preview
    ) -> Array:
        start = Start(stamp, int(terms.foot), terms.block, state, T_odom_sole)
        return follow(start, then, points, preview, self._held, self._n, self._soles, self._friction)


def _axes(plan: Reference, foot: int) -> Array:
    """Orientation (3, 3) of the planned sole of a foot, laid out as what was compiled for it."""
    return np.ascontiguousarray(plan.sole_pose(foot)[:3, :3])


@compiled
def replanned(
    moved: Array, com: Array, preview: Array, dt: float, sole: Array, foot: int, then: int, past: Memory, n: int
) -> float:
    """What the plan has changed since the stride before, filled into `moved` (k, 3) [m], every `STEP`; the most of it.

    Each plan counts in the axes of its own sole: a robot that turns repeats itself in them.

    Args:
        com, preview, dt: planned COM (3,) now, and (p, 3) every dt [s] from then on, in the plan's odom.
        sole, foot: orientation (3, 3) of the planned support sole now, and whose it is.
        then: this point of the stride before [ns].
        past, n: the memory.

    Returns:
        The largest change of an axis [m]; infinite where the stride before had no plan, or another support foot.
    """
    largest, i = 0.0, nearest(then, past.stamp, n, n - 1)
    same = same_support(past, n, i, foot)
    if past.foot[same] != foot:
        return np.inf
    first, first_before, own, before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(moved.shape[0]):
        stamp = then + int(k * STEP * 1e9)
        i = nearest(stamp, past.stamp, n, i)
        j = i - 1 if (past.stamp[i] > stamp and i > 0) or i + 1 >= n else i
        past_share = min(1.0, max(0.0, (stamp - past.stamp[j]) / (past.stamp[j + 1] - past.stamp[j])))
        at = min(k * STEP / dt, float(preview.shape[0]))  # a plan that ends stands still
        ahead = min(int(at), preview.shape[0] - 1)
        for axis in range(3):
            begin = com[axis] if ahead == 0 else preview[ahead - 1, axis]
            own[axis] = begin + (at - ahead) * (preview[ahead, axis] - begin)
            before[axis] = past.plan[j, axis] + past_share * (past.plan[j + 1, axis] - past.plan[j, axis])
        if k == 0:
            first[:], first_before[:] = own, before
        for axis in range(3):
            moved[k, axis] = 0.0
            for row in range(3):
                moved[k, axis] += (own[row] - first[row]) * sole[row, axis]
                moved[k, axis] -= (before[row] - first_before[row]) * past.planned_sole[same, row, axis]
            if np.isnan(moved[k, axis]):  # the stride before had no plan
                return np.inf
            largest = max(largest, abs(moved[k, axis]))
    return largest


@compiled
def follow(
    start: Start, then: int, points: int, preview: Preview, memory: Held, n: int, soles: Array, friction: float
) -> Array:
    """The model from a measured state through the stride before, and what the plan has changed since.

    Args:
        start, points, n, soles, friction: as in `simulate`.
        then: the same point of the stride before [ns].
        preview: com, preview, dt and sole of `replanned`; no points where there is no plan.
        memory: `Memory`.

    Returns:
        (points, 6 + m) as in `Stride`; empty where the last stride was another one, or the plan was.
    """
    past = memory.value
    nothing, moved = np.empty((0, 6 + past.theta.shape[1])), np.zeros((points, 3))
    if n < 2:
        return nothing
    q = nearest(then, past.stamp, n, n - 1)
    if not repeats(start.stamp, then, past, n, q):
        return nothing
    same = same_support(past, n, q, start.foot)
    if past.foot[same] != start.foot:
        return nothing
    if preview[1].shape[0] and not replanned(moved, *preview, start.foot, then, past, n) < _PLAN:
        return nothing
    course = simulate(start, past.T_odom_sole[same], then, points, past, n, soles, friction, False)
    shift(course, moved, start.T_odom_sole)
    return course


@compiled
def repeats(stamp: int, then: int, past: Memory, n: int, q: int) -> bool:
    """Whether the motors do now what they did then, at sample q, within a share of their range since."""
    m, widest = past.theta.shape[1], 0.0
    low, high = past.theta[q].copy(), past.theta[q].copy()
    for i in range(q, n, 4):
        other = 0 if past.foot[i] == past.foot[q] else m // 2
        for j in range(m):
            there = past.theta[i, (j + other) % m]
            low[j], high[j] = min(low[j], there), max(high[j], there)
            widest = max(widest, high[j] - low[j])
    return mismatch(stamp, stamp - then, past, n)[0] < _ALIKE * widest


@compiled
def same_support(past: Memory, n: int, q: int, foot: int) -> int:
    """The sample near q at which `foot` was the support foot: it may have become it a little later or earlier."""
    for i in range(40):
        if q + i < n and past.foot[q + i] == foot:
            return q + i
        if q - i >= 0 and past.foot[q - i] == foot:
            return q - i
    return q
