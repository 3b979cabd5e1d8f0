# SPDX-License-Identifier: BSD-3-Clause
"""Sample in, Prediction out: the one path that the node, the command line, tuning and diagnosis share."""

from __future__ import annotations

from collections import deque

import numpy as np

from .config import Config
from .horizon import HorizonJudge, predict_baselines, predict_horizons
from .integrator import Moment, going_on, step
from .model import Model, Terms
from .odometry import FootOdometry, pose
from .reference import look_ahead, motor_com, plan_ahead, planned_com
from .robot import Robot
from .support import SupportDetector
from .trunk_model import TrunkModel, tilt
from .types import Array, Flags, Foot, HorizonPrediction, Phase, Prediction, Sample, SupportState
from .zmp import zmp_from_wrenches

_NAN3 = np.full(3, np.nan)
_ZERO3 = np.zeros(3)
_IDENTITY = np.eye(4)
_PAST = 100  # samples: the longest that a change of phase may be known late, 0.1 s at 1 kHz
_LOST = 0.5  # [m] a free run this far from the measurement has diverged


class Predictor:
    """Predicts the COM of one robot, sample by sample.

    *Free run*: initialised from the measurement at touchdown (every `prediction.reset_every_steps` steps) and then
    driven by reference and phase alone. *Horizon*: from each measured state some tenths of a second ahead.
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        self.robot = robot
        self.config = config
        self.model = Model(robot, config)
        self.trunk = TrunkModel(robot, self.model) if self.model.turning else None
        self.link = robot.posture()
        self.motor = robot.posture()
        self.support = SupportDetector(config.support, robot.mass * config.robot.gravity)
        self.odometry = FootOdometry()
        self.judge = HorizonJudge(tuple(sorted(config.prediction.horizons)), config.prediction.reference != "none")
        self._horizons = np.array(self.judge.horizons)
        self._nothing = np.full((len(self._horizons), 3), np.nan)
        self._frames = ("", config.robot.left.sole_frame, config.robot.right.sole_frame)  # by Foot
        self._following = [axis for axis in range(3) if axis not in self.model.axes]
        self._needs_zmp = config.prediction.reference == "none" or len(self._horizons) > 0
        # (stamp, state, terms, moment) of the free run since the phase began.
        self._past: deque[tuple[int, Array, Terms, Moment]] = deque(maxlen=_PAST)
        self._both = config.model.double_support == "both_legs"
        self.reset()

    def reset(self) -> None:
        """Forget the past: as if the next sample were the first (odom starts anew). The judged errors are kept."""
        self.support.reset()
        self.odometry.reset()
        self.judge.restart()
        if self.trunk is not None:
            self.trunk.reset()
        self._stamp_ns = 0
        self._phase = Phase.FLIGHT
        self._foot = Foot.NONE
        self._stance = Foot.NONE  # the foot of the last single support
        self._steps = 0
        self._state: Array | None = None  # (6,) free-run COM position and velocity in the support sole
        self._state_ns = 0  # stamp of that state
        self._moment: Moment | None = None  # what drove it at the last sample, if in the same sole frame and phase
        self._past.clear()
        self._T_odom_sole = np.full((4, 4), np.nan)

    def update(self, sample: Sample) -> Prediction:
        """Take one sample.

        Args:
            sample: with a stamp later than the last one.

        Returns:
            The prediction at its stamp; NaN with a flag where something is missing, never zeros.
        """
        for effect in self.model.effects:
            effect.correct(sample)
        dt = (sample.stamp_ns - self._stamp_ns) * 1e-9
        if self._stamp_ns and not 0.0 < dt <= self.config.streams.restart_gap:
            self.reset()
        left, right = sample.left_wrench, sample.right_wrench
        flags = Flags.STALE_WRENCH if left is None or right is None else Flags.OK
        support = self.support.update(
            sample.stamp_ns, None if left is None else float(left[2]), None if right is None else float(right[2])
        )
        self.link.update(sample.q, sample.qd)
        foot, R, p = support.support_foot, self.link.R, self.link.p
        T_odom_sole = self.odometry.update(foot, R[Foot.LEFT], p[Foot.LEFT], R[Foot.RIGHT], p[Foot.RIGHT])
        if foot == Foot.NONE:
            flags |= Flags.NO_SUPPORT | Flags.NOT_INITIALISED
            return self._finish(sample, support, T_odom_sole, flags)
        com, com_vel = self.link.com_in_sole(foot)
        if support.phase == Phase.FLIGHT:
            self._state = None
            flags |= Flags.NO_SUPPORT | Flags.NOT_INITIALISED
            return self._finish(sample, support, T_odom_sole, flags, com, com_vel)

        tilts: tuple[Array, Array] | None = None
        zmp = self._zmp(sample, foot) if self._needs_zmp else None
        terms, reference, reference_vel = self._terms(sample, support, com, zmp)
        if self._state is not None and (foot != self._foot or support.phase != self._phase):
            self._switch(sample.stamp_ns, support, T_odom_sole)
        if terms is None:
            self._state = self._moment = None
            if self.trunk is not None:
                self.trunk.reset()
            flags |= Flags.NO_REFERENCE | Flags.NOT_INITIALISED
        elif self.trunk is not None:
            event, predicted_tilt = self._turn(self.trunk, sample, support, dt, com, reference, reference_vel)
            tilts = tilt(self.link.R[foot]), predicted_tilt
            flags |= event
        else:
            pull = (reference, reference_vel) if zmp is None or reference is not _NAN3 else (zmp, _ZERO3)
            event = self._free_run(sample.stamp_ns, terms, self._touchdown(support), com, com_vel, pull)
            if terms.near_singular:
                flags |= Flags.NEAR_SINGULAR
            if event:
                flags |= event
        horizons = self._predict_horizons(
            sample, support, T_odom_sole, terms, com, com_vel, reference, reference_vel, zmp
        )
        prediction = self._finish(
            sample, support, T_odom_sole, flags, com, com_vel, reference, reference_vel, self._state, horizons
        )
        if tilts is not None:
            prediction.measured_tilt, prediction.predicted_tilt = tilts
        return prediction

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
        horizons: Array | None = None,
    ) -> Prediction:
        self._stamp_ns = sample.stamp_ns
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
            [] if horizons is None else list(map(HorizonPrediction, self.judge.horizons, horizons)),
            flags,
        )

    def _touchdown(self, support: SupportState) -> bool:
        """Whether a step ends at this sample: the swing foot lands, or stance changes without double support."""
        before, now = self._phase, support.phase
        if before == now or before not in (Phase.LEFT, Phase.RIGHT):
            return False
        self._steps += 1
        every = self.config.prediction.reset_every_steps
        return every > 0 and self._steps % every == 0

    def _zmp(self, sample: Sample, foot: Foot) -> Array | None:
        other = pose(*self.link.sole_to_sole(foot, foot.other))
        poses = (_IDENTITY, other) if foot == Foot.LEFT else (other, _IDENTITY)
        return zmp_from_wrenches(sample.left_wrench, sample.right_wrench, *poses)

    def _terms(
        self, sample: Sample, support: SupportState, com: Array, zmp: Array | None
    ) -> tuple[Terms | None, Array, Array]:
        """Terms, reference COM and velocity in the support sole; None and NaN if the reference is missing."""
        foot = support.support_foot
        source = self.config.prediction.reference
        if source == "none":
            return (None if zmp is None else self.model.pendulum(com[2], zmp)), _NAN3, _NAN3
        if source == "motor":
            if sample.motor_q is None or sample.motor_qd is None:
                return None, _NAN3, _NAN3
            self.motor.update(sample.motor_q, sample.motor_qd)
            references = {foot: motor_com(self.motor, foot)}
            if self._both and support.phase == Phase.DOUBLE:
                R, p = self.link.sole_to_sole(foot, foot.other)
                p_r, v_r = motor_com(self.motor, foot.other)
                references[foot.other] = (R @ p_r + p, R @ v_r)
            posture = self.motor
        else:
            if sample.reference is None:
                return None, _NAN3, _NAN3
            references = {foot: planned_com(sample.reference, foot)}
            references[foot.other] = references[foot]
            posture = self.link
        landed = self._stance not in (Foot.NONE, foot)
        return (self.model.terms(posture, support, references, landed), *references[foot])

    def _switch(self, stamp_ns: int, support: SupportState, T_odom_sole: Array) -> None:
        """Take the free run to where the phase began, by the terms until then, and tell it in the new support sole.

        A phase begins between two samples and is known only when its dwell has passed; counted from the sample that
        reports it, the trajectory would depend on the sample rate.
        """
        late = support.foot_time if support.phase == self._phase else support.phase_time
        began_ns = stamp_ns - round(late * 1e9)
        while len(self._past) > 1 and self._past[-1][0] > began_ns:
            self._past.pop()
        if self._past:
            self._state_ns, state, terms, start = self._past[-1]
            dt = max(0, began_ns - self._state_ns) * 1e-9
            self._state_ns = max(self._state_ns, began_ns)
            end = going_on(start, dt)
            self._state = step(state, terms.M, terms.axes, start, end, dt)
            self._follow(self._state, end[3], end[4])
        old, new = self._T_odom_sole, T_odom_sole
        R = new[:3, :3].T @ old[:3, :3]
        assert self._state is not None
        # Continuous in odom.
        self._state = np.concatenate(
            (R @ self._state[:3] + new[:3, :3].T @ (old[:3, 3] - new[:3, 3]), R @ self._state[3:])
        )
        self._moment = None
        self._past.clear()

    def _follow(self, state: Array, reference: Array, reference_vel: Array) -> None:
        """Let what is not integrated follow the reference, in place; without one it stays."""
        if reference_vel is not _ZERO3:
            for axis in self._following:
                state[axis], state[3 + axis] = reference[axis], reference_vel[axis]

    def _free_run(
        self, stamp_ns: int, terms: Terms, restart: bool, com: Array, com_vel: Array, pull: tuple[Array, Array]
    ) -> Flags:
        """Advance the free run to this sample, or start it from the measurement.

        `pull` is what K and D pull towards: reference COM and velocity, or the ZMP of the pendulum.
        """
        event, state = Flags.RESET, _NAN3
        moment = (terms.K, terms.D, terms.force, *pull)
        if self._state is not None and not restart:
            dt = (stamp_ns - self._state_ns) * 1e-9
            start = self._moment or going_on(moment, -dt)
            followed = step(self._state, terms.M, terms.axes, start, moment, dt)
            self._follow(followed, *pull)
            error = followed[:3] - com
            if error @ error < _LOST * _LOST:
                event, state = Flags.OK, followed
            else:
                event = Flags.RESET | Flags.REJECTED_STATE
        if event:
            state = np.concatenate((com, com_vel))
            self._past.clear()
        self._state, self._state_ns, self._moment = state, stamp_ns, moment
        self._past.append((stamp_ns, state, terms, moment))
        return event

    def _turn(
        self,
        trunk: TrunkModel,
        sample: Sample,
        support: SupportState,
        dt: float,
        com: Array,
        reference: Array,
        reference_vel: Array,
    ) -> tuple[Flags, Array]:
        """The free run with the turning trunk; its roll and pitch (2,) [rad]."""
        trunk.update(sample, support, self.link, self.motor, dt)
        event = Flags.OK
        if self._touchdown(support) or not trunk.running:
            trunk.restart()
            event = Flags.RESET
        state = trunk.predicted(sample)
        error = state.com - com
        if not error @ error < _LOST * _LOST:
            trunk.restart()
            event, state = Flags.RESET | Flags.REJECTED_STATE, trunk.predicted(sample)
        self._state = np.concatenate((state.com, state.com_vel))
        for axis in self._following:
            self._state[axis], self._state[3 + axis] = reference[axis], reference_vel[axis]
        return event, state.tilt

    def _predict_horizons(
        self,
        sample: Sample,
        support: SupportState,
        T_odom_sole: Array,
        terms: Terms | None,
        com: Array,
        com_vel: Array,
        reference: Array,
        reference_vel: Array,
        zmp: Array | None,
    ) -> Array | None:
        """COM (k, 3) at each horizon ahead of the measured state, in the support sole; None without terms.

        Hands it to the judge together with the baselines.
        """
        horizons = None
        if not len(self._horizons):
            return horizons
        if terms is not None:
            plan = plan_ahead(sample, support.support_foot)
            horizons = predict_horizons(
                com, com_vel, self._horizons, terms.M, terms.K, terms.D, terms.axes, terms.force,
                reference, reference_vel, *plan,
            )  # fmt: skip
            if self.trunk is not None and self.trunk.running:
                plans = np.array([look_ahead(*plan, reference_vel, h)[0] for h in self.judge.horizons])
                ahead = com + plans + self.trunk.ahead(self._horizons)
                horizons[:, self.model.axes] = ahead[:, self.model.axes]
        baselines = predict_baselines(com, com_vel, _NAN3 if zmp is None else zmp, self.model.gravity, self._horizons)
        model = self._nothing if horizons is None else horizons
        self.judge.update(sample.stamp_ns, T_odom_sole, com, reference, model, *baselines)
        return horizons
