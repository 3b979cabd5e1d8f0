# SPDX-License-Identifier: BSD-3-Clause
"""Which way is down in `odom`: the slope of the ground that the soles stand on, as far as IMU or plan know it.

The support sole lies on the ground. The IMU says how the trunk hangs against gravity and the joints how the sole lies
to the trunk; without an IMU the planned poses of the soles say it. A slope below `LEAST` may be an IMU
that is mounted a degree off: the ground is taken as level.

Without both nobody knows. Then a force along the soles, in the mean over some seconds, is either a slope or something
that pushes the robot: the ground is in doubt. Wrenches that are computed are computed for level ground then and show no
slope: the ground is always in doubt.
"""

from __future__ import annotations

from math import atan2, expm1, hypot
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..base.compiled import apply, compiled
from ..base.pose import LEVEL
from ..base.types import Array, Foot, Sample

if TYPE_CHECKING:
    from ..robot.robot import Posture, Robot

LEAST = 0.026  # [rad] of a slope that is believed: 1.5 degrees
GONE = 0.6  # of that: below it, the ground is level again
MEMORY = 2.0  # [s]
EVERY_NS = 20_000_000  # between looks
GAP = 0.1  # [s] that one look counts for at most
DOUBT = 0.05  # of the vertical force: mean force along the soles


class Ground(NamedTuple):
    """What is known of the slope of the ground, for results.

    Attributes:
        source: imu, plan, or none: the last slope that was known stays, level if none was.
        roll, pitch: [rad] about x, y of `odom`, as in the effect `ground_slope`.
        doubtful: whether nobody knows, or a plan says that it is level, and forces along the soles speak against that
            or, where nobody knows, are not measured.
    """

    source: str
    roll: float
    pitch: float
    doubtful: bool


class Slope:
    """The slope under one robot, sample by sample.

    Attributes:
        down: (3,) direction of gravity in `odom`.
        tilted: whether that is not `LEVEL`.
        doubtful: as in `Ground`; doubted: whether it ever was.
    """

    def __init__(self, robot: Robot, measured: bool = True) -> None:
        """`measured`: whether sensors measure the wrenches of the feet."""
        self._robot, self._measured = robot, measured
        self.doubted = False
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._up, self._force, self._seconds = np.zeros(3), np.zeros(3), 0.0
        self._last_ns = self._next_ns = self._imu_ns = 0
        self._source = "none"
        self.down, self.tilted, self.doubtful = LEVEL, False, False

    def update(self, sample: Sample, link: Posture, foot: Foot, T_odom_sole: Array) -> None:
        """Take a sample, whose joints `link` has; foot: the support foot, whose pose in odom is T_odom_sole (4, 4)."""
        stamp = sample.stamp_ns
        if stamp < self._next_ns:
            return
        R = T_odom_sole[:3, :3]
        up, source = self._by_imu(sample, link, foot), "imu"
        if up is None:
            up, source = _by_plan(sample, foot), "plan"
        source = source if up is not None else "none"
        if source == "imu":
            self._imu_ns = stamp
        elif self._source == "imu" and stamp - self._imu_ns < MEMORY * 1e9:
            self._next_ns = stamp + EVERY_NS  # a gap of the IMU, not its end
            return
        if source != self._source:
            self._source, self._up, self._force, self._seconds = source, np.zeros(3), np.zeros(3), 0.0
        dt = min((stamp - self._last_ns) * 1e-9, GAP) if self._last_ns else GAP
        self._last_ns, self._next_ns = stamp, stamp + EVERY_NS
        self._seconds += dt
        fresh = -expm1(-dt / min(self._seconds, MEMORY)) if self._seconds > dt else 1.0
        if up is not None:
            self._up += fresh * (R @ up - self._up)
            self._decide()
        # A plan that is level may know of no slope.
        if up is None or (source == "plan" and self._measured and not self.tilted):
            self._doubt(sample, link, foot, fresh)
            self.doubted |= self.doubtful

    def known(self) -> Ground:
        """For results."""
        x, y, z = self.down
        return Ground(self._source, float(np.arctan2(-y, -z)), float(np.arctan2(x, hypot(y, z))), self.doubtful)

    def _decide(self) -> None:
        x, y, z = self._up.tolist()
        angle = atan2(hypot(x, y), z)
        self.doubtful = False
        self.tilted = angle > (LEAST * GONE if self.tilted else LEAST)
        self.down = -self._up / np.linalg.norm(self._up) if self.tilted else LEVEL

    def _doubt(self, sample: Sample, link: Posture, foot: Foot, fresh: float) -> None:
        if not self._measured:
            self.doubtful = self._seconds > MEMORY
            return
        own, other = sample.left_wrench, sample.right_wrench
        if own is None or other is None:
            return
        if foot == Foot.RIGHT:
            own, other = other, own
        force = own[:3] + link.sole_pose(foot, foot.other)[:3, :3] @ other[:3]
        self._force += fresh * (force - self._force)
        along = hypot(self._force[0], self._force[1])
        self.doubtful = self._seconds > MEMORY and along > DOUBT * abs(float(self._force[2]))

    def _by_imu(self, sample: Sample, link: Posture, foot: Foot) -> Array | None:
        """(3,) up in the frame of the support sole; None: the IMU does not say."""
        imu = sample.imu
        if imu is None or imu.orientation is None:
            return None
        if (frame := self._robot.sensor_frame(imu.frame_id)) is None:
            return None
        up = np.empty(3)
        _upwards(imu.orientation, link.orientation(frame), link.R[foot], up)
        return up


@compiled
def _upwards(quaternion: Array, R_imu: Array, R_sole: Array, up: Array) -> None:
    """Fill in up (3,) in a sole frame by the orientation x y z w of an IMU; both frames (3, 3) in the base frame."""
    up[:] = apply(R_sole.T, apply(R_imu, up_of(quaternion)))


@compiled
def up_of(quaternion: Array) -> Array:
    """Up (3,) in the frame of an IMU, by its orientation x y z w."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return np.array((2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)))


def _by_plan(sample: Sample, foot: Foot) -> Array | None:
    """(3,) up in the frame of the support sole, `odom` of the plan being level; None: there is no plan."""
    plan = sample.reference
    return None if plan is None else plan.sole_pose(foot)[2, :3]
