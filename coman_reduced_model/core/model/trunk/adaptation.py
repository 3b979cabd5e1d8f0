# SPDX-License-Identifier: BSD-3-Clause
"""Slow adaptation (`prediction.adapt`): joint stiffness, zeros of encoders and the trunk's COM, learnt in walking.

While a leg carries the robot alone, its joints bear what weight and motion ask for, however stiff they are. So the
mean deflection d that a single support shows, against the mean deflection u of the nominal spring under the free run's
load, is

    d = r (u + c s) + b

with r the nominal stiffness over the real one, b the zeros of link and motor encoder, s (2,) the shift of the trunk's
COM along x, y of `robot.base_frame` and c how far its moment, of the trunk's weight, turns the joint. Within a step, d
and u differ by dynamics too, so that a single support counts as one observation, a longer one as one a second. All are
found by least squares over the last steps with nominal variability as prior: r and b are of one joint, s of the robot.
What the model leaves out is the same in each step, so that more steps do not make it less: the error of one observation
is taken as large, older ones are forgotten, and nothing gets farther than three standard deviations from nominal.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, sqrt
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from ...base.types import Array, Foot, Phase, Sample, SupportState
from ...effects.base import Effect

if TYPE_CHECKING:
    from ...base.nominal import Nominal
    from ...effects.hooks import LegSprings, Now, Push
    from ...robot.robot import Robot

SETTLED, SHORTEST, LONGEST = 0.1, 0.2, 1.0  # [s] of single support: left out; that counts; of one observation
ERROR = 2e-3  # [rad] of the mean deflection over LONGEST, by what the model leaves out
MEMORY = 10.0  # [s] of single support
MOST = 3.0  # standard deviations from nominal, at most
_FAR = 0.05  # [rad] off, a free run says nothing of springs
_NOMINAL = np.array([1.0, 0.0])


class Adapted(NamedTuple):
    """What was learnt of a joint."""

    stiffness: float  # over that of the configuration [1]
    zero: float  # deflection that the encoders read without load [rad]


@dataclass
class _Leg:
    """What is known of a leg's n joints."""

    values: Array  # (n, 2) r and b
    information: Array  # (n, 4, 4) of the observations on r, b and s, fading
    pull: Array  # (n, 4) that times what they say
    sums: Array  # (n, 4) over this single support: free run's error and deflection [rad s], c [rad s/m]
    seconds: float = 0.0


class Adaptation(Effect):
    """Springs and the trunk's COM as the robot shows them; comes after all effects, whose corrections it sees.

    Attributes:
        learning: whether it goes on; else what it knows stays as it is.
        shift: (2,) [m] of the trunk's COM along x, y of `robot.base_frame`.
    """

    name: ClassVar[str] = "adaptation"

    def __init__(self, robot: Robot, nominal: Nominal, gravity: float) -> None:
        """Nothing is known yet: springs are nominal; gravity in m/s^2."""
        super().__init__("", {})
        self.bind(robot)
        w = nominal.widths
        ratio = hypot(w["joint_stiffness.scale.spread"], w["joint_stiffness.together.spread"])
        width = np.array([ratio, sqrt(2.0) * w["encoder_bias.bias.spread"]])  # zeros of two encoders
        self._low, self._high = _NOMINAL - MOST * width, _NOMINAL + MOST * width
        self._prior = np.diag(width**-2)
        self._most = MOST * w["com.spread"]
        self._prior_of_shift = np.eye(2) / w["com.spread"] ** 2
        self.shift = np.zeros(2)
        # Moment (3, 2) [N] on the trunk a metre of shift, in the axes of robot.base_frame, the trunk upright.
        weight = robot.model.inertias[robot.model.frames[robot.base_id].parentJoint].mass * gravity
        self._per_metre = weight * np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
        self._in_sole = {foot: np.zeros((3, 2)) for foot in robot.legs}  # the same, in the axes of each sole
        self.learning = True
        self._robot = robot
        self._legs = {foot: _nominal_leg(len(joints)) for foot, joints in robot.legs.items()}
        self.reset()

    def reset(self) -> None:
        """Forget the past, but not what was learnt: the robot is the same."""
        self._before: Sample | None = None
        self._sample: Sample | None = None
        self._support: SupportState | None = None
        self._learns, self._is_now = Foot.NONE, False
        for leg in self._legs.values():
            leg.seconds = 0.0
            leg.sums[:] = 0.0

    def correct(self, sample: Sample) -> None:
        self._before, self._sample = self._sample, sample

    def begin(self, stamp_ns: int, support: SupportState) -> None:
        """Decide whether the last sample, at which the free run is, shows the springs of a leg."""
        last, self._support = self._support, support
        self._learns, self._is_now = Foot.NONE, True
        if (
            not self.learning
            or last is None
            or last.phase == Phase.DOUBLE
            or last.phase != support.phase
            or last.phase_time < SETTLED
        ):
            return
        if self._before is not None and self._before.motor_q is not None:
            self._learns = last.support_foot

    def springs(self, leg: LegSprings) -> None:
        known = self._legs[leg.foot]
        if leg.foot == self._learns and self._is_now:
            self._observe(known, leg)
        if known.seconds >= LONGEST or (leg.foot != self._learns and known.seconds > 0.0):
            if known.seconds >= SHORTEST:
                self._learn(known)
            known.seconds = 0.0
            known.sums[:] = 0.0
        leg.K_q /= known.values[:, :1]
        leg.torque -= leg.K_q @ known.values[:, 1]

    def push(self, push: Push, now: Now) -> None:
        moment = push.posture.orientation(self._robot.base_id) @ self._per_metre
        if self._is_now:
            for foot in self._in_sole:
                self._in_sole[foot] = push.posture.R[foot].T @ moment
            self._is_now = False  # springs and posture of the free run come first, then planned ones
        push.trunk[3:] += moment @ self.shift

    def known(self) -> dict[str, Adapted]:
        """By name of a leg joint."""
        return {
            self._robot.joint_names[joint]: Adapted(1.0 / float(r), float(b))
            for foot, leg in self._legs.items()
            for joint, (r, b) in zip(self._robot.legs[foot], leg.values, strict=True)
        }

    def _observe(self, known: _Leg, leg: LegSprings) -> None:
        """Take in a sample of single support; the deflections are of the free run at the last sample."""
        before, sample, joints = self._before, self._sample, self._robot.legs[leg.foot]
        assert before is not None and before.motor_q is not None
        assert sample is not None and sample.motor_q is not None
        link = leg.deflection + sample.motor_q[joints]
        error = before.q[joints] - link
        if not np.abs(error).max() < _FAR:
            return
        dt = (sample.stamp_ns - before.stamp_ns) * 1e-9
        known.sums[:, 0] += dt * error
        known.sums[:, 1] += dt * (link - before.motor_q[joints])
        known.sums[:, 2:] += dt * leg.J[3:].T @ self._in_sole[leg.foot] / np.diag(leg.K_q)[:, None]
        known.seconds += dt

    def _learn(self, known: _Leg) -> None:
        """From the mean over a single support."""
        means = known.sums / known.seconds
        error, deflection, turned = means[:, 0], means[:, 1], means[:, 2:]
        H = np.ones((len(error), 4))
        H[:, 0] = (deflection - known.values[:, 1]) / known.values[:, 0] - turned @ self.shift
        H[:, 2:] = turned * known.values[:, :1]
        weight = known.seconds / LONGEST / ERROR**2
        fade = exp(-known.seconds / MEMORY)
        known.information *= fade
        known.information += weight * H[:, :, None] * H[:, None, :]
        known.pull *= fade
        known.pull += weight * H * (error + deflection)[:, None]
        self._solve()

    def _solve(self) -> None:
        """What all observations say: s first, r and b of each joint for that s."""
        left, pull, joints = self._prior_of_shift, np.zeros(2), []
        for leg in self._legs.values():
            both = leg.information[:, :2, :2] + self._prior
            by_shift = np.linalg.solve(both, leg.information[:, :2, 2:])  # (n, 2, 2)
            alone = np.linalg.solve(both, (leg.pull[:, :2] + self._prior @ _NOMINAL)[:, :, None])[:, :, 0]
            left = (
                left
                + leg.information[:, 2:, 2:].sum(axis=0)
                - np.einsum("nki,nkj->ij", leg.information[:, :2, 2:], by_shift)
            )
            pull = pull + leg.pull[:, 2:].sum(axis=0) - np.einsum("nki,nk->i", leg.information[:, :2, 2:], alone)
            joints.append((leg, alone, by_shift))
        self.shift = np.clip(np.linalg.solve(left, pull), -self._most, self._most)
        for leg, alone, by_shift in joints:
            leg.values[:] = np.clip(alone - by_shift @ self.shift, self._low, self._high)


def _nominal_leg(n: int) -> _Leg:
    return _Leg(np.tile(_NOMINAL, (n, 1)), np.zeros((n, 4, 4)), np.zeros((n, 4)), np.zeros((n, 4)))
