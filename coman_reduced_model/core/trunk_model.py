# SPDX-License-Identifier: BSD-3-Clause
"""The trunk on its legs with all six freedoms: what the point mass of the paper leaves out (effect `trunk_rotation`).

Coordinates are the deflections d of the support leg's joints (link minus motor), which for six joints are the pose of
the trunk. About the reference motion theta(t) of the motors they obey

    M d'' + D_q d' + (K_q + m g H) d = -tau(theta, theta', theta'')

with M the inertia of all that the leg carries, H the Hessian of the COM height (`gravity_stiffness`), and tau the
joint torques of the reference motion: gravity, the acceleration of the COM and, with `swing_momentum`, everything
else that inverse dynamics knows. In double support the other leg acts in parallel: its deflection follows from the
pose of the trunk and from where its sole stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .compiled import apply, inverse, mul
from .config import Config
from .dynamics import Dynamics, Now, Push
from .effects import Effect
from .integrator import advance, transition
from .model import Model
from .odometry import flat
from .reference import look_ahead, motor_com, plan_ahead
from .robot import Robot
from .springs import LegSprings
from .trunk import carried, coast, geometry
from .types import Array, Foot, Phase

# Bandwidth of the filter that follows the measured deflections. Below it the encoders are believed (0.4 mrad of
# quantisation noise), above it the model: the velocity it gives has no lag, other than a slope over past samples.
_FILTER = 20.0  # [rad/s]
_NO_POSE = (np.eye(3), np.zeros(3))


@dataclass(slots=True)
class LinearTerms:
    """M d'' + D d' + K d = u for the joints of the support leg: (n, n), (n, n), (n, n), (n,)."""

    M_inv: Array
    D: Array
    K: Array
    u: Array
    u_still: Array  # (n,) u if the reference stood still: what it does in this instant is not what it goes on to do
    J: Array  # (6, n) COM velocity and angular velocity of the trunk in sole axes, by those joints
    B: Array  # (k, n) other leg's joints by those of the support leg, in double support
    d_other: Array  # (k,) deflection of the other leg for d = 0
    d_other_rate: Array


class TrunkModel(Dynamics):
    """Free run and filtered measurement of the trunk's six freedoms."""

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        """Share the effects and constants of the point-mass model."""
        super().__init__()
        self.robot = robot
        self.model = model
        self.motor = robot.posture()
        self._full_share = next(e.values["full_share"] for e in model.effects if e.name == "trunk_rotation")
        self._swing = any(e.name == "swing_momentum" for e in model.effects)
        self._pushing = [e for e in model.effects if type(e).push is not Effect.push]
        self._following = [axis for axis in range(3) if axis not in model.axes]
        self._pin = robot.model.copy()
        self._pin.gravity.linear = np.zeros(3)
        self._data = robot.model.createData()
        self._q = pin.neutral(robot.model)
        self._v = np.zeros(robot.model.nv)
        self._a = np.zeros(robot.model.nv)
        self._no_torque = np.zeros(robot.model.nv)
        self._predicted = robot.posture()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.state = None
        self._foot = Foot.NONE
        self._free: Array | None = None  # (2n,) free run: deflections and their rates
        self._filtered: Array | None = None  # (2n,) the measurement
        self._u: Array | None = None
        self._terms: LinearTerms | None = None
        self._rates: tuple[dict[Foot, Array], Array] | None = None  # twists by either leg and motor rates before
        self._com_vel = (Foot.NONE, np.zeros(3))
        self._transition = (np.empty((0, 0)),) * 3  # of the step that ended at the last sample
        self._before = np.empty(0)  # u at its beginning

    stop = reset

    def prepare(self, now: Now) -> bool:
        """Assemble the equation of motion and bring the filter of the measurement to this sample."""
        sample = now.sample
        if sample.motor_q is None or sample.motor_qd is None:
            self.reference = self.reference_vel = np.full(3, np.nan)
            return False
        self.motor.update(sample.motor_q, sample.motor_qd)
        self.reference, self.reference_vel = motor_com(self.motor, now.foot)
        if now.foot != self._foot:
            self._change_leg(now.foot)
        leg = self.robot.legs[now.foot]
        n, measured = len(leg), sample.q[leg] - sample.motor_q[leg]
        first = self._filtered is None
        if self._filtered is None:
            self._filtered = np.concatenate((measured, np.zeros(n)))
        terms = self._assemble(now)
        if not first:
            self._before = terms.u if self._u is None else self._u
            self._transition = transition(terms.M_inv, terms.K, terms.D, now.dt)
            filtered = advance(self._filtered, *self._transition, self._before, terms.u)
            error = measured - filtered[:n]
            filtered[:n] += (1.0 - np.exp(-2.0 * _FILTER * now.dt)) * error
            filtered[n:] += _FILTER**2 * now.dt * np.exp(-_FILTER * now.dt) * error
            self._filtered = filtered
        self._u, self._terms = terms.u, terms
        return True

    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """`_change_leg` has told the free run by the new leg, if the two were tied."""
        if self._free is None:
            self.state = None

    def restart(self, now: Now) -> None:
        """From the filtered measurement."""
        assert self._filtered is not None
        self._free = self._filtered.copy()
        self._tell(now)

    def advance(self, now: Now) -> None:
        assert self._free is not None and self._terms is not None
        self._free = advance(self._free, *self._transition, self._before, self._terms.u)
        self._tell(now)

    def ahead(self, now: Now, horizons: Array) -> Array:
        """The deflection goes on from the filtered measurement, the reference as planned, all else as it is."""
        assert self._terms is not None and self._filtered is not None
        terms, plan = self._terms, plan_ahead(now.sample, now.foot)
        plans = np.array([look_ahead(*plan, self.reference_vel, h)[0] for h in horizons])
        out = now.com + plans
        moved = coast(self._filtered, terms.M_inv, terms.K, terms.D, terms.u_still, horizons)
        moved = moved @ terms.J[:3].T
        out += moved
        for axis in self._following:
            out[:, axis] = self.reference[axis] + plans[:, axis]
        return out

    def _tell(self, now: Now) -> None:
        """The free run as COM and tilt, by forward kinematics of the deflected leg."""
        sample, leg = now.sample, self.robot.legs[self._foot]
        assert self._free is not None and sample.motor_q is not None and sample.motor_qd is not None
        q, qd = sample.motor_q.copy(), sample.motor_qd.copy()
        q[leg] += self._free[: len(leg)]
        qd[leg] += self._free[len(leg) :]
        self._predicted.update(q, qd)
        com, com_vel = self._predicted.com_in_sole(self._foot)
        self.state = np.concatenate((com, com_vel))
        for axis in self._following:
            self.state[axis], self.state[3 + axis] = self.reference[axis], self.reference_vel[axis]
        self.tilt = tilt(self._predicted.R[self._foot])

    def _change_leg(self, foot: Foot) -> None:
        """Tell both states by the joints of the new support leg: the trunk stays where it is."""
        terms = self._terms
        tied = terms is not None and len(terms.B) > 0  # without double support nothing ties the legs together

        def other(state: Array | None) -> Array | None:
            if state is None or terms is None or not tied:
                return None
            n = len(terms.u)
            d, rate = terms.d_other + terms.B @ state[:n], terms.d_other_rate + terms.B @ state[n:]
            return np.concatenate((d, rate))

        self._free, self._filtered = other(self._free), other(self._filtered)
        self._foot, self._u = foot, None

    def _assemble(self, now: Now) -> LinearTerms:
        robot, motor, sample, support = self.robot, self.motor, now.sample, now.support
        foot, other = self._foot, self._foot.other
        columns, theta_rate = robot.leg_columns, sample.motor_qd
        assert sample.motor_q is not None and theta_rate is not None
        double = support.phase == Phase.DOUBLE
        share = self.model.share(support) if double else 1.0
        R_so, p_so = flat(*now.link.sole_to_sole(foot, other)) if double else _NO_POSE
        robot.scatter(sample.motor_q, self._q)
        self._v[:6] = 0.0
        self._v[robot.idx_v] = theta_rate
        Y = pin.crba(self._pin, self._data, self._q)
        V, twists, J, J_other, B, d_other, d_other_rate, _ = geometry(
            Y, self.model.mass, motor.com, self._v,
            motor.sole_jacobian(foot), motor.R[foot], motor.p[foot], columns[foot],
            motor.sole_jacobian(other), motor.R[other], motor.p[other], columns[other],
            double, R_so, p_so,
        )  # fmt: skip
        tau = self._reference_torques(now, {foot: twists[0], other: twists[1]}) if self._swing else self._no_torque
        M, torque, weight = carried(
            Y, tau, -self.model.gravity * motor.R[foot][:, 2], V, columns[foot], B, columns[other]
        )
        u_still = -weight
        if self._pushing:
            push = Push(np.zeros(3), np.zeros(3))
            for effect in self._pushing:
                effect.push(push, now)
            u_still += push.force @ J[:3] + push.moment @ J[3:] + push.trunk @ V
        u = u_still - torque
        if not self._swing:
            u -= self.model.mass * self._reference_acceleration(now) @ J[:3]
        state = self._filtered if self._free is None else self._free
        assert state is not None
        n = len(state) // 2
        here = self._springs(foot, J, share, state[:n], state[n:], theta_rate)
        K, D = here.K_q, here.D_q
        pull = here.torque
        if double:
            d, rate = d_other + B @ state[:n], d_other_rate + B @ state[n:]
            there = self._springs(other, J_other, 1.0 - share, d, rate, theta_rate)
            w, w_o = min(1.0, share / self._full_share), min(1.0, (1.0 - share) / self._full_share)
            K_o, D_o = w_o * mul(B.T, there.K_q), w_o * mul(B.T, there.D_q)
            K, D = w * K + mul(K_o, B), w * D + mul(D_o, B)
            pull = w * pull + w_o * (there.torque @ B) + apply(K_o, d_other)
            u -= apply(D_o, d_other_rate)
        return LinearTerms(inverse(M), D, K, u - pull, u_still - pull, J, B, d_other, d_other_rate)

    def _springs(
        self, foot: Foot, J: Array, share: float, deflection: Array, rate: Array, motor_rate: Array
    ) -> LegSprings:
        load, motor_rate = share * self.model.mass * self.model.gravity, motor_rate[self.robot.legs[foot]]
        return self.model.springs.leg(foot, J, load, deflection, rate, motor_rate)

    def _reference_torques(self, now: Now, twists: dict[Foot, Array]) -> Array:
        """Generalised forces (nv,) of the motors' motion by inverse dynamics, without gravity, on the support sole."""
        theta_rate, foot = now.sample.motor_qd, self._foot
        assert theta_rate is not None
        before, self._rates = self._rates, (twists, theta_rate)
        if before is None or not now.dt > 0.0:
            return self._no_torque
        self._v[:6] = twists[foot]
        # Differences over the sample: their noise cancels in the sum, which is what moves the trunk.
        self._a[:6] = (twists[foot] - before[0][foot]) / now.dt
        self._a[self.robot.idx_v] = (theta_rate - before[1]) / now.dt
        return pin.rnea(self._pin, self._data, self._q, self._v, self._a)

    def _reference_acceleration(self, now: Now) -> Array:
        """Of the COM by the motors' motion (3,) [m/s^2], in the axes of the support sole."""
        before, self._com_vel = self._com_vel, (self._foot, self.reference_vel)
        if before[0] != self._foot or not now.dt > 0.0:
            return np.zeros(3)
        return (self.reference_vel - before[1]) / now.dt


def tilt(R_base_sole: Array) -> Array:
    """Roll and pitch (2,) [rad] of the trunk on a flat sole, from the sole's orientation (3, 3) in the base frame."""
    R = R_base_sole  # its transpose is the trunk in the sole
    return np.array([np.arctan2(R[1, 2], R[2, 2]), np.arcsin(max(-1.0, min(1.0, -R[0, 2])))])
