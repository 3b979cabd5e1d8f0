# SPDX-License-Identifier: BSD-3-Clause
"""The sections of the configuration: each field with its nominal, unit, bounds and description."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..base.parameter import par

WRENCH_SOURCES = ("sensors", "torques", "contacts")


@dataclass(frozen=True)
class StreamsConfig:
    """How the streams are joined by stamp."""

    wrench_source: str = par(
        "sensors",
        "",
        "foot wrenches are measured, or computed from joint torques or from contact states",
        choices=WRENCH_SOURCES,
    )
    max_wait: float = par(0.05, "s", "longest that a joint state waits (in stamps) for the other streams", 0.0, 2.0)
    max_wrench_age: float = par(
        0.05, "s", "a wrench, contact or IMU message farther than this from the joint state is stale", 1e-4, 2.0
    )
    max_motor_age: float = par(0.05, "s", "the same for the motor states", 1e-4, 2.0)
    max_reference_age: float = par(0.1, "s", "the same for com/reference", 1e-4, 5.0)
    restart_gap: float = par(
        0.25, "s", "a gap in the joint states longer than this restarts the prediction", 0.01, 60.0
    )
    velocity_window: float = par(0.04, "s", "window of the differentiation when velocities are missing", 0.002, 0.5)


@dataclass(frozen=True)
class SupportConfig:
    """Support phase from the foot wrenches: a Schmitt trigger a foot.

    The thresholds lie just above what an unloaded foot reads (noise of 1 %, a drifting zero and the inertia of the
    swinging foot, 2 % each), for a foot that peels off or settles carries 5 to 10 % for up to 0.1 s.
    """

    contact_on: float = par(0.07, "1", "share of the weight above which a foot lands", 0.01, 0.9, runtime=True)
    contact_off: float = par(0.04, "1", "share of the weight below which a foot lifts", 0.0, 0.9, runtime=True)
    dwell_on: float = par(0.002, "s", "a landing must last this long to count", 0.0, 0.5, runtime=True)
    dwell_off: float = par(0.007, "s", "a lift must last this long to count", 0.0, 0.5, runtime=True)
    share_hysteresis: float = par(
        0.10,
        "1",
        "in double support the support foot changes when the other carries this much more",
        0.0,
        0.9,
        runtime=True,
    )
    weight: float = par(
        0.0, "N", "weight for the thresholds; 0: mass of the URDF times gravity", 0.0, 1e5, runtime=True
    )


# What the paper's point mass lacks on any robot with springs, by the ablation of `coman validate`.
OPTIONS = ("gravity_stiffness", "trunk_rotation", "swing_momentum", "lateral_compliance")
CHOICES = ("auto", "with", "without")  # of each


@dataclass(frozen=True)
class ModelConfig:
    """The paper's model and the choices in it (model.md; numbers in brackets are the paper's equations).

    Below `friction`, none of it counts where `trunk_rotation` replaces that model.
    """

    trunk_rotation: str = par(
        "auto",
        "",
        "the trunk turns, on the springs of both legs, instead of the paper's point mass; auto: with it if the "
        "reference is the motor side and both legs have as many joints",
        choices=CHOICES,
    )
    gravity_stiffness: str = par(
        "auto", "", "gravity follows the deflection of the legs; auto: as trunk_rotation", choices=CHOICES
    )
    swing_momentum: str = par(
        "auto", "", "moving legs react on the trunk, with trunk_rotation; auto: as that", choices=CHOICES
    )
    lateral_compliance: str = par("auto", "", "deflection in y as well; auto: as trunk_rotation", choices=CHOICES)
    slope: str = par(
        "measured",
        "",
        "slope of the ground: that of IMU or plan, from 1.5 degrees on, or level",
        choices=("measured", "level"),
    )
    friction: float = par(0.8, "1", "between soles and ground, with trunk_rotation", 0.05, 2.0)
    stiffness: str = par(
        "full", "", "linear block of K_c (full) or trunk free to turn (condensed)", choices=("full", "condensed")
    )
    double_support: str = par(
        "scaled",
        "",
        "force of the support leg over its share (22), (23), or both legs in parallel",
        choices=("scaled", "both_legs"),
    )
    shares: str = par(
        "constant", "", "shares of (22), (23): the constants below or measured", choices=("constant", "measured")
    )
    share_x_before: float = par(
        0.42, "1", "x share of the leg in the double support before its single support", 0.05, 1.0
    )
    share_x_after: float = par(
        0.58, "1", "x share of the leg in the double support after its single support", 0.05, 1.0
    )
    share_z_before: float = par(0.42, "1", "z share before its single support (Fig. 9)", 0.05, 1.0)
    share_z_after: float = par(0.58, "1", "z share after its single support (Fig. 9)", 0.05, 1.0)
    a1: float = par(1.0, "1", "coefficient of k_xx in (20)", 0.0, 20.0)
    b1: float = par(1.0, "1", "coefficient of d_xx in (20)", 0.0, 50.0)
    c1: float = par(1.0, "1", "coefficient of k_xz in (20)", -20.0, 20.0)
    e1: float = par(1.0, "1", "coefficient of d_xz in (20)", -50.0, 50.0)
    a2: float = par(1.0, "1", "coefficient of k_zz in (21)", 0.0, 20.0)
    b2: float = par(1.0, "1", "coefficient of d_zz in (21)", 0.0, 50.0)
    c2: float = par(1.0, "1", "coefficient of k_zx in (21)", -20.0, 20.0)
    e2: float = par(1.0, "1", "coefficient of d_zx in (21)", -50.0, 50.0)
    singular_limit: float = par(
        0.02, "1", "smallest singular value of the leg Jacobian (scaled by leg length) taken as it is", 1e-6, 0.5
    )

    @property
    def of_the_point_mass(self) -> tuple[str, ...]:
        """What was chosen for the paper's model alone, and has no use with `trunk_rotation`."""
        others = (*OPTIONS, "friction", "slope")
        return tuple(k for k, value in vars(self).items() if k not in others and value != getattr(ModelConfig, k))


@dataclass(frozen=True)
class PredictionConfig:
    """What is predicted and from which reference (doc/model.md, Two predictions)."""

    reference: str = par(
        "motor", "", "motor-side kinematics, com/reference, or none (LIPM)", choices=("motor", "topic", "none")
    )
    reset_every_steps: int = par(
        1, "steps", "number of steps after which the free run restarts from the measurement; 0: never", 0, 1000
    )
    horizons: tuple[float, ...] = par((0.1, 0.2, 0.4), "s", "how far ahead of each sample it predicts", 0.005, 2.0)
    blend: bool = par(
        True, "", "blend the model's predictions ahead with simpler ones, by how wrong each has lately been"
    )
    adapt: bool = par(
        False,
        "",
        "learn joint stiffness, zeros of encoders and the trunk's COM slowly, within nominal variability; "
        "with trunk_rotation",
    )


@dataclass(frozen=True)
class OutputConfig:
    """What the predictor publishes besides com/prediction."""

    points_rate: float = par(
        50.0,
        "Hz",
        "rate of the PointStamped topics and of com/support when unchanged; 0: off",
        0.0,
        2000.0,
        runtime=True,
    )
    markers_rate: float = par(20.0, "Hz", "rate of com/markers; 0: off", 0.0, 200.0, runtime=True)
    odometry_rate: float = par(
        50.0, "Hz", "rate of foot_odometry and of the transform of publish_tf; 0: off", 0.0, 2000.0, runtime=True
    )
    publish_tf: bool = par(
        True,
        "",
        "publish odom -> root link of the URDF on /tf; false: where another node does (state estimator)",
        runtime=True,
    )
    diagnostics_rate: float = par(1.0, "Hz", "rate of /diagnostics", 0.1, 20.0, runtime=True)


@dataclass(frozen=True)
class MonitorConfig:
    """Watching whether the robot still is what it was, and what its description says (core/monitor/monitor.py)."""

    enabled: bool = par(
        True, "", "watch laws of mechanics for mismatches: /diagnostics, warnings of summary.json", runtime=True
    )
    threshold: float = par(
        6.0, "1", "standard deviations that make a mismatch, of strides in a row", 1.0, 1e3, runtime=True
    )
    baseline: str = par(
        "", "", "file of nominal variability, by coman baseline; empty: that of the shipped population", runtime=True
    )


@dataclass(frozen=True)
class GaitConfig:
    """The walk that the trajectory node plans; names and bounds as in core/gait/parameters.py.

    Changes while it runs count for the next plan.
    """

    name: str = par("test1", "", "named gait whose figures the values below replace", runtime=True)
    step_length: float = par(-2.0, "m", "advance of one step; -2: that of the named gait", -2.0, 1.0, runtime=True)
    single_support: float = par(
        -1.0, "s", "duration of single support; -1: that of the named gait", -1.0, 10.0, runtime=True
    )
    double_support: float = par(
        -1.0, "s", "duration of double support; -1: that of the named gait", -1.0, 10.0, runtime=True
    )
    steps: int = par(-1, "steps", "number of steps; -1: that of the named gait", -1, 100000, runtime=True)
    step_width: float = par(
        -1.0, "m", "distance of the soles in y; -1: that of the named gait", -1.0, 1.0, runtime=True
    )
    com_height: float = par(-1.0, "m", "height of the COM above the soles; -1: that of the named gait", -1.0, 3.0)
    zmp_offset_x: float = par(-1.0, "m", "ZMP ahead of the sole origin; -1: that of the named gait", -1.0, 0.5)
    rate: float = par(200.0, "Hz", "rate of com/reference", 1.0, 1000.0)
    ahead: float = par(
        0.0, "s", "how far com/reference is ahead of the clock, for those who need the plan early", 0.0, 2.0
    )
    preview_interval: float = par(0.02, "s", "spacing of the preview", 0.001, 0.5, runtime=True)
    preview_length: int = par(25, "points", "number of preview points", 0, 500, runtime=True)
    autostart: bool = par(True, "", "start walking at once, without a call of ~/start")
    repeat: bool = par(False, "", "start the plan again when it ends", runtime=True)
    start_time: float = par(-1.0, "s", "ROS time at which the plan starts, as in a bag; -1: at once", -1.0, 1e11)

    def changes(self) -> dict[str, Any]:
        """The parameters of core/gait/parameters.py that replace those of the named gait."""
        given = {
            "step_length_m": self.step_length,
            "single_support_s": self.single_support,
            "double_support_s": self.double_support,
            "steps": self.steps,
            "step_width_m": self.step_width,
            "com_height_m": self.com_height,
            "zmp_offset_x_m": self.zmp_offset_x,
        }
        # One metre backwards is a step that can be asked for; for the others -1 makes no sense.
        return {key: value for key, value in given.items() if value != (-2.0 if key == "step_length_m" else -1)}


@dataclass(frozen=True)
class VirtualRobotConfig:
    """The virtual robot as a node; the predictor takes nothing from here."""

    rate: float = par(200.0, "Hz", "rate of its sensors", 50.0, 1000.0)
    seed: int = par(1, "", "of its sensor noise", 0, 2**31 - 1)
    noise: bool = par(True, "", "sensors with noise, bias, jitter and lost messages; false: perfect ones")
    lead: float = par(0.8, "1", "share of the planned deflection of the springs by which its motors lead", 0.0, 1.0)
    compensate: bool = par(False, "", "lead by `com/planned_deflection` instead, where that is known")
    world: str = par("", "", "file, kind or seed of a world (coman worlds), which then says robot and sensors")
