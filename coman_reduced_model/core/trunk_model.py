# SPDX-License-Identifier: BSD-3-Clause
"""The trunk on its legs with all six freedoms: what the point mass of the paper leaves out (effect `trunk_rotation`).

Coordinates are the joints x (m,) of both legs at the link side, the support leg's first; with the support sole on the
ground they are the pose of the trunk and of the other leg. Under (A1) the motors theta(t) are known, and

    M x'' + D_q (x' - theta') + K_q (x - theta) = -tau(x, x')

with M the inertia that the joints carry and tau the torques of gravity and of the moving masses (`swing_momentum`),
both at the predicted posture, so that the toppling of the loaded leg (`gravity_stiffness`) is in them. Only positions
of the motors are needed, never their acceleration.

In double support the other sole stands as well: its leg follows the trunk, and its springs act in parallel. They can
only press on the ground, within the edges of the sole, and push it aside no more than friction holds (`trunk.stand`): a
foot that has just landed or is about to leave stands on an edge or a corner, and its springs hold little. That, not a
share of stiffness, is how the load passes from leg to leg.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2

import numpy as np
import pinocchio as pin

from .config import Config
from .dynamics import Dynamics, Now, Push
from .effects import Effect
from .model import Model
from .odometry import flat
from .reference import look_ahead, motor_com, plan_ahead
from .robot import Robot
from .springs import LegSprings
from .stride import Stride
from .trunk import carried, geometry, lifts, step_legs
from .types import Array, Foot, Phase

# Bandwidth of the filter that follows the measured joints. Below it the encoders are believed (0.4 mrad of quantisation
# noise), above it the model: the velocity it gives has no lag, other than a slope over past samples.
_FILTER = 20.0  # [rad/s]
_LONGEST = 0.005  # [s] of the implicit steps: a foot leaves or meets the ground between two of them
_FADES = 0.1  # [s] time constant of a horizontal deflection whose future nothing tells
_NO_POSE = (np.eye(3), np.zeros(3))


@dataclass(slots=True)
class LegTerms:
    """M x'' + D (x' - theta') + K (x - theta) = f for the joints x (m,) of both legs, the support leg's n first."""

    foot: Foot
    double: bool
    x: Array  # (m,) posture at which all this was taken [rad]
    theta: Array  # (m,) motor positions [rad]
    M: Array  # (m, m)
    K: Array
    D: Array
    f: Array  # (m,)
    J: Array  # (6, m) COM velocity and angular velocity of the trunk in sole axes
    V: Array  # (6, n) twist of the trunk in its own axes
    B: Array  # (k, n) other leg's joints by those of the support leg, both soles standing
    held: Array  # (k,) [rad] other leg's joints for none of the support leg, both soles standing
    H: Array  # (k, 8) from `lifts`
    reach: float  # [m] lever at which friction resists twisting the other sole
    com: Array  # (3,) in the support sole [m]


class TrunkModel(Dynamics):
    """Free run and filtered measurement of the trunk's six freedoms and of the other leg."""

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        """Share the effects and constants of the point-mass model."""
        super().__init__()
        self.robot = robot
        self.model = model
        self.motor, self._posture = robot.posture(), robot.posture()
        self._friction = next(e.values["friction"] for e in model.effects if e.name == "trunk_rotation")
        self._swing, self._topples = (
            any(e.name == name for e in model.effects) for name in ("swing_momentum", "gravity_stiffness")
        )
        self._pushing = [e for e in model.effects if type(e).push is not Effect.push]
        self._following = [axis for axis in range(3) if axis not in model.axes]
        left, right = robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]
        self._order = {Foot.LEFT: np.concatenate((left, right)), Foot.RIGHT: np.concatenate((right, left))}
        self._pin = robot.model.copy()
        self._pin.gravity.linear = np.zeros(3)
        self._data = robot.model.createData()
        self._q = pin.neutral(robot.model)
        self._v, self._a = np.zeros((2, robot.model.nv))
        self._no_torque = np.zeros(robot.model.nv)
        self._still = np.zeros(len(robot.joint_names))
        self._stride = Stride(self._friction)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.stop()
        self._stride.reset()

    def stop(self) -> None:
        """End the free run and the filter: an input is missing. The last stride is kept."""
        self.state = None
        self._foot = Foot.NONE
        self._free: Array | None = None  # (2m,) free run: joints of both legs and their rates
        self._filtered: Array | None = None  # (2m,) the measurement
        self._terms: LegTerms | None = None
        self._theta = np.empty(0)  # (m,) motor positions at the beginning of the step that ends at this sample

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
        order = self._order[now.foot]
        if first := self._filtered is None:
            self._filtered = np.concatenate((sample.q[order], sample.qd[order]))
        assert self._filtered is not None
        self._terms, before = self._assemble(now), self._terms
        self._theta = self._terms.theta
        if before is not None:
            self._theta = before.theta if before.foot == now.foot else _swapped(before.theta)
        if not first:
            m, dt = len(order), now.dt
            filtered = self._step(self._filtered, dt)
            error = sample.q[order] - filtered[:m]
            filtered[:m] += (1.0 - np.exp(-2.0 * _FILTER * dt)) * error
            filtered[m:] += _FILTER**2 * dt * np.exp(-_FILTER * dt) * error
            self._filtered = filtered
        return True

    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """`prepare` has told the free run by the new support leg: the joints stay as they are."""

    def restart(self, now: Now) -> None:
        """From the filtered measurement."""
        assert self._filtered is not None
        self._free = self._filtered.copy()
        self._tell()

    def advance(self, now: Now) -> None:
        assert self._free is not None
        self._free = self._step(self._free, now.dt)
        self._tell()

    def ahead(self, now: Now, horizons: Array) -> Array:
        """Through the stride before, if the robot repeats it.

        Else as planned from here (without a plan as fast as now), while the horizontal deflection fades.
        """
        assert self._terms is not None and self._filtered is not None
        self._stride.add(now, self._terms)
        repeated = self._stride.ahead(now, self._terms, self._filtered, horizons)
        if repeated is not None:
            return repeated
        plan = plan_ahead(now.sample, now.foot)
        left = np.outer(np.exp(-horizons / _FADES), np.ones(3))  # of the deflection
        left[:, 2] = 1.0  # the sag stays
        left[:, self._following] = 0.0
        moved = np.array([look_ahead(*plan, self.reference_vel, h)[0] for h in horizons])
        return self.reference + moved + left * (now.com - self.reference)

    def _step(self, state: Array, dt: float) -> Array:
        t, m = self._terms, len(state) // 2
        assert t is not None
        x, w, _ = step_legs(
            state[:m], state[m:], dt, _LONGEST, t.double, t.M, t.K, t.D, t.f, self._theta, t.theta,
            t.B, t.held, t.H, self._friction, t.reach,
        )  # fmt: skip
        return np.concatenate((x, w))

    def _tell(self) -> None:
        """The free run as COM and tilt: those of the posture of the terms, and a little further."""
        t, free = self._terms, self._free
        assert t is not None and free is not None
        m = len(t.x)
        moved = free[:m] - t.x
        self.state = np.concatenate((t.com + t.J[:3] @ moved, t.J[:3] @ free[m:]))
        for axis in self._following:
            self.state[axis], self.state[3 + axis] = self.reference[axis], self.reference_vel[axis]
        self.tilt = tilt(self._posture.R[t.foot]) + t.J[3:5] @ moved

    def _change_leg(self, foot: Foot) -> None:
        self._foot = foot
        self._free = None if self._free is None else _swapped(self._free)
        self._filtered = None if self._filtered is None else _swapped(self._filtered)

    def _assemble(self, now: Now) -> LegTerms:
        robot, posture, sample = self.robot, self._posture, now.sample
        foot, other = self._foot, self._foot.other
        columns, order = robot.leg_columns, self._order[self._foot]
        state = self._filtered if self._free is None else self._free
        assert state is not None and sample.motor_q is not None and sample.motor_qd is not None
        double = now.support.phase == Phase.DOUBLE
        share = self.model.share(now.support) if double else 1.0
        R_so, p_so = flat(*now.link.sole_to_sole(foot, other)) if double else _NO_POSE
        m, n = len(order), len(columns[foot])
        x, w = state[:m], state[m:]
        q, qd, theta = sample.motor_q.copy(), sample.motor_qd.copy(), sample.motor_q[order]
        q[order], qd[order] = x, w
        posture.update(q, self._still)
        robot.scatter(q, self._q)
        Y = pin.crba(self._pin, self._data, self._q)
        V, V_o, J, J_o, B, off = geometry(
            Y, self.model.mass, posture.com,
            posture.sole_jacobian(foot), posture.R[foot], posture.p[foot], columns[foot],
            posture.sole_jacobian(other), posture.R[other], posture.p[other], columns[other], R_so, p_so,
        )  # fmt: skip
        tau = self._moving(V, w[:n], qd, now.dt) if self._swing else self._no_torque
        down = -self.model.gravity * posture.R[foot][:, 2]
        M, torque, weight = carried(Y, tau, down, V, columns[foot], columns[other])
        if not self._swing:  # the legs move without reaction
            M[:n, n:] = M[n:, :n] = 0.0
        f = -weight - torque
        if self._pushing:
            push = Push(np.zeros(3), np.zeros(3))
            for effect in self._pushing:
                effect.push(push, now)
            f += push.force @ J[:3] + push.moment @ J[3:]
            f[:n] += push.trunk @ V
        K, D, e, rate = np.zeros((m, m)), np.zeros((m, m)), x - theta, w - sample.motor_qd[order]
        for side, part, J_leg, load in ((foot, slice(0, n), J[:, :n], share), (other, slice(n, m), J_o, 1.0 - share)):
            leg = self._springs(side, J_leg, load, e[part], rate[part], w[part] - rate[part])
            K[part, part], D[part, part] = leg.K_q, leg.D_q
            f[part] -= leg.torque
        sole = robot.soles[other]
        H = lifts(V_o, posture.R[other], posture.p[other], sole)
        held = x[n:] + off - B @ x[:n]
        reach = 0.5 * float(min(sole[1] - sole[0], sole[3] - sole[2]))
        com, _ = posture.com_in_sole(foot)
        return LegTerms(foot, double, x, theta, M, K, D, f, J, V, B, held, H, reach, com)

    def _springs(
        self, foot: Foot, J: Array, share: float, deflection: Array, rate: Array, motor_rate: Array
    ) -> LegSprings:
        load = share * self.model.mass * self.model.gravity
        leg = self.model.springs.leg(foot, J, load, deflection, rate, motor_rate, deflection)
        if not self._topples:  # as if gravity were taken where the springs are not deflected
            leg.torque -= load * leg.height_hessian() @ deflection
        return leg

    def _moving(self, V: Array, w: Array, qd: Array, dt: float) -> Array:
        """Generalised forces (nv,) by which the moving masses resist, without gravity, the joints not accelerating."""
        self._v[:6] = V @ w
        self._v[self.robot.idx_v] = qd
        before = self._terms
        same = before is not None and before.foot == self._foot and dt > 0.0
        self._a[:6] = (V - before.V) @ w / dt if same else 0.0  # type: ignore[union-attr]
        return pin.rnea(self._pin, self._data, self._q, self._v, self._a)


def _swapped(state: Array) -> Array:
    """Joint positions (m,), or positions and rates (2m,), with the other leg's first."""
    return state.reshape(-1, 2, len(state) // 4 if len(state) > 12 else len(state) // 2)[:, ::-1].ravel()


def tilt(R_base_sole: Array) -> Array:
    """Roll and pitch (2,) [rad] of the trunk on a flat sole, from the sole's orientation (3, 3) in the base frame."""
    R = R_base_sole  # its transpose is the trunk in the sole
    return np.array([atan2(R[1, 2], R[2, 2]), asin(max(-1.0, min(1.0, -R[0, 2])))])
