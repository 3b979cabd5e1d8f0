# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of mechanical laws that hold on any robot, averaged over a support phase; channels.py lists them.

The mean over a phase replaces a filter: the mean of a rate is the difference of the ends over the duration, so damping
and momentum are included and no measurement is differentiated. One value a phase is nearly white.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Records, hold
from ..base.nominal import load_nominal, of_another_robot
from ..base.types import Array, Foot, Prediction, Sample
from ..config.schema import Config
from ..effects.catalogue import CATALOGUE, Effect
from .channels import (
    AFTER_LEFT,
    AFTER_RIGHT,
    AXES,
    FLAT_SOLE_LAWS,
    SPRING_LAWS,
    STANDING,
    WRENCH_LAWS,
    channel_names,
    of_laws,
    read_row,
    row_of,
    shown,
)
from .forces import WINDOW_NS, ForceBalance
from .residuals import JOINT, JOINT_SUMS, RESIDUAL, Sums, feel, take_look

if TYPE_CHECKING:
    from ..robot.robot import Posture, Robot

# [s] after a landing until the impact is over, then until the load of the foot is known: between samples at 200 Hz.
IMPACT_S, LANDED_S = 0.0125, 0.0325
_MIN_DISTANCE = 0.015  # [rad] that a joint moves in a phase, both ways together, for `drag`
_MIN_LOOKS = 8  # for `stiffness` and `late`
_RESIDUAL_SHARE = 0.5  # of the variance of the needed torque: with a larger residual, `late` is not known
_STANDS_OUT = 3.0  # standard deviations of what a foot sensor reads without load
_GAP_S = 0.05  # longest time between two looks over which a spring is integrated
_MAX_WINDOW_NS = 2_000_000_000  # longest window of the force balance
_NAN3 = np.full(3, np.nan)
_IDENTITY = np.eye(4)
_NOT_KNOWN = np.full(4, np.nan), np.asfortranarray(np.eye(3))  # laid out as Pinocchio's


class PhaseMean(NamedTuple):
    """Means over a support phase."""

    values: Array  # (n,) residuals; NaN: not known
    variance: Array  # (n,) of the value over nominal robots; 0: not known
    load: Array  # (n,) deflection of the spring by its torque [rad]; 0 for laws that are not of springs
    posture: Array  # (2 nl,) mean and displacement of the joints, by which similar phases are recognised [rad]


class Laws:
    """Mean residuals of the current phase.

    A *look* is one sample at which the residuals are evaluated.

    Attributes:
        names, units: of the n channels; units are rad, m, s, N, Nm or Ns.
        rows: (n,) name of the row for each channel.
        nominal: these rows, by name.
        scale: (n,) what figures of these rows are multiplied by.
        noise: (kinds, n) nominal standard deviation from phase to phase.
        drift: (n,) variance of the drift from one phase of a kind to the next, as a share of that of the noise.
        by_load: (n,) standard deviation of the value over nominal robots, as a share of the load.
        gait_independent: (n,) whether values of the last phase can be compared with those of another gait.
        by_wrenches: (n,) whether they depend on the foot wrenches.
        of_springs: (n,) whether they hold for each spring alone.
        torques_known: whether torques were measured in all of the last phase.
        looks: since `begin`.
        tipping: the last single support was on the edge of the sole: laws of flat soles are skipped until the next.
        forces: balance of forces.
        notes: what looks wrong with the baseline.
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        self._robot = robot
        self._has_motor_plan = config.prediction.reference == "motor"  # else the reference COM is the plan itself
        soles = np.array([robot.soles[Foot.LEFT], robot.soles[Foot.RIGHT]])
        self.forces = ForceBalance(robot.mass, config.robot.gravity, soles)
        self._joints = _joint_records(robot, config)
        self._left: NDArray[np.bool_] = self._joints["left"]
        self.names = channel_names([robot.joint_names[j] for j in self._joints["index"]])
        self._index = {name: i for i, name in enumerate(self.names)}
        self._select_channels()
        self._set_nominal(robot, config)
        self._sums = np.zeros(len(self._joints), dtype=JOINT_SUMS)
        self._residuals = np.zeros(len(self.names), dtype=RESIDUAL)
        self._held = hold((self.forces.memory, Sums(self._joints, self._sums, self._residuals)))
        self._no_joints = np.full(len(robot.joint_names), np.nan)
        self._imu_frame: tuple[str, int | None] = ("", robot.base_id)  # name and index
        self._first_ns = self._last_ns = 0  # first look of the phase, last look
        self._dt = 0.0  # between the last two looks; 0: not known [s]
        self.tipping = False
        self.begin()

    def _select_channels(self) -> None:
        """Indices of channels."""
        names, at, nl = self.names, self._index, len(self._joints)
        self._spring, self._torque = slice(0, nl), slice(nl, 2 * nl)
        self._force = slice(at["force/x"], at["force/z"] + 1)
        self._slide = slice(at["feet/slide_x"], at["feet/slide_y"] + 1)
        self._landing = at["landing/z"]
        self._late = slice(at["late/left"], at["late/right"] + 1)
        self._stiffness = slice(self._late.start - nl, self._late.start)
        self._drag = slice(self._late.start - 2 * nl, self._late.start - nl)
        self._shown, self._flat = shown(names), of_laws(names, FLAT_SOLE_LAWS)
        self.of_springs, self._wrench_laws = of_laws(names, SPRING_LAWS), of_laws(names, WRENCH_LAWS)
        self.torques_known = False
        self.gait_independent = np.zeros(len(names), dtype=bool)
        self.by_wrenches = self._wrench_laws

    def _set_nominal(self, robot: Robot, config: Config) -> None:
        """Nominal variability, in units of the channels."""
        scale = {
            "N": self.forces.memory.weight,
            "Nm": self.forces.memory.weight * float(robot.posture().com_in_sole(Foot.LEFT)[0][2]),
            "Ns": robot.mass,
        }
        learnt = load_nominal(config.baseline or "")
        self.notes = of_another_robot(learnt, robot.mass)
        shipped, own = load_nominal().monitor, learnt.monitor
        # Rows of files of earlier versions do not say how noise varies, and are those of an earlier population.
        table = {**shipped, **{name: row for name, row in own.items() if "by_robot" in row}}
        self.rows = tuple(row_of(name, table) for name in self.names)
        self.nominal = {name: read_row(table[name]) for name in dict.fromkeys(self.rows)}
        rows = [self.nominal[name] for name in self.rows]
        self.units = tuple(row.unit for row in rows)
        self.scale = np.array([scale.get(row.unit, 1.0) for row in rows])
        single, double, robots, self._usual = self.scale * np.transpose(
            [(row.single, row.double, row.robots, row.usual) for row in rows]
        )
        self.by_load, self._usual_load, self._usual_slope = np.transpose(
            [(row.by_load, row.usual_load, row.usual_slope) for row in rows]
        )
        self.noise = np.array([single, single, double, double, double])
        self.drift = np.array([row.drift**2 for row in rows])
        self._variance = robots**2
        self._limits = learnt.limits
        self._rate_variance = (learnt.limits["torque_rate"] * scale["Nm"]) ** 2
        # What an effect describes is watched for changes alone.
        if any(CATALOGUE[effect.name].springs is not Effect.springs for effect in config.effects):
            self._variance[self._spring] = 0.0
        if any(effect.name == "touchdown_impact" for effect in config.effects):
            self._variance[self._landing] = 0.0

    def begin(self) -> None:
        """A phase begins."""
        self.looks = 0
        self._edge_looks = 0  # looks at which the support foot stood on its edge
        self._sums[:] = 0.0
        self._residuals["sum"] = 0.0
        self._impulses = np.zeros((2, 2))  # impulse [Ns] and duration [s], during the impact of a landing and after it

    def look(self, sample: Sample, link: Posture, prediction: Prediction) -> None:
        """Take a sample with both wrenches, the posture and the prediction made of it."""
        left, right, foot = sample.left_wrench, sample.right_wrench, prediction.support.support_foot
        assert left is not None and right is not None
        plan, T_odom_sole = _NAN3, _IDENTITY
        if self._has_motor_plan and sample.reference is not None and sample.motor_q is not None:
            plan = sample.reference.com
            T_odom_sole = sample.reference.sole_pose(foot)
        dt, dt_before, self._last_ns = (sample.stamp_ns - self._last_ns) * 1e-9, self._dt, sample.stamp_ns
        if not self.looks:
            self._first_ns = sample.stamp_ns
        self._dt = dt if 0.0 < dt < _GAP_S else 0.0
        nothing = self._no_joints
        motor, tau = (
            nothing if sample.motor_q is None else sample.motor_q,
            nothing if sample.tau is None else sample.tau,
        )
        self._edge_looks += take_look(
            self._held, link.views, foot == Foot.LEFT, (left, right), (sample.q, motor, tau),
            (prediction.reference_com, plan, T_odom_sole), self._imu(sample, link), sample.stamp_ns, self.looks,
            (self._dt, dt_before),
        )  # fmt: skip
        self.looks += 1

    def feel(self, sample: Sample) -> None:
        """Take the forces of a sample between two looks, with both wrenches."""
        assert sample.left_wrench is not None and sample.right_wrench is not None
        feel(self._held, sample.stamp_ns, sample.left_wrench, sample.right_wrench)

    def _imu(self, sample: Sample, link: Posture) -> tuple[Array, Array]:
        """Orientation (4,) of the IMU against the ground, or NaN, and its rotation (3, 3) in the base frame."""
        if sample.imu is None or sample.imu.orientation is None:
            return _NOT_KNOWN
        name = sample.imu.frame_id
        if name != self._imu_frame[0]:
            self._imu_frame = name, self._robot.sensor_frame(name.lstrip("/"))
        if self._imu_frame[1] is None:
            return _NOT_KNOWN
        return sample.imu.orientation, link.orientation(self._imu_frame[1])

    def land(self, since: float, dt: float, force: float) -> None:
        """Take the vertical force [N] on a foot that landed `since` [s] ago (< LANDED_S), dt [s] after the last one."""
        self._impulses[int(since > IMPACT_S)] += (force * dt, dt) if dt < IMPACT_S else np.nan

    def mean(self, kind: int) -> PhaseMean:
        """Means over the looks since `begin`, in a phase of a kind."""
        n, nl = len(self.names), len(self._joints)
        values = self._mean_residuals()
        # Without torques, the needed ones are no law for any gait; soles rock in each its own way.
        self.torques_known = torques_known = bool(np.isfinite(values[self._torque]).all())
        self.gait_independent = self.of_springs & torques_known
        self.gait_independent[self._force] = self.forces.uses_imu
        self.by_wrenches = self._wrench_laws if torques_known else self._wrench_laws | self.of_springs
        values[~self._shown[kind]] = np.nan
        self._skip_flat_sole_laws(values, kind)
        variance, load = self._variance.copy(), np.zeros(n)
        load[:nl] = self._sums["static_deflection"] / self.looks
        other_load = load - self._usual_load
        values -= self._usual + self._usual_slope * other_load
        variance += (variance > 0.0) * (self.by_load * other_load) ** 2
        if not torques_known:  # the needed torque leaves out the inertia of the legs
            variance[:nl] = 0.0
        displacement = self._sums["posture_last"] - self._sums["posture_first"]
        return PhaseMean(values, variance, load, np.append(self._sums["posture"] / self.looks, displacement))

    @property
    def noise_of_forces(self) -> Array:
        """(2,) nominal standard deviation [N] of `force/x` and `force/y` from phase to phase."""
        return np.asarray(self.noise[0, self._force][:2])

    def wrenches_moved(self, change: Array) -> bool:
        """Whether foot wrenches that change so (12,) [N, Nm], those of the left foot first, stand out of the noise."""
        unloaded = [self._index[f"unloaded/{foot}/{axis}"] for foot in ("left", "right") for axis in AXES]
        return bool((np.abs(change) > _STANDS_OUT * self.noise[0, unloaded]).any())

    def _mean_residuals(self) -> Array:
        """(n,) residuals of all laws, in whatever phase."""
        values = self._residuals["sum"] / self.looks
        change = self._residuals["last"] - self._residuals["first"]
        values[self._spring] += change[self._spring] / (1e-9 * max(1, self._last_ns - self._first_ns))
        start = min(max(self._first_ns, self._last_ns - _MAX_WINDOW_NS), self._last_ns - WINDOW_NS)
        values[self._force] = self.forces.residual(start, self._last_ns)
        values[self._slide] = change[self._slide]
        values[self._landing] = self._landing_impulse()
        work, distance = self._sums["work"], self._sums["distance"]
        values[self._drag] = np.where(distance > _MIN_DISTANCE, work / np.maximum(distance, _MIN_DISTANCE), np.nan)
        values[self._stiffness] = values[self._late] = np.nan
        if self.looks >= _MIN_LOOKS:
            values[self._stiffness], values[self._late] = self._stiffness_residual(), self._delays()
        return values

    def _landing_impulse(self) -> float:
        """Impulse of an impact [Ns] beyond that of a load that only rises; NaN: not known."""
        (impact, impact_s), (load, load_s) = self._impulses
        if not self._impulses[:, 1].all():
            return np.nan
        return float(max(impact - self._limits["load_rises"] * load / load_s * impact_s, 0.0))

    def _mean_sums(self, looks: float) -> Records:
        """`JOINT_SUMS` (nl,) over a number of looks."""
        return (self._sums.view(np.float64) / looks).view(JOINT_SUMS)

    def _stiffness_residual(self) -> Array:
        """(nl,) [rad] component of the spring residual along the deflection, less where that is large or fast."""
        s = self._mean_sums(self.looks)
        variance = np.maximum(s["deflection_2"] - s["deflection"] ** 2, 1e-16)
        rate_variance = np.maximum(s["rate_2"] - s["rate"] ** 2, 0.0)
        large, fast = self._limits["deflection"], self._limits["deflection_rate"]
        growth = 1.0 + variance / large**2 + rate_variance / fast**2
        covariance = s["deflection_residual"] - s["spring_residual"] * s["deflection"]
        return np.asarray(covariance / np.sqrt(variance * growth))

    def _delays(self) -> Array:
        """(2,) [s] delay of the foot sensors against the joint torques, shrunk towards zero at low excitation."""
        s = self._mean_sums(max(1.0, self._sums["delay_looks"][0]))
        covariance = s["residual_rate"] - s["residual"] * s["needed_rate"]
        residual = s["residual_2"] - s["residual"] ** 2
        rate, needed = s["needed_rate_2"] - s["needed_rate"] ** 2, s["needed_2"] - s["needed"] ** 2
        out = np.full(2, np.nan)
        for side, leg in enumerate((self._left, ~self._left)):
            known = leg & np.isfinite(covariance)
            if residual[known].sum() < _RESIDUAL_SHARE * needed[known].sum():
                out[side] = covariance[known].sum() / (rate[known].sum() + self._rate_variance)
        return out

    def _skip_flat_sole_laws(self, values: Array, kind: int) -> None:
        """Set laws of flat soles to NaN while the robot stands on the edges of its soles."""
        if kind not in (AFTER_LEFT, AFTER_RIGHT):
            self.tipping = kind != STANDING and self._edge_looks > 0.5 * self.looks
        if not self.tipping:
            return
        force = values[self._force].copy()
        values[self._flat] = np.nan
        if self.forces.uses_imu:
            values[self._force] = force


def _joint_records(robot: Robot, config: Config) -> Records:
    """`JOINT` (nl,) of both legs, the left one first."""
    left, right = robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]
    joints = np.zeros(len(left) + len(right), dtype=JOINT)
    joints["index"] = np.concatenate([left, right])
    joints["column"] = robot.idx_v[joints["index"]]
    joints["left"] = np.arange(len(joints)) < len(left)
    joints["stiffness"] = config.robot.left.stiffness + config.robot.right.stiffness
    joints["time_constant"] = config.robot.left.damping + config.robot.right.damping
    joints["time_constant"] /= joints["stiffness"]
    return joints
