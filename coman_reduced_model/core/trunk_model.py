# SPDX-License-Identifier: BSD-3-Clause
"""The trunk on its legs with all six freedoms: what the point mass of the paper leaves out (effect `trunk_rotation`).

Coordinates are the joints x (m,) of both legs at the link side, the support leg's first, and a small displacement of
the support sole from level ground (6,); together they are the pose of the trunk and of both soles. Under (A1) the
motors theta(t) are known, and

    M x'' + D_q (x' - theta') + K_q (x - theta) = -tau(x, x') + what the ground does

with M the inertia that the joints carry and tau the torques of gravity and of the moving masses (`swing_momentum`),
both at the predicted posture, so that the toppling of the loaded leg (`gravity_stiffness`) is in them. Only positions
of the motors are needed, never their acceleration.

The ground can only press on the corners of the soles, and holds them no more than friction does (`contact.py`): a foot
that has just landed or is about to leave stands on an edge or a corner, and the springs of its leg hold little, and a
robot that sways stands on the edges of both. That, not a share of stiffness, is how the load passes from leg to leg.
How feet slide against each other in double support is measured; all else follows from the motors and the phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .config import Config
from .contact import ROWS, by_other, track
from .dynamics import Dynamics, Now, Push
from .effects import Effect
from .model import Model
from .reference import look_ahead, motor_com, plan_ahead
from .robot import Robot
from .springs import LegSprings
from .stride import Stride, swapped
from .trunk import carried, geometry, tell, topple_both
from .types import Array, Foot, Phase, Sample

# Bandwidth of the filter that follows the measured joints. Below it the encoders are believed (0.4 mrad of quantisation
# noise), above it the model: the velocity it gives has no lag, other than a slope over past samples.
_FILTER = 20.0  # [rad/s]
_LONGEST = 0.005  # [s] of the implicit steps: a foot leaves or meets the ground between two of them
_FOLLOWS = 0.02  # [s] of the feet in the free run after those measured
_FALLEN = 0.3  # [m], [rad] by which the support sole of a free run has left the ground when the robot has fallen
_FADES = 0.1  # [s] time constant of a horizontal deflection whose future nothing tells


@dataclass(slots=True)
class LegTerms:
    """M x'' + D (x' - theta') + K (x - theta) = f for the joints x (m,) of both legs, the support leg's n first."""

    foot: Foot
    double: bool
    y: Array  # (m + 6,) joints [rad], displacement of the support sole [m], [rad] at which all this was taken
    theta: Array  # (m,) motor positions [rad]
    M: Array  # (m + 6, m + 6)
    K: Array  # (m, m)
    D: Array
    f: Array  # (m + 6,)
    J: Array  # (6, m) COM velocity and angular velocity of the trunk in sole axes
    V: Array  # (6, n) twist of the trunk in its own axes
    A: Array  # (6, 6) the same by that of the support sole
    C: Array  # (14, m + 6) from `contacts`
    height: Array  # (14,)
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
        self._K, self._D = (
            {foot: np.diag(np.concatenate((values[foot], values[foot.other]))) for foot in (Foot.LEFT, Foot.RIGHT)}
            for values in (model.springs.stiffness, model.springs.damping)
        )
        self._pin = robot.model.copy()
        self._pin.gravity.linear = np.zeros(3)
        self._data = robot.model.createData()
        self._q = pin.neutral(robot.model)
        self._v, self._a = np.zeros((2, robot.model.nv))
        self._no_torque = np.zeros(robot.model.nv)
        self._still = np.zeros(len(robot.joint_names))
        self._stride = Stride(self._friction, np.array([robot.soles[Foot.LEFT], robot.soles[Foot.RIGHT]]))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.stop()
        self._stride.reset()

    def stop(self) -> None:
        """End the free run and the filter: an input is missing. The last stride is kept."""
        self.state = None
        self._foot = Foot.NONE
        # (2, m + 6) joints of both legs and displacement of the support sole, and their rates:
        self._free: Array | None = None  # free run
        self._next: Array | None = None  # the same at this sample
        self._filtered: Array | None = None  # the measurement
        self._P = np.zeros((2, 2 * ROWS))  # impulses of the ground in the last step of filter and free run
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
            self._filtered = self._measured(sample)
        assert self._filtered is not None
        self._terms, before = self._assemble(now), self._terms
        self._theta = self._terms.theta
        if before is not None:
            self._theta = before.theta if before.foot == now.foot else swapped(before.theta)
        if not first:
            t = self._terms
            free = self._filtered if self._free is None else self._free
            self._filtered, self._next = track(
                self._filtered, free, self._P, sample.q[order], now.dt, _LONGEST, _FILTER, _FOLLOWS, t.double,
                t.M, t.K, t.D, t.f, self._theta, t.theta, t.C, t.height, t.y, self._friction, t.reach,
            )  # fmt: skip
            if not np.isfinite(self._filtered).all():  # with the free run, at whose posture all terms are taken
                self._filtered = self._measured(sample)
                self._P[:] = 0.0
        return True

    def _measured(self, sample: Sample) -> Array:
        """The state (2, m + 6) by the encoders alone, the support sole level on the ground."""
        order = self._order[self._foot]
        state = np.zeros((2, len(order) + 6))
        state[:, : len(order)] = sample.q[order], sample.qd[order]
        return state

    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """`prepare` has told the free run by the new support leg: the joints stay as they are."""

    def restart(self, now: Now) -> None:
        """From the filtered measurement."""
        assert self._filtered is not None
        self._free = self._filtered.copy()
        self._P[1] = self._P[0]
        self._tell()
        if (
            self.state is None or not np.isfinite(self.state).all()
        ):  # the terms are those of a free run that has left all bounds
            self.state, self.tilt = np.concatenate((now.com, now.com_vel)), now.link.tilt(now.foot)

    def advance(self, now: Now) -> None:
        """To where `prepare` has already brought it."""
        self._free = self._next
        self._tell()
        assert self._free is not None and self.state is not None
        if (
            not np.abs(self._free[0, -6:]).max() < _FALLEN
        ):  # over an edge of its sole, in whose frame it stays where it is
            self.state = np.full(6, np.nan)

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

    def _tell(self) -> None:
        """The free run as COM and tilt."""
        t, free = self._terms, self._free
        assert t is not None and free is not None
        told = tell(t.com, t.J, t.y, free, self._posture.R[t.foot], self._posture.up)
        self.state, self.tilt = told[:6], told[6:]
        for axis in self._following:
            self.state[axis], self.state[3 + axis] = self.reference[axis], self.reference_vel[axis]

    def _change_leg(self, foot: Foot) -> None:
        self._foot, t = foot, self._terms
        if t is None:
            return
        for k, state in enumerate((self._filtered, self._free)):
            if state is not None:
                state[0], state[1], self._P[k] = by_other(
                    state[0], state[1], self._P[k], t.C, t.height, t.y, self.robot.soles[foot]
                )

    def _assemble(self, now: Now) -> LegTerms:
        robot, posture, sample, soles = self.robot, self._posture, now.sample, self.robot.soles
        foot, other = self._foot, self._foot.other
        columns, order = robot.leg_columns, self._order[self._foot]
        state = self._filtered if self._free is None else self._free
        assert state is not None and sample.motor_q is not None and sample.motor_qd is not None
        double = now.support.phase == Phase.DOUBLE
        share = self.model.share(now.support) if double else 1.0
        m, n = len(order), len(columns[foot])
        y, w = state
        q, qd, theta, turning = (
            sample.motor_q.copy(),
            sample.motor_qd.copy(),
            sample.motor_q[order],
            sample.motor_qd[order],
        )
        q[order], qd[order] = y[:m], w[:m]
        posture.update(q, self._still)
        robot.scatter(q, self._q)
        self._v[robot.idx_v] = qd
        before, R, p = self._terms, posture.R, posture.p
        if before is None or before.foot != foot:
            before = None
        Y = pin.crba(self._pin, self._data, self._q)
        V, A, C, height, J, J_o, com, down = geometry(
            Y, self.model.mass, posture.com, posture.J, R[foot], p[foot], columns[foot], soles[foot],
            R[other], p[other], columns[other], soles[other], y, w,
            *((np.zeros((6, n)), np.zeros((6, 6)), 0.0) if before is None else (before.V, before.A, now.dt)),
            self._v, self._a,
        )  # fmt: skip
        # How the moving masses resist, the joints not accelerating.
        tau = pin.rnea(self._pin, self._data, self._q, self._v, self._a) if self._swing else self._no_torque
        M, f = carried(Y, tau, self.model.gravity * down, V, columns[foot], columns[other], A)
        if not self._swing:  # the legs move without reaction
            M[:n, n:m] = M[n:m, :n] = M[m:, n:m] = M[n:m, m:] = 0.0
        if self._pushing:
            push = Push(np.zeros(3), np.zeros(3))
            for effect in self._pushing:
                effect.push(push, now)
            f[:m] += push.force @ J[:3] + push.moment @ J[3:]
            f[:n] += push.trunk @ V
        weight, e = self.model.mass * self.model.gravity, y[:m] - theta
        loads = (share * weight, (1.0 - share) * weight)
        K, D = self._K[foot].copy(), self._D[foot]
        if self.model.springs.plain:
            if self._topples:
                topple_both(J, J_o, *loads, e, K, f)
        else:
            D, rate = D.copy(), w[:m] - turning
            for side, part, J_leg, load in zip(
                (foot, other), (slice(0, n), slice(n, m)), (J[:, :n], J_o), loads, strict=True
            ):
                leg = self._springs(side, J_leg, load, e[part], rate[part], turning[part])
                K[part, part], D[part, part] = leg.K_q, leg.D_q
                f[part] -= leg.torque
        sole = soles[other]
        reach = 0.5 * float(min(sole[1] - sole[0], sole[3] - sole[2]))
        return LegTerms(foot, double, y.copy(), theta, M, K, D, f, J, V, A, C, height, reach, com)

    def _springs(
        self, foot: Foot, J: Array, load: float, deflection: Array, rate: Array, motor_rate: Array
    ) -> LegSprings:
        leg = self.model.springs.leg(foot, J, load, deflection, rate, motor_rate, deflection)
        if not self._topples:  # as if gravity were taken where the springs are not deflected
            leg.torque -= load * leg.height_hessian() @ deflection
        return leg
