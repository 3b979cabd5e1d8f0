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
from .integrator import advance, transition
from .model import LegSprings, Model
from .odometry import flat
from .robot import Posture, Robot
from .trunk import carried_inertia, carried_torque, closure, coast, com_jacobian, leg_inverse, trunk_twist
from .types import Array, Foot, Phase, Sample, SupportState

# Bandwidth of the filter that follows the measured deflections. Below it the encoders are believed (0.4 mrad of
# quantisation noise), above it the model: the velocity it gives has no lag, other than a slope over past samples.
_FILTER = 20.0  # [rad/s]


@dataclass(slots=True)
class LinearTerms:
    """M d'' + D d' + K d = u for the joints of the support leg: (n, n), (n, n), (n, n), (n,)."""

    M: Array
    D: Array
    K: Array
    u: Array
    u_still: Array  # (n,) u if the reference stood still: what it does in this instant is not what it goes on to do
    J: Array  # (6, n) COM velocity and angular velocity of the trunk in sole axes, by those joints
    B: Array  # (k, n) other leg's joints by those of the support leg, in double support
    d_other: Array  # (k,) deflection of the other leg for d = 0
    d_other_rate: Array


@dataclass(slots=True)
class TrunkState:
    """COM (3,) [m], its velocity (3,) [m/s] and the trunk's roll and pitch (2,) [rad], in the support sole."""

    com: Array
    com_vel: Array
    tilt: Array


class TrunkModel:
    """Free run and filtered measurement of the trunk's six freedoms."""

    def __init__(self, robot: Robot, model: Model) -> None:
        """Share the effects and constants of the point-mass model."""
        self.robot = robot
        self.model = model
        self._full_share = next(e.values["full_share"] for e in model.effects if e.name == "trunk_rotation")
        self._swing = any(e.name == "swing_momentum" for e in model.effects)
        self._pin = robot.model.copy()  # its gravity turns with the sole
        self._data = robot.model.createData()
        self._q = pin.neutral(robot.model)
        self._v = np.zeros(robot.model.nv)
        self._a = np.zeros(robot.model.nv)
        self._predicted = robot.posture()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._foot = Foot.NONE
        self._state: Array | None = None  # (2n,) free run: deflections and their rates
        self._filtered: Array | None = None  # (2n,) the measurement
        self._u: Array | None = None
        self._terms: LinearTerms | None = None
        self._rates: tuple[dict[Foot, Array], Array, dict[Foot, Array]] | None = None

    @property
    def running(self) -> bool:
        """Whether there is a free run."""
        return self._state is not None

    def restart(self) -> None:
        """Let the free run begin from the filtered measurement."""
        self._state = None if self._filtered is None else self._filtered.copy()

    def update(self, sample: Sample, support: SupportState, link: Posture, motor: Posture, dt: float) -> None:
        """Bring free run and filter to the stamp of a sample, dt [s] after the last; its motor side must be there."""
        foot = support.support_foot
        if foot != self._foot:
            self._change_leg(foot)
        terms = self._assemble(sample, support, link, motor, dt)
        assert sample.motor_q is not None
        leg = self.robot.legs[foot]
        measured = sample.q[leg] - sample.motor_q[leg]
        before = terms.u if self._u is None else self._u
        if self._filtered is None:
            self._filtered = np.concatenate((measured, np.zeros(len(leg))))
        else:
            n = len(leg)
            E, G_0, G_1 = transition(inverse(terms.M), terms.K, terms.D, dt)
            if self._state is not None:
                self._state = advance(self._state, E, G_0, G_1, before, terms.u)
            filtered = advance(self._filtered, E, G_0, G_1, before, terms.u)
            error = measured - filtered[:n]
            filtered[:n] += (1.0 - np.exp(-2.0 * _FILTER * dt)) * error
            filtered[n:] += _FILTER**2 * dt * np.exp(-_FILTER * dt) * error
            self._filtered = filtered
        self._u, self._terms = terms.u, terms

    def predicted(self, sample: Sample) -> TrunkState:
        """The free run as COM and tilt, by forward kinematics of the deflected leg."""
        assert self._state is not None and sample.motor_q is not None and sample.motor_qd is not None
        leg = self.robot.legs[self._foot]
        q, qd = sample.motor_q.copy(), sample.motor_qd.copy()
        q[leg] += self._state[: len(leg)]
        qd[leg] += self._state[len(leg) :]
        self._predicted.update(q, qd)
        com, com_vel = self._predicted.com_in_sole(self._foot)
        return TrunkState(com, com_vel, tilt(self._predicted.R[self._foot]))

    def ahead(self, horizons: Array) -> Array:
        """How the deflection will have moved the COM (k, 3) [m] at horizons (k,) [s], all else as it is now."""
        assert self._terms is not None and self._filtered is not None
        terms = self._terms
        deflections = coast(self._filtered, inverse(terms.M), terms.K, terms.D, terms.u_still, horizons)
        return deflections @ terms.J[:3].T

    def _change_leg(self, foot: Foot) -> None:
        """Tell both states by the joints of the new support leg: the trunk stays where it is."""
        terms, double = self._terms, self._terms is not None and len(self._terms.B) > 0
        for name in ("_state", "_filtered"):
            state = getattr(self, name)
            if state is not None and terms is not None and double:
                n = len(terms.u)
                d, rate = terms.d_other + terms.B @ state[:n], terms.d_other_rate + terms.B @ state[n:]
                setattr(self, name, np.concatenate((d, rate)))
            else:  # without double support in between nothing ties the legs together
                setattr(self, name, None)
        self._foot, self._u = foot, None

    def _assemble(self, sample: Sample, support: SupportState, link: Posture, motor: Posture, dt: float) -> LinearTerms:
        robot, foot, other = self.robot, self._foot, self._foot.other
        assert sample.motor_q is not None and sample.motor_qd is not None
        columns, theta_rate = robot.leg_columns, sample.motor_qd
        double = support.phase == Phase.DOUBLE
        V = {f: trunk_twist(motor.sole_jacobian(f), columns[f], motor.p[f]) for f in (foot, other)}
        rate = {f: theta_rate[robot.legs[f]] for f in V}
        twist = {f: apply(V[f], rate[f]) for f in V}
        com_vel = {f: motor.com_in_sole(f)[1] for f in V}
        before, self._rates = self._rates, (twist, theta_rate.copy(), com_vel)
        if before is None or not dt > 0.0:
            before, dt = self._rates, 1.0
        robot.scatter(sample.motor_q, self._q)
        if self._swing:
            self._v[:6], self._v[robot.idx_v] = twist[foot], theta_rate
            # Differences over the sample: their noise cancels in the sum, which is what moves the trunk.
            self._a[:6] = (twist[foot] - before[0][foot]) / dt
            self._a[robot.idx_v] = (theta_rate - before[1]) / dt
        self._pin.gravity.linear = -self.model.gravity * motor.R[foot][:, 2]
        tau = pin.rnea(self._pin, self._data, self._q, self._v, self._a)
        Y = pin.crba(self._pin, self._data, self._q)
        J_com = pin.jacobianCenterOfMass(self._pin, self._data, self._q)
        J = com_jacobian(V[foot], columns[foot], J_com, motor.com, motor.R[foot])
        B = mul(leg_inverse(V[other]), V[foot]) if double else np.zeros((0, J.shape[1]))
        M = carried_inertia(Y, V[foot], columns[foot], B, columns[other], double)
        u = -carried_torque(tau, V[foot], columns[foot], B, columns[other], double)
        weight = pin.computeGeneralizedGravity(self._pin, self._data, self._q)
        u_still = -carried_torque(weight, V[foot], columns[foot], B, columns[other], double)
        if not self._swing:
            acceleration = (com_vel[foot] - before[2][foot]) / dt
            u -= self.model.mass * acceleration @ J[:3]
        share = self.model.share(support) if double else 1.0
        K, D = self._springs(foot, J, share)
        nothing = np.zeros(0)
        if not double:
            return LinearTerms(M, D, K, u, u_still, J, B, nothing, nothing)
        R_so, p_so = flat(*link.sole_to_sole(foot, other))
        d_other = closure(V[other], motor.R[foot], motor.p[foot], motor.R[other], motor.p[other], R_so, p_so)
        d_other_rate = apply(B, rate[foot]) - rate[other]
        J_other = com_jacobian(V[other], columns[other], J_com, motor.com, motor.R[other])
        K_other, D_other = self._springs(other, J_other, 1.0 - share)
        here, there = min(1.0, share / self._full_share), min(1.0, (1.0 - share) / self._full_share)
        K = here * K + there * mul(B.T, mul(K_other, B))
        D = here * D + there * mul(B.T, mul(D_other, B))
        u -= there * apply(B.T, apply(K_other, d_other) + apply(D_other, d_other_rate))
        u_still -= there * apply(B.T, apply(K_other, d_other))
        return LinearTerms(M, D, K, u, u_still, J, B, d_other, d_other_rate)

    def _springs(self, foot: Foot, J: Array, share: float) -> tuple[Array, Array]:
        joints, K_q, D_q = self.model.legs[foot]
        leg = LegSprings(foot, joints, J, K_q.copy(), D_q.copy(), share * self.model.mass * self.model.gravity)
        for effect in self.model.effects:
            effect.springs(leg)
        return leg.K_q, leg.D_q


def tilt(R_base_sole: Array) -> Array:
    """Roll and pitch (2,) [rad] of the trunk on a flat sole, from the sole's orientation (3, 3) in the base frame."""
    R = R_base_sole  # its transpose is the trunk in the sole
    return np.array([np.arctan2(R[1, 2], R[2, 2]), np.arcsin(max(-1.0, min(1.0, -R[0, 2])))])
