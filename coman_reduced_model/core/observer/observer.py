# SPDX-License-Identifier: BSD-3-Clause
"""Estimate of the COM and of what pushes the robot, with covariances, from encoders and foot wrenches.

Beside the free run, which it does not touch. The filter is `kalman.py`; here is what its noise is:

- Steps of the encoders, found in their data, and the white noise of the measured COM, by its third differences.
- How far the apparent external force wanders, axis by axis, by its own corrections of the last seconds: soles that roll
  or slide, and forces that come and go, make the motion by the encoders another one than that by the forces.
- Nominal variability (config/nominal.yaml): masses of the links and where they are, zeros of encoders and wrenches,
  gains and delays of wrenches, slope of the ground. What is constant cannot be seen in innovations, so it enters the
  published covariances beside those of the filter (as a Schmidt-Kalman filter considers it), not the filter.
"""

from __future__ import annotations

from math import exp
from typing import TYPE_CHECKING

import numpy as np

from ..base.types import Array, Estimate, Flags, Foot, Sample
from .kalman import SIZE, C, F, N, V, advance, com_covariance, correct, net_force, turned
from .masses import masses_covariance

if TYPE_CHECKING:
    from ..base.nominal import Nominal
    from ..robot.robot import Posture, Robot

GAP = 0.1  # [s] without a sample or a wrench after which it begins again
LASTS = 0.1  # [s] for which an error by a step of an encoder lasts
WALK = 0.1  # of the weight: how far an external force wanders in the root of a second, before it is known
WALKS = (0.01, 0.3)  # the same, least and most
WANDERED, LEARNT = 0.05, 1.5  # [s] over which corrections of the force add up, and memory of what they add up to
FORCE = 0.001  # of the weight times the root of a second: force that neither sensors nor gains explain
FASTEST = 2.0  # [s] memory of the white noise
LEAST = 1e-5  # [m] of white noise at least
JUDGED = 2.0  # [s] memory of the NIS
LOST = 4.0  # times what it should be: consistency is lost
FOUND = 2.0  # times: it is found again
EVERY_NS = 20_000_000  # between new covariances of the measured COM


class Observer:
    """The filter of one robot, sample by sample.

    Attributes:
        flags: INCONSISTENT where innovations are far larger than they should be.
        nis: mean of the last seconds [1]; 3 is expected.
    """

    def __init__(self, robot: Robot, gravity: float, nominal: Nominal) -> None:
        """Build the filter.

        Args:
            robot: its mass and columns.
            gravity: [m/s^2].
            nominal: how nominal robots differ.
        """
        widths = nominal.widths
        self._robot, self._mass, self._gravity = robot, robot.mass, gravity
        weight = robot.mass * gravity
        self._weight, self._nominal = weight, nominal
        self._force = (FORCE * weight) ** 2
        self._gain, self._delay = widths["wrench_scale.scale.spread"], widths["wrench_delay.delay.spread"]
        self._zero_variance = np.zeros(robot.model.nv)
        self._zero_variance[robot.idx_v] = widths["encoder_bias.bias.spread"] ** 2
        slope, mass = weight * widths["ground_slope.spread"], weight * widths["mass.spread"] / 3.0
        zeros = [2.0 * widths[f"zero_f{axis}.spread"] ** 2 for axis in "xyz"]  # of two feet
        gain = (weight * widths["wrench_scale.together.spread"]) ** 2
        self._constant = np.diag([zeros[0] + slope**2, zeros[1] + slope**2, zeros[2] + mass**2 + gain])
        self._last_q: Array | None = None
        self._masses: Array | None = None  # (3, 3) [m^2] of the COM by those of the masses, base frame
        self._step = np.full(len(robot.joint_names), np.inf)  # [rad] smallest that each encoder has shown
        self.reset()

    def reset(self) -> None:
        """Forget the past, but not the steps of the encoders."""
        self._x, self._P = np.zeros(SIZE), np.zeros((SIZE, SIZE))
        self._nis = float("nan")  # of the last sample
        self._foot = Foot.NONE
        self._stamp_ns = self._looked_ns = 0
        self._last_force: Array | None = None
        self._past = np.full((4, 3), np.nan)  # [m] measured COM, newest last
        self._white, self._seen = np.zeros(3), 0.0  # [m^2] variances, and the share of the memory that is known
        self._walks = np.full(3, (WALK * self._weight) ** 2)  # [N^2 / s]
        self._wandered = np.zeros(3)  # [N] sum of the corrections of the external force, fading
        self._slow = self._constants = np.zeros((3, 3))
        self.nis, self.flags = 3.0, Flags.OK

    def update(self, sample: Sample, link: Posture, foot: Foot, com: Array, com_vel: Array) -> Estimate:
        """Take one sample.

        Args:
            sample: its wrenches and joints.
            link: the posture by its link side.
            foot: the support foot, LEFT or RIGHT.
            com, com_vel: measured (3,) in its sole frame [m], [m/s].
        """
        dt = (sample.stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = sample.stamp_ns
        self._learn_steps(sample.q)
        if sample.left_wrench is None or sample.right_wrench is None or not np.isfinite(com).all():
            self._foot = Foot.NONE  # it begins again
            return Estimate()
        own, other = sample.left_wrench, sample.right_wrench
        if foot == Foot.RIGHT:
            own, other = other, own
        force = net_force(link.R[foot], link.R[foot.other], own, other)
        if sample.stamp_ns - self._looked_ns >= EVERY_NS or foot != self._foot:
            self._look(link, foot)
            self._looked_ns = sample.stamp_ns
        if self._foot == Foot.NONE or not 0.0 < dt <= GAP or self._last_force is None:
            self._begin(com, com_vel)
        else:
            if foot != self._foot:
                self._switch(link, foot, com)
            self._advance(force, dt)
            self._add_white(com, dt)
            before = self._x[F:N].copy()
            self._judge(correct(self._x, self._P, com, np.diag(self._white / max(self._seen, 1e-9) + LEAST**2)), dt)
            self._learn_walk(self._x[F:N] - before, dt)
        self._foot, self._last_force = foot, force
        return self._estimate()

    def _learn_steps(self, q: Array) -> None:
        """The smallest change of each encoder is its resolution."""
        if self._last_q is not None:
            step = np.abs(q - self._last_q)
            step[step < 1e-9] = np.inf
            np.minimum(self._step, step, out=self._step)
        self._last_q = q.copy()

    def _look(self, link: Posture, foot: Foot) -> None:
        robot = self._robot
        steps = np.zeros(robot.model.nv)
        steps[robot.idx_v] = np.where(np.isfinite(self._step), self._step, 0.0) ** 2 / 12.0
        geometry = link.com, link.J_com, link.J, robot.sole_columns[foot], link.R[foot]
        self._slow = com_covariance(*geometry, steps) + LEAST**2 * np.eye(3)
        if self._masses is None:
            self._masses = masses_covariance(link, self._nominal)
        axes = link.R[foot]
        self._constants = com_covariance(*geometry, self._zero_variance) + axes.T @ self._masses @ axes

    def _begin(self, com: Array, com_vel: Array) -> None:
        self._x[:] = 0.0
        self._x[C:V], self._x[V:F] = com, com_vel
        self._P[:] = 0.0
        self._P[C:V, C:V] = self._slow
        self._P[N:, N:] = self._slow
        self._P[V:F, V:F] = 0.05**2 * np.eye(3)
        self._P[F:N, F:N] = self._constant
        self._past[:] = np.nan

    def _switch(self, link: Posture, foot: Foot, com: Array) -> None:
        """The other sole is the support: what the encoders were believed to be off by stays as sure as it was."""
        R = np.ascontiguousarray(link.R[foot].T @ link.R[self._foot])
        off = self._x[C:V] - self._past[3]
        self._x, self._P = turned(self._x, self._P, R)
        if np.isfinite(off).all():
            self._x[C:V] = com + R @ off
        self._x[N:] = 0.0
        self._P[N:, :] = self._P[:, N:] = 0.0
        self._P[N:, N:] = self._slow
        self._P[C:V, C:V] += self._slow
        self._past[:] = np.nan

    def _advance(self, force: Array, dt: float) -> None:
        last = self._last_force
        assert last is not None
        moved = (force - last) / dt
        swing = force.copy()
        swing[2] -= self._mass * self._gravity
        errors = (self._gain * swing) ** 2 + (self._delay * moved) ** 2
        noise = np.array([self._force + errors * LASTS, self._walks])
        advance(
            self._x, self._P, 0.5 * (force + last), dt, self._mass, self._gravity, noise, self._slow, LASTS
        )  # fmt: skip

    def _add_white(self, com: Array, dt: float) -> None:
        past = self._past
        past[:3] = past[1:]
        past[3] = com
        third = past[3] - 3.0 * past[2] + 3.0 * past[1] - past[0]
        if np.isfinite(third).all():
            share = 1.0 - exp(-dt / FASTEST)
            self._white += share * (third * third / 20.0 - self._white)
            self._seen += share * (1.0 - self._seen)

    def _learn_walk(self, correction: Array, dt: float) -> None:
        """How far the force wanders, by corrections (3,) [N]: where it is as assumed, their sum has its variance."""
        self._wandered = self._wandered * exp(-dt / WANDERED) + correction
        share = 1.0 - exp(-dt / LEARNT)
        self._walks += share * (2.0 / WANDERED * self._wandered**2 - self._walks)
        low, high = ((each * self._weight) ** 2 for each in WALKS)
        np.clip(self._walks, low, high, out=self._walks)

    def _judge(self, nis: float, dt: float) -> None:
        self._nis = nis
        share = 1.0 - exp(-dt / JUDGED)
        self.nis += share * (nis - self.nis)
        if not np.isfinite(self.nis):
            self._foot, self.nis = Foot.NONE, 3.0
        most = 3.0 * (FOUND if self.flags else LOST)
        self.flags = Flags.OK if self.nis < most else Flags.INCONSISTENT

    def _estimate(self) -> Estimate:
        x, covariance = self._x, self._P[:F, :F].copy()
        covariance[:3, :3] += self._constants
        white = np.diag(self._white / max(self._seen, 1e-9)) + self._constants
        return Estimate(
            x[C:V].copy(), x[V:F].copy(), covariance, self._slow + white, x[F:N].copy(),
            self._P[F:N, F:N] + self._constant, self._nis,
        )  # fmt: skip
