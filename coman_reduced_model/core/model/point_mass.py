# SPDX-License-Identifier: BSD-3-Clause
"""The free run and the predictions ahead of the paper's point mass, and of the pendulum that needs no reference."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..base.types import Array, Flags, Foot, Phase
from ..config.schema import Config
from ..effects.catalogue import Effect
from ..effects.hooks import Now, Push
from ..robot.robot import Posture, Robot
from .cartesian import Model, Terms
from .dynamics import Dynamics
from .horizon import predict_horizons
from .integrator import Forcing, extrapolate, free_run_step, free_run_switch
from .reference import Plan, motor_com, planned_com
from .zmp_filter import ZmpFilter

References = dict[Foot, tuple[Array, Array]]  # COM and velocity (3,), (3,) by leg, in the support sole
_NAN3 = np.full(3, np.nan)
_PAST = 100  # samples: the longest that a change of phase may be known late, 0.1 s at 1 kHz


class PointMass(Dynamics):
    """m p'' = K (p_r - p) + D (p_r' - p') + m g, with the motor side or the plan as p_r.

    Between two restarts the free run takes of the measurement only the transform from foot to foot when the support
    foot changes, and the load shares with `shares: measured`. Without motor states (`reference: topic`)
    the measured joints stand in for the motors where the Jacobian and the speed of the joints are taken.
    """

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        super().__init__()
        self.model = model
        self.motor = robot.posture()
        self._legs = robot.legs
        self._source = config.prediction.reference
        self._both = config.model.double_support == "both_legs"
        self._pushing = [e for e in model.effects if type(e).push is not Effect.push]
        self._terms: Terms | None = None
        self._references: References = {}
        # Support foot of the last sample, and by leg how far COM and velocity were from the reference, in its axes:
        self._offset: tuple[Foot, References] | None = None
        self._pull = (_NAN3, _NAN3)  # what K and D pull towards
        self._following = np.array([axis for axis in range(3) if axis not in model.axes], dtype=np.int64)
        self._state_ns = 0  # stamp of the state
        self._forcing: Forcing | None = None  # at the last sample, if in the same sole frame and phase
        # (stamp, state, terms, forcing) of the free run since the phase began.
        self._past: deque[tuple[int, Array, Terms, Forcing]] = deque(maxlen=_PAST)

    def prepare(self, now: Now) -> bool:
        sample, support, foot = now.sample, now.support, now.foot
        self.reference = self.reference_vel = _NAN3
        posture = now.link  # stands in for motors that have no encoders
        if sample.motor_q is not None and sample.motor_qd is not None:
            posture = self.motor
            posture.update(sample.motor_q, sample.motor_qd)
        if self._source == "motor":
            if posture is now.link:
                return False
            references = {foot: motor_com(posture, foot)}
            if self._both and support.phase == Phase.DOUBLE:
                references[foot.other] = references[foot]  # by the motors, both soles see the COM at one place
        else:
            if sample.reference is None:
                return False
            references = dict.fromkeys((foot, foot.other), planned_com(sample.reference, foot))
        deflections = {} if self.model.springs.nominal else self._deflections(now, posture, references)
        self._terms = terms = self.model.terms(posture, support, references, now.landed, deflections)
        self._push(terms, now, posture)
        if (aslant := now.aslant) is not None:
            terms.force += self.model.mass * self.model.gravity * aslant
        self._references = references
        self._pull = self.reference, self.reference_vel = references[foot]
        self.flags = Flags.NEAR_SINGULAR if terms.near_singular else Flags.OK
        return True

    def _deflections(
        self, now: Now, posture: Posture, references: References
    ) -> dict[Foot, tuple[Array | None, Array | None, Array]]:
        """Of the joints of each leg in the free run, their rates, and those of the motors; None: no free run yet.

        The joints share the deflection that the COM had at the last sample as springs of nominal stiffness do.
        """
        found: dict[Foot, tuple[Array | None, Array | None, Array]] = {}
        for side in references:
            leg = self._legs[side]
            rates = now.sample.qd[leg] if now.sample.motor_qd is None else now.sample.motor_qd[leg]
            found[side] = (None, None, rates)
            if self._offset is not None:
                foot, offsets = self._offset
                by_com = self.model.joints_by_com(posture, side) @ posture.sole_to_sole(side, foot)[0]
                off, slower = offsets.get(side, offsets[foot])
                found[side] = (by_com @ off, by_com @ slower, rates)
        return found

    def _push(self, terms: Terms, now: Now, posture: Posture) -> None:
        if self._pushing:
            push = Push(posture, now.T_odom_sole[:3, :3])
            for effect in self._pushing:
                effect.push(push, now)
            terms.force += push.force + posture.R[now.foot].T @ push.trunk[:3]

    def stop(self) -> None:
        self.state = self._forcing = self._offset = None
        self._past.clear()

    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """Take the free run to where the phase began, by the terms until then, and express it in the new sole.

        A phase begins between two samples and is known only when its dwell has passed; counted from the sample that
        reports it, the trajectory would depend on the sample rate.
        """
        assert self.state is not None
        began_ns = now.began_ns
        while len(self._past) > 1 and self._past[-1][0] > began_ns:
            self._past.pop()
        new = now.T_odom_sole
        R = new[:3, :3].T @ T_odom_sole[:3, :3]
        moved = new[:3, :3].T @ (T_odom_sole[:3, 3] - new[:3, 3])
        if self._past:
            stamp_ns, state, terms, forcing = self._past[-1]
            dt = max(0, began_ns - stamp_ns) * 1e-9
            self._state_ns = max(stamp_ns, began_ns)
            self.state = free_run_switch(state, terms.M, terms.axes, self._following, forcing, dt, R, moved)
        else:
            self.state = np.concatenate((R @ self.state[:3] + moved, R @ self.state[3:]))
        self._forcing = None
        self._past.clear()

    def restart(self, now: Now) -> None:
        self._past.clear()
        self._take(now, np.concatenate((now.com, now.com_vel)), self._current_forcing())

    def advance(self, now: Now) -> None:
        terms, forcing = self._terms, self._current_forcing()
        assert terms is not None and self.state is not None
        dt = (now.sample.stamp_ns - self._state_ns) * 1e-9
        start = self._forcing or extrapolate(forcing, -dt)
        state = free_run_step(self.state, terms.M, terms.axes, self._following, start, forcing, dt)
        self._take(now, state, forcing)

    def ahead(self, now: Now, com: Array, com_vel: Array, plan: Plan, horizons: Array) -> Array:
        terms = self._terms
        assert terms is not None
        return predict_horizons(
            com, com_vel, horizons, terms.M, terms.K, terms.D, terms.axes, terms.force,
            self.reference, self.reference_vel, *plan,
        )  # fmt: skip

    def _current_forcing(self) -> Forcing:
        assert self._terms is not None
        return Forcing(self._terms.K, self._terms.D, self._terms.force, *self._pull)

    def _take(self, now: Now, state: Array, forcing: Forcing) -> None:
        assert self._terms is not None
        self.state, self._state_ns, self._forcing = state, now.sample.stamp_ns, forcing
        if not self.model.springs.nominal:
            offsets = {side: (state[:3] - p_r, state[3:] - v_r) for side, (p_r, v_r) in self._references.items()}
            self._offset = now.foot, offsets
        self._past.append((now.sample.stamp_ns, state, self._terms, forcing))


class Pendulum(PointMass):
    """p'' = (g / z) (p - p_zmp) with the measured ZMP, for a robot without reference; the height stays.

    The free run takes the ZMP as it is measured; predictions ahead start from the state of a filter of its own.
    """

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        super().__init__(robot, config, model)
        self._filter = ZmpFilter()
        self._following = np.array([], dtype=np.int64)  # the height stays

    def reset(self) -> None:
        super().reset()
        self._filter.reset()

    def prepare(self, now: Now) -> bool:
        if now.zmp is None:
            return False
        self._terms = self.model.pendulum(now.com[2], now.zmp)
        self._push(self._terms, now, now.link)
        self._pull = now.zmp, np.zeros(3)
        self._filter.update(now.sample.stamp_ns, now.T_odom_sole, now.com, now.zmp, self.model.gravity)
        return True

    def ahead(self, now: Now, com: Array, com_vel: Array, plan: Plan, horizons: Array) -> Array:
        return self._filter.ahead(com, horizons, self.model.gravity)
