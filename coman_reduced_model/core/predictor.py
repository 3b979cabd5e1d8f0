# SPDX-License-Identifier: BSD-3-Clause
"""Sample in, Prediction out: the one path that the node, the command line, tuning and diagnosis share."""

from __future__ import annotations

from collections.abc import Sequence
from math import expm1, hypot, inf, isfinite

import numpy as np

from .base.limits import DIVERGED, TOPPLED, is_near
from .base.nominal import load_nominal
from .base.pose import LEVEL
from .base.types import (
    Array,
    DeflectionPrediction,
    Estimate,
    Flags,
    Foot,
    HorizonPrediction,
    Phase,
    Prediction,
    Sample,
    SupportState,
)
from .config.schema import Config
from .effects.catalogue import Effect, build_effects
from .effects.hooks import Now
from .evaluation.baselines import BASELINES, predict_baselines
from .evaluation.blend import MEMORY, NOW, follow
from .evaluation.deflections import DeflectionJudge
from .evaluation.horizons import HELD, REPEATED, STEPPING, HorizonJudge
from .measured.computed_wrenches import ComputedWrenches
from .measured.odometry import FootOdometry
from .measured.sensor_zeros import SensorZeros
from .measured.slope import Slope
from .measured.support import SupportDetector
from .measured.zmp import zmp_from_wrenches
from .model.cartesian import Model
from .model.dynamics import Dynamics
from .model.horizon import drop_impossible
from .model.point_mass import Pendulum, PointMass
from .model.reference import plan_ahead
from .model.trunk.adaptation import Adaptation
from .model.trunk.model import TrunkModel
from .observer.observer import Observer
from .robot.limits import limits_of
from .robot.robot import Robot

_NAN2, _NAN3 = np.full(2, np.nan), np.full(3, np.nan)
_IDENTITY = np.eye(4)
SHORTEST_SWING = 0.1  # [s] a foot that is back on the ground so soon has made no step


class Predictor:
    """Predicts the COM of one robot, sample by sample.

    *Free run*: initialised from the measurement at touchdown (every `prediction.reset_every_steps` steps). Until the
    next restart its inputs are plan or motors, support phase and switching times. *Horizon*: at each sample some tenths
    of a second ahead.

    Attributes:
        DIVERGED: [m] a free run that is this far from the measured COM has diverged.
        TOPPLED: [rad] and so has one whose trunk leans this much more or less than the measured one.
        dynamics: the equation of motion that does both.
        observer: the filter that estimates COM and external force, beside the free run.
        zeros: what the foot sensors read without load, where that is much: it is taken off.
        computed: what computes the wrenches, where no sensor measures them; None: they are measured.
        sample: the last one, without these zeros, and without computed wrenches; None: there was none.
        judge: the errors of the horizons so far.
        adaptation: what it learns of springs, encoders and the trunk's COM, with `prediction.adapt`; else None.

    Example:
        >>> import coman_reduced_model as coman
        >>> with coman.Session(coman.bag_path("test1")) as session:
        ...     predictor = coman.Predictor(session.robot, session.config)
        ...     for sample in session.samples():
        ...         prediction = predictor.update(sample)
        ...         if prediction.support.phase == coman.Phase.LEFT:
        ...             break
        >>> [ahead.h for ahead in prediction.horizons]  # seconds ahead
        [0.1, 0.2, 0.4]
    """

    DIVERGED = DIVERGED
    TOPPLED = TOPPLED

    def __init__(self, robot: Robot, config: Config, effects: Sequence[Effect] | None = None) -> None:
        """Build the model.

        Args:
            robot: as its URDF says; with `effects`, as `build_effects` has loaded it.
            config: of robot and model.
            effects: from `build_effects`; default: those of the configuration.

        Raises:
            ConfigError: an effect does not fit the robot.
        """
        config = config.with_joints_of(robot)
        if effects is None:
            effects, robot = build_effects(config.effects, robot)
        self.robot, self.config = robot, config
        adapts = config.prediction.adapt and config.turning
        self.adaptation = Adaptation(robot, load_nominal(), config.robot.gravity) if adapts else None
        self.effects = effects = [*effects, self.adaptation] if self.adaptation else effects
        self.model = Model(robot, config, effects)
        self.dynamics = self._dynamics()
        self.link = robot.posture()
        weight = config.support.weight or robot.mass * config.robot.gravity
        self.zeros = SensorZeros(weight)
        measured = config.streams.wrench_source == "sensors"
        self.computed = None if measured else ComputedWrenches(robot, config)
        self._limits = limits_of(robot, config.robot.gravity, weight)
        self.sample: Sample | None = None
        self.observer = Observer(robot, config.robot.gravity, load_nominal())
        self.support = SupportDetector(config.support, robot.mass * config.robot.gravity)
        self.odometry = FootOdometry()
        # An effect that says the slope leaves nothing to be found.
        known = any(effect.name == "ground_slope" for effect in effects)
        self.slope = Slope(robot, measured) if config.model.slope == "measured" and not known else None
        chosen = config.prediction
        self.judge = HorizonJudge(tuple(sorted(chosen.horizons)), chosen.reference != "none", chosen.blend)
        self._horizons = np.array(self.judge.horizons)
        legs = np.concatenate((robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]))
        self.deflections = DeflectionJudge(self._horizons, legs)
        self._after = self.deflections.after.tolist()
        self._residuals = np.zeros(10)  # as in `follow`
        self._no_motors = np.full(len(robot.joint_names), np.nan)
        self._frames = ("", config.robot.left.sole_frame, config.robot.right.sole_frame)  # by Foot
        self._sliding = [e for e in effects if type(e).slide is not Effect.slide]
        self._needs_zmp = config.prediction.reference == "none" or len(self._horizons) > 0
        self.reset()

    def _dynamics(self) -> Dynamics:
        if self.config.prediction.reference == "none":
            return Pendulum(self.robot, self.config, self.model)
        kind = TrunkModel if self.model.turning else PointMass
        return kind(self.robot, self.config, self.model)

    def reset(self) -> None:
        """Forget the past: the next sample is the first, odom starts again. Judged errors and zeros are kept."""
        self.support.reset()
        self.odometry.reset()
        if self.computed is not None:
            self.computed.reset()
        if self.slope is not None:
            self.slope.reset()
        for effect in self.effects:
            effect.reset()
        self.judge.restart()
        self.deflections.restart()
        self.dynamics.reset()
        self.observer.reset()
        self.zeros.restart()
        self._stamp_ns = 0
        self._phase = Phase.FLIGHT
        self._foot = Foot.NONE
        self._stance = Foot.NONE  # the foot of the last single support
        self._steps, self._phase_time = 0, 0.0
        self._T_odom_sole = np.full((4, 4), np.nan)

    def reconfigure(self, config: Config) -> None:
        """Take over parameters that may change while it runs: those of the support phase."""
        self.config = config
        weight = self.robot.mass * config.robot.gravity
        self.support.reconfigure(config.support, weight)
        self.zeros.weight = self.support.weight
        if self.computed is not None:
            self.computed.reconfigure(config)

    def update(self, sample: Sample) -> Prediction:
        """Take one sample.

        Args:
            sample: with a stamp later than the last one.

        Returns:
            The prediction at its stamp; NaN with a flag where something is missing, never zeros.
        """
        dt = (sample.stamp_ns - self._stamp_ns) * 1e-9
        if self._stamp_ns and not 0.0 < dt <= self.config.streams.restart_gap:
            self.reset()
        for effect in self.effects:
            effect.correct(sample)
        self.link.update(sample.q, sample.qd)
        sample, flags = self._with_wrenches(sample)
        left, right = sample.left_wrench, sample.right_wrench
        support = self.support.update(
            sample.stamp_ns, None if left is None else float(left[2]), None if right is None else float(right[2])
        )
        for effect in self.effects:
            effect.begin(sample.stamp_ns, support)
        foot, R, p = support.support_foot, self.link.R, self.link.p
        T_odom_sole = self.odometry.update(foot, R[Foot.LEFT], p[Foot.LEFT], R[Foot.RIGHT], p[Foot.RIGHT])
        for effect in self._sliding:
            T_odom_sole = self.odometry.slide(effect.slide())
        if foot == Foot.NONE:
            return self._finish(sample, support, T_odom_sole, flags | Flags.NO_SUPPORT | Flags.NOT_INITIALISED)
        com, com_vel = self.link.com_in_sole(foot)
        possible = self._possible(com, com_vel)
        if support.phase == Phase.FLIGHT or not possible:
            self.dynamics.stop()
            self.observer.reset()
            self.deflections.restart()
            flags |= Flags.NOT_INITIALISED | (Flags.NO_SUPPORT if possible else Flags.REJECTED_STATE)
            measured = (com, com_vel) if possible else (_NAN3, _NAN3)
            return self._finish(sample, support, T_odom_sole, flags, *measured)
        down = self._down(sample, foot, T_odom_sole)
        zmp = self._zmp(sample, foot, T_odom_sole, down, com[2]) if self._needs_zmp else None
        since = support.foot_time if support.phase == self._phase else support.phase_time
        began_ns = sample.stamp_ns - round(since * 1e9)
        now = Now(
            sample, support, dt, self.link, com, com_vel, zmp, T_odom_sole, began_ns, self._stance, down,
            self.link.tilt if self.model.turning else _NAN2, self.support.lifting, self._touchdown(support),
        )  # fmt: skip
        dynamics, ready = self.dynamics, self.dynamics.prepare(now)
        horizons: list[HorizonPrediction] = []
        if ready:
            found = [self._free_run(now), dynamics.flags]
        else:
            dynamics.stop()
            found = [Flags.NO_REFERENCE | Flags.NOT_INITIALISED]
        estimate = self._estimate(now)
        found.append(self.observer.flags)
        if len(self._horizons):
            horizons, ahead_flags = self._ahead(now, ready, estimate)
            found.append(ahead_flags)
        if self.slope is not None and self.slope.doubtful:
            found.append(Flags.UNKNOWN_GROUND)
        for flag in found:
            if flag:  # joining flags takes longer than this
                flags = flags | flag if flags else flag
        prediction = self._finish(
            sample, support, T_odom_sole, flags, com, com_vel,
            dynamics.reference, dynamics.reference_vel, dynamics.state, horizons,
        )  # fmt: skip
        if ready and self.model.turning:
            prediction.measured_tilt, prediction.predicted_tilt = now.tilt, dynamics.tilt
        fresh = 0.0 if flags and flags.diverged else -expm1(-min(max(dt, 0.0), NOW) / MEMORY)
        prediction.estimate, prediction.base_in_sole = estimate, self.link.base_in_sole
        prediction.predicted_covariance = follow(self._residuals, com, prediction.predicted_com, fresh)
        prediction.deflections = self._deflections(now, ready)
        prediction.repeating, prediction.stepping = ready and dynamics.repeating, ready and dynamics.stepping
        return prediction

    def _with_wrenches(self, sample: Sample) -> tuple[Sample, Flags]:
        """A sample with the wrenches by which phases are found, `link` having its joints."""
        if self.computed is None:
            sample, flags = self.zeros.corrected(sample, self.link), Flags.OK
            self.sample = sample
        else:
            self.sample, flags = sample, Flags.COMPUTED_WRENCH
            turn = self._T_odom_sole[:3, :3].T
            down = LEVEL if self.slope is None or self._foot == Foot.NONE else turn @ self.slope.down
            sample = self.computed.filled(sample, self.link, self._foot, down)
        stale = sample.left_wrench is None or sample.right_wrench is None
        return sample, flags | Flags.STALE_WRENCH if stale else flags

    def _estimate(self, now: Now) -> Estimate:
        """By the observer; by computed wrenches, which hold the balance by construction, only the trunk's rotation."""
        return self.observer.update(now, self.computed is None)

    def _possible(self, com: Array, com_vel: Array) -> bool:
        """Whether the COM is in reach of the support sole, and no faster past it than any runner's."""
        return hypot(*com.tolist()) <= self._limits.reach and hypot(*com_vel.tolist()) <= self._limits.com_speed

    def _ahead(self, now: Now, ready: bool, estimate: Estimate) -> tuple[list[HorizonPrediction], Flags]:
        """What is published for the horizons; nothing if the model has no input."""
        dynamics, gravity, zmp, com, com_vel = self.dynamics, self.model.gravity, now.zmp, now.com, now.com_vel
        ahead, flags = np.empty((1 + len(BASELINES), len(self._horizons), 3)), Flags.OK
        if isfinite(estimate.com[0]) and not self.observer.flags:
            com, com_vel = estimate.com, estimate.com_vel
        plan = plan_ahead(now.sample, now.foot)
        ahead[0] = dynamics.ahead(now, com, com_vel, plan, self._horizons) if ready else np.nan
        predict_baselines(
            ahead[1:], com, com_vel, _NAN3 if zmp is None else zmp, gravity, self._horizons,
            dynamics.reference, dynamics.reference_vel, plan,
        )  # fmt: skip
        # The model's, and what a ZMP or a plan that is none makes of the simpler ones.
        if drop_impossible(ahead, now.com, now.com_vel, self._horizons, gravity, self.DIVERGED) and ready:
            flags = Flags.REJECTED_STATE
        kind = HELD if not ready else REPEATED if dynamics.repeating else STEPPING if dynamics.stepping else HELD
        lag, spread = dynamics.lag_ns, (estimate.covariance, self.observer.constants)
        published = self.judge.update(
            now.sample.stamp_ns, now.T_odom_sole, now.com, dynamics.reference, ahead, kind, lag, spread, ready
        )
        if not ready:
            return [], flags
        if self.judge.simpler_is_better:
            flags = flags | Flags.SIMPLER_AHEAD if flags else Flags.SIMPLER_AHEAD
        made = zip(self.judge.horizons, published[:, 0], published[:, 1:4], published[:, 4], strict=True)
        return [HorizonPrediction(*each) for each in made], flags

    def _deflections(self, now: Now, ready: bool) -> list[DeflectionPrediction]:
        """Of COM and joints, now and at the horizons; none, if the model has no input."""
        sample, dynamics = now.sample, self.dynamics
        if not ready:
            self.deflections.restart()
            return []
        motors = self._no_motors if sample.motor_q is None else sample.motor_q
        values, known = dynamics.deflections(now, len(self._horizons)), dynamics.repeating or dynamics.stepping
        sigma = self.deflections.update(sample.stamp_ns, now.com, dynamics.reference, sample.q, motors, values, known)
        return [
            DeflectionPrediction(*each)
            for each in zip(self._after, values[:, :3], sigma[:, :3], values[:, 3:], sigma[:, 3:], strict=True)
        ]

    def _free_run(self, now: Now) -> Flags:
        """Bring the free run to this sample, or begin it again: at a touchdown, and where it has diverged."""
        dynamics, support = self.dynamics, now.support
        if dynamics.state is not None and (support.support_foot != self._foot or support.phase != self._phase):
            dynamics.switch(now, self._T_odom_sole)
        event = Flags.RESET
        if dynamics.state is not None and not now.restarts:
            dynamics.advance(now)
            if self._near(now):
                return Flags.OK
            event |= Flags.REJECTED_STATE
        dynamics.restart(now)
        if not self._near(now):  # what it began from, a filter of the measurement, has diverged as well
            event |= Flags.REJECTED_STATE
            dynamics.reset()
            dynamics.prepare(now)
            dynamics.restart(now)
        return event

    def _near(self, now: Now) -> bool:
        """Whether the free run is where the robot can be by the measurement."""
        assert self.dynamics.state is not None
        limits = self.DIVERGED, self.TOPPLED if self.model.turning else inf
        near: bool = is_near(self.dynamics.state, self.dynamics.tilt, now.com, now.tilt, limits)
        return near

    def _finish(
        self,
        sample: Sample,
        support: SupportState,
        T_odom_sole: Array,
        flags: Flags,
        com: Array = _NAN3,
        com_vel: Array = _NAN3,
        reference: Array = _NAN3,
        reference_vel: Array = _NAN3,
        state: Array | None = None,
        horizons: list[HorizonPrediction] | None = None,
    ) -> Prediction:
        self._stamp_ns, self._phase_time = sample.stamp_ns, support.phase_time
        self._phase, self._foot, self._T_odom_sole = support.phase, support.support_foot, T_odom_sole
        if support.phase in (Phase.LEFT, Phase.RIGHT):
            self._stance = support.support_foot
        return Prediction(
            sample.stamp_ns,
            self._frames[support.support_foot],
            support,
            com,
            com_vel,
            reference,
            reference_vel,
            _NAN3 if state is None else state[:3].copy(),
            _NAN3 if state is None else state[3:].copy(),
            T_odom_sole,
            horizons or [],
            flags,
        )

    def _touchdown(self, support: SupportState) -> bool:
        """Whether a step ends at this sample: the swing foot lands, or stance changes without double support."""
        before, now = self._phase, support.phase
        if before == now or before not in (Phase.LEFT, Phase.RIGHT):
            return False
        if now == Phase.DOUBLE and self._phase_time < SHORTEST_SWING:  # it still swings from the lift-off
            return False
        self._steps += 1
        every = self.config.prediction.reset_every_steps
        return every > 0 and self._steps % every == 0

    def _down(self, sample: Sample, foot: Foot, T_odom_sole: Array) -> Array:
        """(3,) direction of gravity in odom."""
        if self.slope is None:
            return LEVEL
        self.slope.update(sample, self.link, foot, T_odom_sole)
        return self.slope.down

    def _zmp(self, sample: Sample, foot: Foot, T_odom_sole: Array, down: Array, height: float) -> Array | None:
        """The ZMP (3,) [m] in the support sole; on a slope, where it would be on level ground for the same motion.

        Args:
            sample: with wrenches.
            foot: the support foot.
            T_odom_sole: (4, 4) pose of its sole.
            down: (3,) direction of gravity in odom.
            height: of the COM [m].
        """
        other = self.link.sole_pose(foot, foot.other)
        poses = (_IDENTITY, other) if foot == Foot.LEFT else (other, _IDENTITY)
        zmp = zmp_from_wrenches(sample.left_wrench, sample.right_wrench, *poses)
        if zmp is not None and down is not LEVEL:
            x, y, z = T_odom_sole[:3, :3].T @ down
            zmp[:2] += height * np.array((x, y)) / z
        return zmp
