# SPDX-License-Identifier: BSD-3-Clause
"""What the foot sensors read without load, where that is so much that the total force contradicts the weight.

The zeros of both sensors, (12,) in the axes of their soles, are the state of a Kalman filter, and two things measure
them: a foot that is in the air by the joints reads its zero; and forces and moments about the COM that the weight does
not balance are zeros, as far as the robot is not accelerated. So a foot that never leaves the ground gets its zero from
the balance. Both hold on level ground.

As long as the total vertical force is near the weight, or both feet bear nothing, nothing is learnt and nothing is
changed: a good sensor is left alone. Zeros of both feet may cancel in the total: then a foot in the air shows them, if
it reads what no ground can give, a pull or more force sideways than down. Where feet in the air read nothing, a total
that is off is no zero: nothing is learnt of it. Only the past is used, and what was learnt lasts, unless the total
force is twice as far from the weight with it as without: it is off for another reason then, as where a robot is lighter
than its URDF, and nothing is taken off any more.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from ..base.compiled import all_finite
from ..base.input_warning import InputWarning, WarningKind
from ..base.stream_names import WRENCHES
from ..base.types import Array, Foot, Sample

if TYPE_CHECKING:
    from ..robot.robot import Posture

FEET = (Foot.LEFT, Foot.RIGHT)
CLEARANCE = 0.01  # [m] a foot this much higher is in the air; less may be compliance or a soft floor
OFF = 0.1  # share of the weight by which the total vertical force is off where zeros are learnt
SAID = 0.04  # share of the weight from which a zero is reported
REVERSED = (-1.2, -0.8)  # shares of the weight: rather the wrong sign than zeros
KILOGRAMS = (0.09, 0.115)  # the same, of a weight in kgf: about 1 / 9.81
MOST_KILOGRAMS = 0.25  # share of the weight, by magnitude, that no foot reads in kgf but at a landing
WORSE = 2.0  # times as far from the weight, from which zeros do not explain the total force; they may be changing
SHARE = 0.5  # of what the total force is off by: where feet in the air read less, no zeros are learnt
BEARS = 0.1  # share of the weight: where both feet read less, the robot jumps or hangs
FIRST_S, MEMORY_S, GAP_S = 0.5, 1.0, 0.05  # [s] of total force that are needed, and that count; of one sample at most
EVERY_NS = 20_000_000  # between measurements
# Standard deviations, of forces in weights and of moments in weights times a metre.
PRIOR = (1.0, 0.01)
WANDERS = (0.002, 0.00002)  # of a zero, in a second
IN_THE_AIR = (0.03, 0.0015)  # by the inertia of a foot that swings
OFF_BALANCE = (0.4, 0.04)  # by accelerations, and masses that are not those of the URDF


class SensorZeros:
    """The zeros of both foot sensors, where they matter.

    Args:
        weight: of the robot [N].

    Attributes:
        weight: as given; may be exchanged at any time.
        active: whether zeros are learnt and taken off.
    """

    def __init__(self, weight: float) -> None:
        self.weight = weight
        self.active, self._refuted = False, 0.0  # the weight [N] by which zeros explain nothing; 0: none
        self.restart()
        self._seen, self._alive = np.zeros(2, dtype=bool), False
        self._in_air, self._air_s = np.zeros((2, 3)), np.zeros(2)  # mean force [N], and time [s], of feet in the air
        self._x = np.zeros(12)
        self._P = np.diag(self._variance(PRIOR, 2))

    @property
    def settled(self) -> bool:
        """Whether zeros are taken off, none explain the total force, or both feet were in the air for long enough."""
        return self.active or self._refuted == self.weight or bool((self._air_s >= FIRST_S).all())

    @property
    def both(self) -> Array:
        """Zeros (12,) of both sensors, the left one first."""
        return self._x.copy() if self.active else np.zeros(12)

    def of(self, foot: Foot) -> Array:
        """Zero (6,) of a foot's sensor: force [N] and moment [Nm] at the sole, in its axes."""
        k = 6 * FEET.index(foot)
        return self._x[k : k + 6]

    def restart(self) -> None:
        """The next sample may have any stamp; what was learnt is kept."""
        self._mean, self._more, self._seconds, self._last_ns, self._next_ns = 0.0, 0.0, 0.0, 0, 0
        self._left, self._taken_s = 1.0, 0.0  # mean total force without the zeros, in weights, and how long [s]

    def corrected(self, sample: Sample, link: Posture) -> Sample:
        """A sample, whose joints `link` has, with the zeros taken off its wrenches: itself where there are none."""
        left, right = sample.left_wrench, sample.right_wrench
        if left is None or right is None or not (all_finite(left) and all_finite(right)):
            return sample
        dt, self._last_ns = min(max((sample.stamp_ns - self._last_ns) * 1e-9, 0.0), GAP_S), sample.stamp_ns
        if self._refuted == self.weight:
            return sample
        if not self.active:
            if not self._alive:  # a sensor that gives nothing but zeros is none
                self._seen |= np.array([left.any(), right.any()])
                self._alive = bool(self._seen.all())
            if self._alive:
                self._watch(float(left[2]) / self.weight, float(right[2]) / self.weight, dt)
                if not self.active and sample.stamp_ns >= self._next_ns:
                    self._next_ns = sample.stamp_ns + EVERY_NS
                    self._watch_air((left, right), link)
            if not self.active:
                return sample
        bears = max(abs(left[2] - self._x[2]), abs(right[2] - self._x[8])) > BEARS * self.weight
        if sample.stamp_ns >= self._next_ns and bears:
            self._P += np.diag(self._variance(WANDERS, 2)) * EVERY_NS * 1e-9
            self._measure(np.concatenate([left, right]), link)
            self._next_ns = sample.stamp_ns + EVERY_NS
        left, right = left - self._x[:6], right - self._x[6:]
        if max(left[2], right[2]) > BEARS * self.weight:
            self._check(float(left[2] + right[2]) / self.weight, dt)
        return replace(sample, left_wrench=left, right_wrench=right)

    def warnings(self) -> list[InputWarning]:
        """What is taken off, of each foot where it matters; or that nothing is, as it explains nothing."""
        found = []
        if self._refuted == self.weight:
            text = (
                f"wrenches: the mean vertical force of both feet was {self._mean:.0%} of the weight, and no zeros of "
                "the sensors explain it: nothing is taken off; does the robot weigh what its URDF says?"
            )
            found.append(InputWarning(WarningKind.ZERO, "", text))
        for foot, stream in WRENCHES.items() if self.active else ():
            zero = self.of(foot)
            if np.abs(zero[:3]).max() > SAID * self.weight:
                forces = ", ".join(f"{value:.0f}" for value in zero[:3])
                text = (
                    f"{stream}: reads about ({forces}) N without load, by the foot in the air and the balance of "
                    "weight: taken off; better set the sensor's zero"
                )
                found.append(InputWarning(WarningKind.ZERO, stream, text))
        return found

    def _watch(self, left: float, right: float, dt: float) -> None:
        """Whether the total of both vertical forces, in weights, is off for longer than a robot accelerates."""
        more = max(abs(left), abs(right))
        if more < BEARS:
            return
        self._seconds = min(self._seconds + dt, MEMORY_S)
        fresh = min(1.0, dt / max(self._seconds, 1e-9))
        self._mean += (left + right - self._mean) * fresh
        self._more += (more - self._more) * fresh
        another = REVERSED[0] < self._mean < REVERSED[1] or in_kilograms(self._mean, self._more > MOST_KILOGRAMS)
        if (self._air_s >= FIRST_S).all():
            zeros = float(self._in_air[:, 2].sum()) / self.weight
            another |= abs(self._mean - 1.0 - zeros) > (1.0 - SHARE) * abs(self._mean - 1.0)
        self.active = self._seconds >= FIRST_S and abs(self._mean - 1.0) > OFF and not another

    def _check(self, both: float, dt: float) -> None:
        """Take nothing off any more where the total of both vertical forces, in weights, is further from 1 with it.

        Args:
            both: what is left of it.
            dt: since the last sample, GAP_S at most [s].
        """
        fresh, self._taken_s = dt / MEMORY_S, self._taken_s + dt
        self._left += (both - self._left) * fresh
        self._mean += (both + (self._x[2] + self._x[8]) / self.weight - self._mean) * fresh
        if self._taken_s > 2.0 * MEMORY_S and abs(self._left - 1.0) > WORSE * max(abs(self._mean - 1.0), OFF):
            self.active, self._refuted = False, self.weight
            self._x[:], self._P = 0.0, np.diag(self._variance(PRIOR, 2))

    def _watch_air(self, wrenches: tuple[Array, Array], link: Posture) -> None:
        """Whether a foot in the air reads what no ground can give, in the mean over some of its steps."""
        foot = _in_the_air(link)
        if foot == Foot.NONE:
            return
        k = FEET.index(foot)
        self._air_s[k] = min(self._air_s[k] + EVERY_NS * 1e-9, MEMORY_S)
        self._in_air[k] += (wrenches[k][:3] - self._in_air[k]) * EVERY_NS * 1e-9 / self._air_s[k]
        x, y, down = (self._in_air[k] / self.weight).tolist()
        pulled, sideways = down < -SAID, hypot(x, y) > SAID + max(down, 0.0)
        self.active = self._air_s[k] >= FIRST_S and (pulled or sideways)

    def _measure(self, reading: Array, link: Posture) -> None:
        """Readings (12,) of both sensors, when the robot stands as `link` says."""
        stands, air = Foot.LEFT, _in_the_air(link)
        if air != Foot.NONE:
            k, stands = 6 * FEET.index(air), air.other
            H = np.zeros((6, 12))
            H[:, k : k + 6] = np.eye(6)
            self._update(H, reading[k : k + 6], self._variance(IN_THE_AIR, 1))
        # Forces and moments about the COM, in the axes of a sole on the ground.
        H, axes = np.zeros((6, 12)), link.R[stands].T
        for k, foot in zip((0, 6), FEET, strict=True):
            R, arm = axes @ link.R[foot], axes @ (link.p[foot] - link.com)
            H[:3, k : k + 3] = H[3:, k + 3 : k + 6] = R
            H[3:, k : k + 3] = np.cross(np.broadcast_to(arm, (3, 3)), R.T).T
        weight = np.array([0.0, 0.0, self.weight, 0.0, 0.0, 0.0])
        self._update(H, H @ reading - weight, self._variance(OFF_BALANCE, 1))

    def _update(self, H: Array, z: Array, variance: Array) -> None:
        """Measurement z (6,) = H (6, 12) x with noise of a `variance` (6,)."""
        PH = self._P @ H.T
        gain = np.linalg.solve(H @ PH + np.diag(variance), PH.T).T
        self._x += gain @ (z - H @ self._x)
        self._P -= gain @ PH.T
        self._P = 0.5 * (self._P + self._P.T)

    def _variance(self, deviations: tuple[float, float], feet: int) -> Array:
        """(6 * feet,) of forces and moments."""
        return (np.tile(np.repeat(deviations, 3), feet) * self.weight) ** 2


def in_kilograms(both: float, much: bool) -> bool:
    """Whether vertical forces are in kgf rather than in newtons with zeros that cancel most of the weight.

    Args:
        both: mean of both feet, in weights.
        much: whether a foot reads more than MOST_KILOGRAMS, more than now and then.
    """
    return KILOGRAMS[0] < both < KILOGRAMS[1] and not much


def _in_the_air(link: Posture) -> Foot:
    """The foot that is in the air by the joints; `NONE`: neither, or not for certain."""
    height = link.sole_pose(Foot.LEFT, Foot.RIGHT)[2, 3]
    above = link.sole_pose(Foot.RIGHT, Foot.LEFT)[2, 3]
    if min(abs(height), abs(above)) <= CLEARANCE or height * above >= 0.0:
        return Foot.NONE
    return Foot.RIGHT if height > 0.0 else Foot.LEFT
