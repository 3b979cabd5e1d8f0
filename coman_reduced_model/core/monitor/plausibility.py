# SPDX-License-Identifier: BSD-3-Clause
"""Checks for faults that no single message shows: wrong signs and units, swapped feet, bias, values that are held.

They are reported, never corrected: the user decides what is wrong. Wrenches are looked at as they came, before large
zeros are taken off (`measured/sensor_zeros.py`); only where they point to is looked at without any zeros.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..base.input_warning import InputWarning, WarningKind
from ..base.stream_names import JOINTS, MOTORS, WRENCHES
from ..base.types import Foot, Sample
from ..config.schema import Config
from ..measured.sensor_zeros import CLEARANCE, MOST_KILOGRAMS, SensorZeros, in_kilograms
from ..streams.possible import Refusals
from .held import HeldValues
from .signs import Signs
from .turned import Turned

if TYPE_CHECKING:
    from ..robot.robot import Robot

_INTERVAL_NS = 20_000_000  # between looks
_MIN_LOOKS = 50  # before a warning: 1 s
_NEGATIVE = 0.02  # share of the weight: a mean force below minus this is more than a bias
_STANDS = 0.4  # share of the weight: a raised foot that carries more stands on something
_CARRIES = 0.8  # share of both forces on the foot in the air, from which the feet are swapped
_TURN = 2.0 * np.pi  # [rad] by which no joint of a leg is turned
_LOADED = 0.3  # share of the weight: a foot on the ground that bears so much is loaded for certain
_NOW_AND_THEN = 0.02  # share of looks
_GEARED = 5.0  # motor positions over joint positions, from which they are not on the same side of the gear
_NO_REFUSALS: Mapping[str, Refusals] = {}
_NO_ZEROS = {Foot.LEFT: 0.0, Foot.RIGHT: 0.0}
_MOVES = 0.05  # [rad] of a joint, from which the two are compared


class Plausibility:
    """Checks samples at 50 Hz; a *look* is one sample that is checked."""

    def __init__(self, robot: Robot, config: Config) -> None:
        self._robot = robot
        self._weight = config.support.weight or robot.mass * config.robot.gravity
        self._posture = robot.posture()
        self._signs = Signs(robot, self._weight)
        self._held = HeldValues()
        self._turned_wrenches = Turned(robot, self._weight)
        legs = {*config.robot.left.joints, *config.robot.right.joints}
        self._of_legs = np.array([name in legs for name in robot.joint_names])
        self.reconfigure(config)
        self.reset()

    def reconfigure(self, config: Config) -> None:
        """Take over the thresholds of the support phase."""
        self._weight = config.support.weight or self._robot.mass * config.robot.gravity
        self._signs.weight = self._turned_wrenches.weight = self._weight
        self._lifts = config.support.contact_off * self._weight  # [N] a foot that reads more is never in the air

    def reset(self) -> None:
        """Forget the past."""
        self._signs.reset()
        self._held.reset()
        self._turned_wrenches.reset()
        self._next = 0
        self._force = {Foot.LEFT: 0.0, Foot.RIGHT: 0.0}
        self._negative = {Foot.LEFT: 0, Foot.RIGHT: 0}
        self._much = 0  # looks at which a foot reads more than it does in kilograms
        self._looks = 0
        joints = len(self._robot.joint_names)
        self._lowest = np.full((2, joints), np.inf)  # positions of joints and motors
        self._highest = -self._lowest
        self._still = True  # no joint has had a velocity
        self._turned = np.zeros(joints, dtype=int)  # looks at a joint of a leg beyond a turn
        self._air = {Foot.LEFT: 0, Foot.RIGHT: 0}  # looks at the foot in the air by the joints
        self._air_force = {Foot.LEFT: 0.0, Foot.RIGHT: 0.0}
        self._other_force = {Foot.LEFT: 0.0, Foot.RIGHT: 0.0}  # of the other foot meanwhile
        self._swapped = 0

    def update(self, sample: Sample, zeros: SensorZeros | None = None) -> None:
        """Take one sample as it was measured, and zeros of its foot sensors; stamps must increase between resets."""
        if sample.stamp_ns < self._next:
            return
        self._next = sample.stamp_ns + _INTERVAL_NS
        for k, q in enumerate((sample.q, sample.motor_q)):
            if q is not None:
                np.fmin(self._lowest[k], q, out=self._lowest[k])
                np.fmax(self._highest[k], q, out=self._highest[k])
        self._still = self._still and not sample.qd.any()
        self._turned += self._of_legs & (np.abs(sample.q) > _TURN)
        self._signs.update(sample)
        if sample.left_wrench is None or sample.right_wrench is None:
            return
        left, right = float(sample.left_wrench[2]), float(sample.right_wrench[2])
        for foot, force in ((Foot.LEFT, left), (Foot.RIGHT, right)):
            self._force[foot] += force
            self._negative[foot] += force < -_NEGATIVE * self._weight
        self._much += max(abs(left), abs(right)) > MOST_KILOGRAMS * self._weight
        self._looks += 1
        self._posture.update(sample.q, sample.qd)
        raw = {Foot.LEFT: sample.left_wrench, Foot.RIGHT: sample.right_wrench}
        wrenches = raw if zeros is None else {foot: wrench - zeros.of(foot) for foot, wrench in raw.items()}
        self._turned_wrenches.update(self._posture, sample, wrenches, left + right)
        height = self._posture.sole_to_sole(Foot.LEFT, Foot.RIGHT)[1][2]
        higher = Foot.NONE if abs(height) <= CLEARANCE else Foot.RIGHT if height > 0.0 else Foot.LEFT
        loaded = {  # by its sensor, or because the other one is in the air
            foot: higher is foot.other or (foot is not higher and wrench[2] > _LOADED * self._weight)
            for foot, wrench in wrenches.items()
        }
        self._held.update(sample.stamp_ns, sample.q, raw, loaded)
        if higher is Foot.NONE:
            return
        in_air, other = (left, right) if higher is Foot.LEFT else (right, left)
        self._air[higher] += 1
        self._air_force[higher] += in_air
        self._other_force[higher] += other
        self._swapped += abs(in_air) > max(abs(other), 0.5 * self._weight)

    @property
    def carried(self) -> float | None:
        """Mean of the vertical forces of both feet over the weight; None before enough of them were looked at."""
        return sum(self._force.values()) / self._looks / self._weight if self._looks >= _MIN_LOOKS else None

    def counts(self) -> dict[str, int]:
        """Suspect looks (50 a second); a nominal robot has some too, such as at touchdown."""
        counts = {f"{name}/negative": self._negative[foot] for foot, name in WRENCHES.items()}
        counts["wrenches/swapped"] = self._swapped
        return {name: count for name, count in counts.items() if count}

    def warnings(
        self, zeros: Mapping[Foot, float] = _NO_ZEROS, beyond: Mapping[str, Refusals] = _NO_REFUSALS
    ) -> list[InputWarning]:
        """Present warnings, beside what the sensors are known to read vertically without load [N].

        `beyond`: by stream, positions that no sample holds because most were beyond the limits of their joints.

        Torques, motors and IMU are judged by forces and positions: only where units and signs of these are right.
        """
        found = (self._of_forces(zeros, beyond) or self._turned_wrenches.warnings()) + self._held.warnings()
        found += self._of_velocities()
        return found if any(each.prevents_diagnosis for each in found) else [*found, *self._signs.warnings()]

    def _of_velocities(self) -> list[InputWarning]:
        if not self._still or not (self._highest[0] - self._lowest[0] > _MOVES).any():
            return []
        text = f"{JOINTS}: joints move, but all velocities are 0: not measured? left empty, they are computed"
        return [InputWarning(WarningKind.HELD, JOINTS, text)]

    def _of_forces(self, zeros: Mapping[Foot, float], beyond: Mapping[str, Refusals]) -> list[InputWarning]:
        found = self._units(beyond)
        if any(each.stream == JOINTS for each in found):
            return found  # no posture to judge forces by
        if self._looks >= _MIN_LOOKS:
            for foot, name in WRENCHES.items():
                mean = self._force[foot] / self._looks - zeros[foot]
                if mean < -_NEGATIVE * self._weight:
                    text = (
                        f"{name}: the mean vertical force is {mean:.0f} N: wrong sign? wanted is what the ground "
                        "exerts on the foot (positive while it stands)"
                    )
                    found.append(InputWarning(WarningKind.SIGN, name, text))
        air = sum(abs(self._air_force[foot] - self._air[foot] * zeros[foot]) for foot in WRENCHES)
        ground = sum(abs(self._other_force[foot] - self._air[foot] * zeros[foot.other]) for foot in WRENCHES)
        looks = sum(self._air.values())
        # By magnitude, so that wrong signs do not matter.
        if looks >= _MIN_LOOKS // 2 and air + ground > 0.5 * self._weight * looks and air > _CARRIES * (air + ground):
            text = (
                f"wrenches: the foot in the air by the joints reads {air / looks:.0f} N on average, the other one "
                f"{ground / looks:.0f} N: left and right swapped?"
            )
            return [*found, InputWarning(WarningKind.SWAPPED, "", text)]
        for foot, name in WRENCHES.items():
            mean = self._air_force[foot] / max(self._air[foot], 1) - zeros[foot]
            if self._air[foot] >= _MIN_LOOKS // 2 and self._lifts < mean < _STANDS * self._weight:
                text = (
                    f"{name}: reads {mean:.0f} N on average while the foot is in the air by the joints: a bias? above "
                    f"{self._lifts:.0f} N (support.contact_off) lift-offs are missed"
                )
                found.append(InputWarning(WarningKind.BIAS, name, text))
        return found

    def _units(self, beyond: Mapping[str, Refusals]) -> list[InputWarning]:
        """What is in degrees, in kilograms, or before a gear."""
        found = []
        lowest, highest, turned = self._lowest.copy(), self._highest.copy(), self._turned
        for k, stream in enumerate((JOINTS, MOTORS)):
            if stream in beyond:
                lowest[k] = np.fmin(lowest[k], beyond[stream].lowest)
                highest[k] = np.fmax(highest[k], beyond[stream].highest)
                turned = turned + (beyond[stream].count if k == 0 else 0) * (highest[0] - lowest[0] > _TURN)
        span = highest - lowest
        k = int(np.argmax(self._of_legs * turned))
        if turned[k] >= _MIN_LOOKS:
            largest = max(highest[0, k], -lowest[0, k])
            text = (
                f"{JOINTS}: {self._robot.joint_names[k]} is at {largest:.3g} rad, more than a turn: in degrees? "
                "wanted are radians"
            )
            found.append(InputWarning(WarningKind.UNIT, JOINTS, text))
        moves = (span[0] > _MOVES) & (span[1] > _MOVES)
        ratio = float(np.median(span[1][moves] / span[0][moves])) if moves.any() else 1.0
        if not 1.0 / _GEARED < ratio < _GEARED:
            text = (
                f"{MOTORS}: positions move {ratio:.3g} times as far as those of {JOINTS}: before the gear, or in "
                "another unit? wanted is the motor side behind the gear, in radians"
            )
            found.append(InputWarning(WarningKind.UNIT, MOTORS, text))
        share = self.carried
        if share is not None and in_kilograms(share, self._much > _NOW_AND_THEN * self._looks):
            text = (
                f"wrenches: the mean vertical force of both feet is {share * self._weight:.3g}, and the robot weighs "
                f"{self._weight:.0f} N: in kilograms? wanted are newtons"
            )
            found.append(InputWarning(WarningKind.UNIT, "", text))
        return found
