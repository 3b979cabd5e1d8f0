# SPDX-License-Identifier: BSD-3-Clause
"""Checks of torques, motor positions and IMU against what must agree with them: signs, units, order of quaternions.

Each is reported only where it stands out: what agrees with another unit or sign does so clearly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..base.input_warning import InputWarning, WarningKind
from ..base.stream_names import IMU, MOTORS
from ..base.types import Foot, ImuMessage, Sample
from ..measured.torque_signs import TorqueSigns

if TYPE_CHECKING:
    from ..robot.robot import Robot

_EVERY = 5  # sample that is offered: a look costs as much as a prediction
_LOOKS = 20  # at the IMU or at positions, before a warning
_LOAD = 0.3  # of the weight: a foot that bears more is loaded
_AGREE = 0.8  # correlation from which two measurements are of the same thing
_MOVES = 0.05  # [rad] of a joint, from which its positions are compared
_ONE_G = (0.7, 1.3)  # mean acceleration at which it is in units of gravity
_UP = 0.95  # cosine between two directions that are both up
_NOT_UP = 0.8


class Signs:
    """What agrees only with a sign reversed or in another unit; a *look* is one sample that is checked.

    Attributes:
        weight: of the robot [N]; may be exchanged at any time.
    """

    def __init__(self, robot: Robot, weight: float) -> None:
        self._robot, self.weight = robot, weight
        self._data = robot.model.createData()
        self._configuration = pin.neutral(robot.model)
        self._torque_signs = TorqueSigns(robot.joint_names)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        joints = len(self._robot.joint_names)
        self._offered = 0
        self._torque_signs.reset()
        self._first: np.ndarray | None = None
        self._count = 0
        self._sums = np.zeros((2, joints))  # of link and motor positions, less the first ones
        self._products = np.zeros((3, joints))  # link squared, motor squared, link by motor
        self._imu = 0
        self._acceleration = 0.0
        self._upright = np.zeros(2)  # sum of cosines: as x y z w, as w x y z

    def update(self, sample: Sample) -> None:
        """Take one sample; every fifth is looked at."""
        self._offered += 1
        if self._offered % _EVERY:
            return
        if sample.motor_q is not None:
            self._positions(sample.q, sample.motor_q)
        if sample.imu is not None:
            self._look_at(sample.imu)
        if sample.tau is not None:
            self._torques(sample, sample.tau)

    def _positions(self, q: np.ndarray, motor_q: np.ndarray) -> None:
        if self._first is None:
            self._first = np.array([q, motor_q])
        a, b = np.array([q, motor_q]) - self._first
        self._count += 1
        self._sums += [a, b]
        self._products += [a * a, b * b, a * b]

    def _look_at(self, imu: ImuMessage) -> None:
        size = float(np.linalg.norm(imu.linear_acceleration))
        if not np.isfinite(size) or size < 1e-3:
            return
        self._imu += 1
        self._acceleration += size
        if imu.orientation is None:
            return
        up = imu.linear_acceleration / size
        for k, order in enumerate(((0, 1, 2, 3), (1, 2, 3, 0))):
            turned = pin.Quaternion(imu.orientation[list(order)]).normalized().toRotationMatrix()
            self._upright[k] += turned[2] @ up

    def _torques(self, sample: Sample, tau: np.ndarray) -> None:
        """Of a loaded leg, against what bears the force under its foot: -J' w; weight of the leg left out."""
        robot = self._robot
        wrenches = {Foot.LEFT: sample.left_wrench, Foot.RIGHT: sample.right_wrench}
        loaded = {f: w for f, w in wrenches.items() if w is not None and w[2] > _LOAD * self.weight}
        if not loaded:
            return
        robot.scatter(sample.q, self._configuration)
        pin.forwardKinematics(robot.model, self._data, self._configuration)
        for foot, wrench in loaded.items():
            J = pin.computeFrameJacobian(
                robot.model, self._data, self._configuration, robot.sole_ids[foot], pin.ReferenceFrame.LOCAL
            )
            needed = -J[:, robot.leg_columns[foot]].T @ wrench
            self._torque_signs.look(robot.legs[foot], needed, tau[robot.legs[foot]])

    def warnings(self) -> list[InputWarning]:
        """Present warnings."""
        return [*self._torque_signs.warnings(), *self._of_motors(), *self._of_imu()]

    def _of_motors(self) -> list[InputWarning]:
        if self._count < _LOOKS:
            return []
        mean = self._sums / self._count
        link, motor = self._products[:2] / self._count - mean**2
        both = self._products[2] / self._count - mean[0] * mean[1]
        moves = (link > (0.5 * _MOVES) ** 2) & (motor > (0.5 * _MOVES) ** 2)
        names = [
            self._robot.joint_names[k] for k in np.flatnonzero(moves) if both[k] < -_AGREE * np.sqrt(link[k] * motor[k])
        ]
        if not names:
            return []
        text = (
            f"{MOTORS}: motor and joint of {', '.join(names)} turn in opposite directions: wrong sign of one of them?"
        )
        return [InputWarning(WarningKind.SIGN, MOTORS, text)]

    def _of_imu(self) -> list[InputWarning]:
        if self._imu < _LOOKS:
            return []
        acceleration, (usual, other) = self._acceleration / self._imu, self._upright / self._imu
        if _ONE_G[0] < acceleration < _ONE_G[1]:
            text = f"{IMU}: the mean acceleration is {acceleration:.2f}: in units of gravity? wanted are m/s^2"
            return [InputWarning(WarningKind.UNIT, IMU, text)]
        if usual < _NOT_UP and other > _UP:
            text = f"{IMU}: orientation and acceleration agree if the quaternion is w x y z; wanted is x y z w"
            return [InputWarning(WarningKind.UNIT, IMU, text)]
        if usual < -_UP:
            text = f"{IMU}: the acceleration at rest is down by the orientation: wrong sign? wanted is up, 9.81 m/s^2"
            return [InputWarning(WarningKind.SIGN, IMU, text)]
        return []
