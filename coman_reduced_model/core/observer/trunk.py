# SPDX-License-Identifier: BSD-3-Clause
"""The filter of the trunk's rotation, fed from samples: by the IMU where there is one, else by the encoders.

What is constant is in the published covariance, not in the filter: zeros and rounding of the encoders, how the IMU is
mounted or, without it, the slope of the ground (nominal variability, config/nominal.yaml).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..base.compiled import all_finite
from ..base.types import Array, Foot, Integers, Phase, TrunkRotation
from .memory import BEGINS, CHANGES, GOES_ON
from .rotation import BY_ENCODERS, BY_IMU, OUT, SIZE, consider, follow, turned_of

if TYPE_CHECKING:
    from ..base.nominal import Nominal
    from ..effects.hooks import Now
    from ..robot.robot import Robot

GAP = 0.1  # [s] without a sample after which it begins again
WALK = 0.1  # of the natural angular velocity: how far that of the trunk wanders in the root of a second, at first
BRIDGED_NS = 300_000_000  # without a message of the IMU, after which the encoders take its place
EVERY_NS = 100_000_000  # between new covariances by what is constant
_LEVEL, _NO_TURN, _STILL = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)


class TrunkFilter:
    """The filter of one robot, sample by sample."""

    def __init__(self, robot: Robot, gravity: float, radius: float, nominal: Nominal) -> None:
        """Build the filter.

        Args:
            robot: its frames and columns.
            gravity: [m/s^2].
            radius: of gyration [m].
            nominal: how nominal robots differ.
        """
        widths = nominal.widths
        self._robot = robot
        self._natural = float(np.sqrt(gravity / radius))  # [rad/s]
        self._tilts = widths["ground_slope.spread"] ** 2, widths["imu.spread"] ** 2  # of sole and IMU
        self._zero = widths["encoder_bias.bias.spread"] ** 2
        self._columns: dict[tuple[Foot, int], tuple[Integers, Integers]] = {}
        self._block = np.zeros(SIZE)
        self._at = turned_of(self._block)
        self.reset()

    def reset(self) -> None:
        """Forget the past, but not how the IMU is mounted."""
        self._at.walks[:] = (WALK * self._natural) ** 2
        self._foot, self._source = Foot.NONE, BY_ENCODERS
        self._frame: int | None = None  # of the IMU
        self._stamp_ns = self._imu_ns = self._considered_ns = 0

    def update(self, now: Now, steps: Array) -> TrunkRotation:
        """Take one sample; steps: (nj,) of the encoders [rad], infinite where not known."""
        sample, link, foot = now.sample, now.link, now.foot
        imu, frame = sample.imu, None
        orientation, gyro, late, oriented, turning = _NO_TURN, _STILL, 0.0, False, False
        source = BY_ENCODERS
        if imu is not None and (frame := self._robot.sensor_frame(imu.frame_id)) is not None:
            new, late = imu.stamp_ns != self._imu_ns, (imu.stamp_ns - sample.stamp_ns) * 1e-9
            self._imu_ns = imu.stamp_ns
            if imu.orientation is not None and all_finite(imu.orientation):
                source, oriented, orientation = BY_IMU, new, imu.orientation
            gyro, turning = imu.angular_velocity, new
        elif imu is None and self._source == BY_IMU and sample.stamp_ns - self._imu_ns < BRIDGED_NS:
            source, frame = BY_IMU, self._frame  # the next message will come
        dt = (sample.stamp_ns - self._stamp_ns) * 1e-9
        goes_on = self._foot != Foot.NONE and source == self._source and 0.0 < dt <= GAP
        if source == BY_IMU and not (goes_on or oriented):  # it was there before the filter began
            oriented = True
        what = BEGINS if not goes_on else GOES_ON if foot == self._foot else CHANGES
        self._stamp_ns, self._foot, self._source, self._frame = sample.stamp_ns, foot, source, frame
        robot, R_sole = self._robot, link.R[foot]
        R_trunk = link.orientation(robot.base_id)
        R_imu = R_trunk if frame is None else link.orientation(frame)
        if what != GOES_ON or sample.stamp_ns - self._considered_ns >= EVERY_NS:
            self._considered_ns = sample.stamp_ns
            consider(
                self._block, link.views, self._between(foot, frame), R_trunk, source == BY_IMU, steps, robot.idx_v,
                self._zero, self._tilts,
            )  # fmt: skip
        out = np.empty((OUT, 3))
        step, sensors = (what, dt, int(now.support.phase != Phase.DOUBLE)), (source, oriented, turning, late)
        up = _LEVEL if (aslant := now.aslant) is None else _LEVEL - aslant
        posture = R_imu, R_trunk, R_sole
        if not follow(self._block, step, sensors, self._natural, posture, up, orientation, gyro, out):
            self.reset()
            return TrunkRotation()
        return TrunkRotation(out[:3], out[3], out[4:].reshape(6, 6), source == BY_IMU)

    def _between(self, foot: Foot, imu: int | None) -> tuple[Integers, Integers]:
        """Columns of the joints between the trunk and a sole, and between the trunk and the IMU."""
        robot = self._robot
        key = foot, -1 if imu is None else imu
        if key not in self._columns:
            trunk, *others = (
                _moved_by(robot, frame)
                for frame in (robot.base_id, robot.sole_ids[foot], robot.base_id if imu is None else imu)
            )
            sole, sensor = (np.array(sorted(trunk ^ other), dtype=np.intp) for other in others)
            self._columns[key] = sole, sensor
        return self._columns[key]


def _moved_by(robot: Robot, frame: int) -> set[int]:
    """Columns of the joints between the root link and a frame."""
    below = list(robot.model.supports[robot.model.frames[frame].parentJoint])
    return {robot.model.joints[joint].idx_v for joint in below[2:]}
