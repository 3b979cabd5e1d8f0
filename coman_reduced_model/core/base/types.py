# SPDX-License-Identifier: BSD-3-Clause
"""What flows through the package: messages in, Sample, Prediction out. Plain data, SI units.

The way through is: message or bag -> (JointMessage, WrenchMessage, Reference) -> Joiner -> Sample ->
Predictor -> Prediction -> topic, bag, summary. Nothing here knows ROS, bags or Pinocchio.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]  # indices, counts, stamps [ns], phases and feet by number
Booleans = NDArray[np.bool_]
_NAN2, _NAN3, _NAN33 = np.full(2, np.nan), np.full(3, np.nan), np.full((3, 3), np.nan)
_NAN63, _NAN66 = np.full((6, 3), np.nan), np.full((6, 6), np.nan)


class Phase(IntEnum):
    """Support phase; the numbers are those of coman_reduced_model_msgs/SupportState."""

    FLIGHT = 0
    LEFT = 1
    RIGHT = 2
    DOUBLE = 3


class Foot(IntEnum):
    """A foot; the numbers are those of coman_reduced_model_msgs/SupportState."""

    NONE = 0
    LEFT = 1
    RIGHT = 2

    @property
    def other(self) -> Foot:
        return _OTHER[self]


_OTHER = (Foot.NONE, Foot.RIGHT, Foot.LEFT)


@dataclass(slots=True)
class JointMessage:
    """One sensor_msgs/JointState as it came: link side or motor side.

    Arrays have one entry a name; velocity and effort are None when the message leaves them empty.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: Array  # [rad]
    velocity: Array | None  # [rad/s]
    effort: Array | None  # [Nm]


@dataclass(slots=True)
class WrenchMessage:
    """What the ground exerts on one foot, in the frame that the message names."""

    stamp_ns: int
    frame_id: str
    force: Array  # (3,) [N]
    torque: Array  # (3,) [Nm], about the origin of frame_id


@dataclass(slots=True)
class ContactMessage:
    """Which feet are on the ground, by switches or by a controller."""

    stamp_ns: int
    left: bool
    right: bool


@dataclass(slots=True)
class ImuMessage:
    """Orientation and rates of the body that carries the IMU."""

    stamp_ns: int
    frame_id: str
    orientation: Array | None  # (4,) quaternion x y z w, world <- frame_id; None: not given
    angular_velocity: Array  # (3,) [rad/s] in frame_id
    linear_acceleration: Array  # (3,) [m/s^2] in frame_id


@dataclass(slots=True)
class PlannedSteps:
    """The preview of a plan with its feet, as its message has them, in `odom`: n points, whatever a sample's stamp."""

    stamp_ns: int  # of the message; the first point is dt later
    dt: float  # [s]
    com: Array  # (n, 3) [m]
    soles: Array  # (n, 14) position [m] and quaternion x y z w of the left and the right sole
    phase: Integers  # (n,)

    @property
    def end_ns(self) -> int:
        """Stamp of the last point."""
        return self.stamp_ns + round(1e9 * self.dt * len(self.com))


@dataclass(slots=True)
class Reference:
    """One point of the planned motion, in `odom` (ComReference)."""

    stamp_ns: int
    com: Array  # (3,) [m]
    com_vel: Array  # (3,) [m/s]
    com_acc: Array  # (3,) [m/s^2]
    zmp: Array  # (3,) [m]
    T_odom_left: Array  # (4, 4) planned pose of the left sole
    T_odom_right: Array  # (4, 4) planned pose of the right sole
    phase: Phase
    step: int  # index of the step, from 0; -1 before the first
    preview_dt: float = 0.0  # [s] interval of the preview; 0: no preview
    preview_com: Array = field(default_factory=lambda: np.empty((0, 3)))  # (n, 3) [m], first at stamp + preview_dt
    preview_com_vel: Array = field(default_factory=lambda: np.empty((0, 3)))  # (n, 3) [m/s]
    steps: PlannedSteps | None = None  # the preview with its feet, where the plan says them

    def sole_pose(self, foot: int) -> Array:
        """Planned pose (4, 4) of the sole of a foot in the plan's odom."""
        return self.T_odom_left if foot == Foot.LEFT else self.T_odom_right


@dataclass(slots=True)
class PlannedDeflection:
    """What a plan asks of the springs of both legs at a stamp; m joints, the left leg's first."""

    stamp_ns: int
    deflection: Array  # (m,) link minus motor position [rad]: motors lead the planned joints by its opposite
    torque: Array  # (m,) [Nm] that the springs transmit


@dataclass(slots=True)
class Sample:
    """All streams at the stamp of one joint state; what is missing is None, never zero.

    Joint arrays are in the order of `Robot.joint_names` (actuated joints of the URDF; joints that no
    message lists are held at zero position, as doc/topics.md says).
    """

    stamp_ns: int
    q: Array  # (nj,) link positions [rad]
    qd: Array  # (nj,) link velocities [rad/s]
    tau: Array | None = None  # (nj,) measured torques [Nm]; NaN where a joint has none
    motor_q: Array | None = None  # (nj,) motor-side positions [rad]
    motor_qd: Array | None = None  # (nj,) [rad/s]
    left_wrench: Array | None = None  # (6,) force [N], torque [Nm] of the ground on the foot, in the sole frame
    right_wrench: Array | None = None  # (6,) the same for the right foot
    reference: Reference | None = None
    imu: ImuMessage | None = None
    contacts: ContactMessage | None = None  # where wrenches are computed from contact states


class Flags(IntFlag):
    """The bits of ComPrediction.flags: all but SIMPLER_AHEAD say why (part of) a prediction is not valid."""

    OK = 0
    NO_REFERENCE = 1  # no reference of the configured source: reference and predictions are NaN
    STALE_WRENCH = 2  # a foot wrench is missing or too old: phase held
    NOT_INITIALISED = 4  # the free run has not started yet (no support phase so far)
    NO_SUPPORT = 8  # flight, or the phase is not known yet
    NEAR_SINGULAR = 16  # the support leg is close to a singular posture: stiffness was limited
    RESET = 32  # the free run was initialised from the measurement at this sample
    REJECTED_STATE = 64  # beyond physics: the free run was restarted (with RESET), or the model's prediction ahead lost
    INCONSISTENT = 128  # the estimate's innovations have been far larger than its covariance says
    COMPUTED_WRENCH = 256  # the wrenches are computed (streams.wrench_source), not measured
    UNKNOWN_GROUND = 512  # the slope is not known, and forces show one or are computed; or a foot landed aslant
    SIMPLER_AHEAD = 1024  # ahead, simpler predictions have been better than the model on some axis: (partly) published

    @property
    def invalid(self) -> Flags:
        """The flags without SIMPLER_AHEAD; OK if everything is valid."""
        return self & ~Flags.SIMPLER_AHEAD

    @property
    def diverged(self) -> bool:
        """Whether the free run diverged: at this sample it begins from the measurement again and predicts nothing."""
        return int.__and__(self, _DIVERGED) == _DIVERGED


_DIVERGED = int(Flags.RESET | Flags.REJECTED_STATE)


@dataclass(slots=True)
class SupportState:
    """Support phase at one instant."""

    phase: Phase = Phase.FLIGHT
    support_foot: Foot = Foot.NONE
    left_share: float = float("nan")  # share of the vertical force on the left foot, 0..1
    phase_time: float = 0.0  # [s] since the phase began
    total_force: float = float("nan")  # [N] sum of the vertical forces
    foot_time: float = 0.0  # [s] since the support foot became it


@dataclass(slots=True)
class HorizonPrediction:
    """COM predicted h seconds ahead of the stamp, in the frame of the current support sole.

    With `prediction.blend` the model's and simpler predictions are blended by how wrong each has lately been.
    """

    h: float  # [s]
    com: Array  # (3,) [m]
    # (3, 3) [m^2] of its errors lately, at first by the covariance of the estimate; NaN: not known yet
    covariance: Array = field(default_factory=lambda: _NAN33)
    model_share: Array = field(default_factory=lambda: _NAN3)  # (3,) [1] by axis, weight of the model in the blend


@dataclass(slots=True)
class TrunkRotation:
    """Rotation of the trunk (`robot.base_frame`) to gravity; NaN where it is not known.

    The level frame is the support sole turned upright: z against gravity, x above that of the sole. So roll and pitch
    are those to gravity, yaw is that against the support sole.
    """

    R: Array = field(default_factory=lambda: _NAN33)  # (3, 3) trunk to level frame
    angular_velocity: Array = field(default_factory=lambda: _NAN3)  # (3,) of the trunk, in its own axes [rad/s]
    # (6, 6) of a small turn about the axes of the trunk and of the angular velocity [rad^2, rad^2/s, rad^2/s^2]
    covariance: Array = field(default_factory=lambda: _NAN66)
    by_imu: bool = False  # roll and pitch are the IMU's; else the encoders', the support sole being taken as flat


_NO_ROTATION = TrunkRotation()


@dataclass(slots=True)
class Estimate:
    """What the observer knows at one sample, in the frame of the support sole; NaN where it knows nothing."""

    com: Array = field(default_factory=lambda: _NAN3)  # (3,) [m]
    com_vel: Array = field(default_factory=lambda: _NAN3)  # (3,) [m/s]
    covariance: Array = field(default_factory=lambda: _NAN66)  # (6, 6) of both [m^2, m^2/s, m^2/s^2]
    measured_covariance: Array = field(default_factory=lambda: _NAN33)  # (3, 3) of the measured COM [m^2]
    force: Array = field(default_factory=lambda: _NAN3)  # (3,) external force on the robot [N]
    force_covariance: Array = field(default_factory=lambda: _NAN33)  # (3, 3) [N^2]
    nis: float = float("nan")  # [1] normalised innovation squared of the measured COM; 3 is expected
    moment: Array = field(default_factory=lambda: _NAN3)  # (3,) of what pushes the robot, about the COM [Nm]
    moment_covariance: Array = field(
        default_factory=lambda: _NAN63
    )  # (6, 3) of force and moment with it [N Nm], [Nm^2]
    trunk: TrunkRotation = field(default_factory=lambda: _NO_ROTATION)
    # (3,) of the COM against the ground, in the axes of the sole, which tilts; NaN without an IMU [m/s]
    ground_vel: Array = field(default_factory=lambda: _NAN3)
    ground_vel_covariance: Array = field(default_factory=lambda: _NAN33)  # (3, 3) [m^2/s^2]


_NO_ESTIMATE = Estimate()


@dataclass(slots=True)
class DeflectionPrediction:
    """Deflections at stamp + h: of the COM (measured minus reference) and of the joints (link minus motor).

    With one standard deviation of what they have lately been off by; NaN: not known (yet).
    """

    h: float  # [s]; 0: at the stamp
    com: Array  # (3,) [m] in the axes of the support sole at the stamp
    com_sigma: Array  # (3,) [m]
    joints: Array  # (m,) [rad] of the joints of both legs, hip to ankle, the left leg's first
    joint_sigma: Array  # (m,) [rad]


@dataclass(slots=True)
class Prediction:
    """Predicted against measured COM at one joint state, in the frame of the support sole.

    Vectors are (3,), in m and m/s; NaN where not valid (see flags). residual = measured - predicted.
    """

    stamp_ns: int
    frame_id: str
    support: SupportState
    measured_com: Array
    measured_com_vel: Array
    reference_com: Array
    reference_com_vel: Array
    predicted_com: Array
    predicted_com_vel: Array
    T_odom_sole: Array  # (4, 4) pose of the support sole in odom
    horizons: list[HorizonPrediction]
    flags: Flags
    # (2,) roll, pitch of the trunk about x, y of the support sole [rad]; NaN without trunk_rotation
    measured_tilt: Array = field(default_factory=lambda: _NAN2)
    predicted_tilt: Array = field(default_factory=lambda: _NAN2)
    predicted_covariance: Array = field(default_factory=lambda: _NAN33)  # (3, 3) [m^2] of the residuals lately
    # (6, 3) root link: rotation and position [m] in the support sole, linear [m/s] and angular velocity [rad/s] in its
    # own axes; NaN without a support foot
    base_in_sole: Array = field(default_factory=lambda: _NAN63)
    # Now and at the horizons; empty: no reference.
    deflections: list[DeflectionPrediction] = field(default_factory=list)
    repeating: bool = False  # deflections ahead follow from the last stride, which the robot repeats
    stepping: bool = False  # or from the steps of the plan

    estimate: Estimate = field(default_factory=lambda: _NO_ESTIMATE)

    @property
    def residual(self) -> Array:
        """Measured minus predicted COM (3,) [m]."""
        return self.measured_com - self.predicted_com

    @property
    def T_odom_base(self) -> Array:  # noqa: N802
        """Pose (4, 4) of the root link in odom, by the odometry of the feet; NaN without a support foot."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.base_in_sole[:3], self.base_in_sole[3]
        return self.T_odom_sole @ T

    @property
    def base_twist(self) -> Array:
        """Velocity (6,) of the root link in its own axes: linear [m/s], angular [rad/s]; NaN without a support foot."""
        return self.base_in_sole[4:].ravel()
