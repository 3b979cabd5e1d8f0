# SPDX-License-Identifier: BSD-3-Clause
"""Motor positions of the virtual robot from a live stream of COM references."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...core.base.types import Array, Phase, Reference
from ...sim.motion import LegKinematics, follow
from ...sim.upper_motion import RISE_S, UpperMotion
from .planned_lead import PlannedLead

SPACING_NS = 20_000_000  # inverse kinematics at 50 Hz; the cubic between leaves some 0.1 mrad
DELAY_NS = 90_000_000  # the robot lives so far in the past that the cubic's next two knots are there
_JUMP = 0.05  # [m] a plan that moves this far from one knot to the next begins again


def at_rest(reference: Reference) -> bool:
    """Whether a plan stands still on both feet: only there can a robot be put without falling."""
    still = np.abs(reference.com_vel).max() < 1e-3 and np.abs(reference.com_acc).max() < 2e-2
    return bool(reference.phase == Phase.DOUBLE and still)


class _Knot(NamedTuple):
    stamp_ns: int
    t: float  # [s] since the start of the motion
    links: Array  # (nj,) [rad]
    motors: Array  # (nj,) [rad] by the robot's own lead


class StreamMotion:
    """Cubics through the postures of every fourth or so reference; still before the first and after the last.

    Attributes:
        last: the newest reference taken in; its predecessor is the last knot.
        start: where the robot stands (sim.motion.Posture, n = 1).
    """

    def __init__(
        self,
        legs: LegKinematics,
        first: Reference,
        start_ns: int,
        upper: UpperMotion | None = None,
        stride_s: float = 1.0,
        sag: float = 0.8,
        planned: PlannedLead | None = None,
    ) -> None:
        """Stands still at first.

        Args:
            legs: the robot.
            first: where it stands.
            start_ns: stamp of t = 0 [ns].
            upper: how the upper body moves while it walks, if the robot has one.
            stride_s: time of two steps [s].
            sag: as in sim.motion.
            planned: the lead by com/planned_deflection, where that is known; default: none is used.

        Raises:
            ConfigError: the legs cannot reach that posture.
        """
        self._legs = legs
        self._start_ns = start_ns
        self._upper, self._stride_s, self._swing = upper or UpperMotion(), stride_s, 0.0
        self._began_ns = first.stamp_ns  # the swing
        self.last = first
        self._sag, self._planned = sag, planned
        theta, self.start = follow(legs, [first], sag, self._arms([first]))
        self._recent = deque([first], maxlen=2)
        self._knots: deque[tuple[float, Array]] = deque([(-1e-9 * SPACING_NS, theta)], maxlen=512)
        self._ahead: deque[_Knot] = deque(maxlen=512)
        if planned is not None:
            planned.restart()

    @property
    def known_ns(self) -> int:
        """Until which stamp the motion is what it will stay [ns]: later references change the last cubic."""
        last = self._ahead[-1].t if self._ahead else self._knots[-1][0]
        return self._start_ns + round(1e9 * last) - SPACING_NS

    def jumps(self, reference: Reference) -> bool:
        """Whether a reference does not continue those before it: the robot has to be put there."""
        moved = max(
            float(np.abs(a[:3, 3] - b[:3, 3]).max())
            for a, b in (
                (reference.T_odom_left, self.last.T_odom_left),
                (reference.T_odom_right, self.last.T_odom_right),
            )
        )
        return moved > _JUMP or float(np.abs(reference.com - self.last.com).max()) > _JUMP

    def add(self, reference: Reference) -> None:
        """Take a reference in, if it is time for the next knot.

        Raises:
            ConfigError: the legs cannot reach it; the motors stay where they are.
        """
        if reference.stamp_ns < self.last.stamp_ns + SPACING_NS - 1000:
            return
        before, middle = self._recent[0], self.last
        self._swing_on(middle, reference)
        self._recent.append(reference)
        self.last = reference
        t = (middle.stamp_ns - self._start_ns) * 1e-9
        if t <= (self._ahead[-1].t if self._ahead else self._knots[-1][0]):
            return
        # The torques of the moving legs need their accelerations, which only evenly spaced references give.
        even = abs(reference.stamp_ns + before.stamp_ns - 2 * middle.stamp_ns) < SPACING_NS // 10
        points = [before, middle, reference] if even else [middle]
        theta, links = follow(self._legs, points, self._sag, self._arms(points))
        self._ahead.append(_Knot(middle.stamp_ns, t, links.q[0], theta))

    def _fix(self, until: float) -> None:
        """Have the two knots after a time [s] that its cubic needs; no more: a planned lead may come until then."""
        while self._ahead and (len(self._knots) < 2 or self._knots[-2][0] <= until):
            knot = self._ahead.popleft()
            theta = knot.motors
            if self._planned is not None:
                theta = self._planned.motors(knot.stamp_ns, knot.t - self._knots[-1][0], knot.links, theta)
            self._knots.append((knot.t, theta))

    def _swing_on(self, last: Reference, reference: Reference) -> None:
        """The swing of the arms rises while the robot walks, and falls when it stands."""
        seconds = 1e-9 * (reference.stamp_ns - last.stamp_ns)
        if self._swing == 0.0:
            self._began_ns = reference.stamp_ns
        change = -seconds if at_rest(reference) else seconds
        self._swing = float(np.clip(self._swing + change / RISE_S, 0.0, 1.0))

    def _arms(self, references: Sequence[Reference]) -> Array:
        """Joints of the upper body at references (n, nu) [rad]."""
        t = np.array([1e-9 * (reference.stamp_ns - self._began_ns) for reference in references])
        share = np.full(len(t), self._swing)
        return self._upper.at(self._legs.table, 2.0 * np.pi * t / self._stride_s, share)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        """Motor positions [rad] and velocities [rad/s], each (n, nj), at times (n,) [s] that never go back."""
        self._fix(times[-1])
        knots = self._knots
        while len(knots) > 3 and knots[2][0] <= times[0]:
            knots.popleft()
        t = np.array([knot[0] for knot in knots])
        theta = np.array([knot[1] for knot in knots])
        if len(t) == 1:
            return np.repeat(theta, len(times), axis=0), np.zeros((len(times), theta.shape[1]))
        slope = np.gradient(theta, t, axis=0)
        slope[-1] = 0.0
        i = np.clip(t.searchsorted(times, side="right") - 1, 0, len(t) - 2)
        h = (t[i + 1] - t[i])[:, None]
        s = np.clip((times - t[i])[:, None] / h, 0.0, 1.0)
        a, b, va, vb = theta[i], theta[i + 1], slope[i] * h, slope[i + 1] * h
        c2, c3 = 3.0 * (b - a) - 2.0 * va - vb, 2.0 * (a - b) + va + vb
        inside = ((times >= t[0]) & (times <= t[-1]))[:, None]
        return a + s * (va + s * (c2 + s * c3)), inside * (va + s * (2.0 * c2 + 3.0 * s * c3)) / h
