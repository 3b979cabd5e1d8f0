# SPDX-License-Identifier: BSD-3-Clause
"""The trunk on its legs with all six freedoms: what the point mass of the paper leaves out (option `trunk_rotation`).

Coordinates are the joints x (m,) of both legs at the link side, the support leg's first, and a small displacement of
the support sole from level ground (6,); together they are the pose of the trunk and of both soles. Under (A1) the
motors theta(t) are known, and

    M x'' + D_q (x' - theta') + K_q (x - theta) = -tau(x, x') + what the ground does

with M the inertia that the joints carry and tau the torques of gravity and of the moving masses (`swing_momentum`),
both at the predicted posture, so that the toppling of the loaded leg (`gravity_stiffness`) is in them. Only positions
of the legs' motors are needed, never their acceleration. Joints outside the legs (waist, arms, head) are no
coordinates: they follow their motors, and what that takes pushes the trunk.

The ground can only press on the corners of the soles, and holds them no more than friction does (`contact.py`): a foot
that has just landed or is about to leave stands on an edge or a corner, and the springs of its leg hold little, and a
robot that sways stands on the edges of both. That, not a share of stiffness, is how the load passes from leg to leg.
The free run follows from the motors, the support phase and its switching times alone; between two restarts it takes
nothing that is measured. A joint without a motor stream has its link position for that of its motor.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...base.types import Array, Flags, Foot, Integers, Phase, Sample
from ...config.schema import Config
from ...effects.catalogue import Effect
from ...effects.hooks import Now, Push
from ...measured.odometry import flat
from ...measured.slope import LEVEL
from ...measured.standing import StandingSoles
from ...robot.robot import Robot
from ..cartesian import Model
from ..dynamics import Dynamics
from ..reference import Plan, look_ahead, motor_com
from .contact import ROWS, Options, State, support_share, switch_support
from .kinematics import (
    Assembled,
    Pose,
    TrunkTerms,
    advance,
    assemble,
    com_and_tilt,
    deflections,
    pose_legs,
    take_posture,
    terms_of,
    terms_size,
)
from .stride import Stride

# Bandwidth of the filter that follows the measured joints. Below it the encoders are believed (0.4 mrad of quantisation
# noise), above it the model: the velocity it gives has no lag, other than a slope over past samples.
_FILTER = 20.0  # [rad/s]
_LONGEST = 0.005  # [s] of the implicit steps: a foot leaves or meets the ground between two of them
_FALLEN = 0.3  # [m], [rad] by which the support sole of a free run has left the ground when the robot has fallen
_FADES = 0.1  # [s] time constant of a horizontal deflection whose future is not known


class TrunkModel(Dynamics):
    """Free run and filtered measurement of the trunk's six freedoms and of the other leg."""

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        """Share the effects and constants of the point-mass model."""
        super().__init__()
        self.robot = robot
        self.model = model
        self.motor, self._posture = robot.posture(), robot.posture()
        friction = config.model.friction
        self._options = Options(friction, _LONGEST, _FILTER)
        self._swing = config.uses("swing_momentum")
        self._pushing = [e for e in model.effects if type(e).push is not Effect.push]
        self._following = [axis for axis in range(3) if axis not in model.axes]
        left, right = robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]
        self._order: dict[Foot, Integers] = {
            Foot.LEFT: np.concatenate((left, right)),
            Foot.RIGHT: np.concatenate((right, left)),
        }
        self._K, self._D = (
            {foot: np.diag(np.concatenate((values[foot], values[foot.other]))) for foot in (Foot.LEFT, Foot.RIGHT)}
            for values in (model.springs.stiffness, model.springs.damping)
        )
        m = len(left) + len(right)
        blocks = np.zeros((2, terms_size(m)))
        self._spare = [Assembled(block, terms_of(block, m)) for block in blocks]  # those of a sample, in turn
        self._poses = {foot: self._pose(foot) for foot in (Foot.LEFT, Foot.RIGHT)}
        self._no_spring_torque = np.zeros(m)
        self._pin = robot.model.copy()
        self._pin.gravity.linear = np.zeros(3)
        self._data = robot.model.createData()
        self._v, self._a = np.zeros((2, robot.model.nv))
        self._no_torque = np.zeros(robot.model.nv)
        self._q, self._rates = np.zeros((2, len(robot.joint_names)))
        self._soles = StandingSoles()
        self._above = np.setdiff1d(np.arange(len(robot.joint_names)), self._order[Foot.LEFT])  # waist, arms, head
        # Columns of those of them between root link and legs: none, if the legs hang on the root link.
        self._between = np.setdiff1d(robot.sole_columns[Foot.LEFT], robot.leg_columns[Foot.LEFT])
        self._stride = Stride(friction, np.array([robot.soles[Foot.LEFT], robot.soles[Foot.RIGHT]]))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.stop()
        self._stride.reset()
        self._soles.reset()
        self._ground, self.flags = self._soles.planes(), Flags.OK

    def stop(self) -> None:
        """End the free run and the filter: an input is missing. The last stride is kept."""
        self.state = None
        self._foot = Foot.NONE
        self._free: State | None = None  # the free run
        self._filtered: State | None = None  # the measurement
        self._terms: Assembled | None = None
        self._repeated: Array | None = None  # deflections ahead, if the robot repeats its stride
        self._above_rate: Array | None = None  # (nj,) of joints outside the legs at the last sample [rad/s]
        self._above_twist = np.zeros(6)  # of the root link by them
        self._down = LEVEL  # gravity in odom, as known at the restart
        self._R_odom_sole = np.eye(3)  # orientation of the support sole, measured at a restart, then by the model

    def prepare(self, now: Now) -> bool:
        """Assemble the equation of motion and bring the filter of the measurement to this sample."""
        sample = now.sample
        if sample.motor_q is None or sample.motor_qd is None:
            self.reference = self.reference_vel = np.full(3, np.nan)
            return False
        self.motor.update(sample.motor_q, sample.motor_qd)
        self.reference, self.reference_vel = motor_com(self.motor, now.foot)
        self._soles.update(now.link, now.support, now.dt)
        if self._free is None:
            self._ground, self._down = self._soles.planes(), now.down
        if now.foot != self._foot:
            self._change_leg(now.foot)
        before, first = self._terms, self._filtered is None
        if self._filtered is None:
            self._filtered = self._measured(sample)
        self._terms = terms = self._assemble(now, before)
        if not first and not self._advance(now, terms, before or terms):  # no longer finite, nor is the free run,
            self._filtered = self._measured(sample)  # at whose posture all terms are taken
        return True

    def _advance(self, now: Now, terms: Assembled, before: Assembled) -> bool:
        """Filter and free run to this sample, by its own terms and the motors since the sample before."""
        filtered, order = self._filtered, self._order[self._foot]
        assert filtered is not None
        states = filtered, copied(filtered) if self._free is None else self._free
        same, dt = before.foot == terms.foot, now.dt
        finite: bool = advance(
            terms.block, before.block, same, states, now.sample.q, order, terms.double, dt, self._options
        )
        return finite

    def _measured(self, sample: Sample) -> State:
        """The state by the encoders alone, the support sole level on the ground."""
        order = self._order[self._foot]
        y, w = np.zeros((2, len(order) + 6))
        y[: len(order)], w[: len(order)] = sample.q[order], sample.qd[order]
        return State(y, w, np.zeros(2 * ROWS))

    @property
    def aslant_landings(self) -> int:
        return self._soles.aslant_landings

    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """`prepare` has expressed the free run by the new support leg: the joints stay as they are."""

    def restart(self, now: Now) -> None:
        """From the filtered measurement."""
        if now.support.phase == Phase.DOUBLE:
            self._soles.land(now.link)
            self.flags = Flags.UNKNOWN_GROUND if self._soles.aslant else Flags.OK
        self._ground, self._down = self._soles.planes(), now.down
        assert self._filtered is not None
        self._free = copied(self._filtered)
        self._R_odom_sole = now.T_odom_sole[:3, :3]
        self._publish()
        if self.state is None or not np.isfinite(self.state).all():
            # The terms are those of a free run that has left all bounds.
            self.state, self.tilt = np.concatenate((now.com, now.com_vel)), now.tilt

    def advance(self, now: Now) -> None:
        """`prepare` has already brought it there."""
        self._publish()
        assert self._free is not None and self.state is not None
        if not max(map(abs, self._free.y[-6:].tolist())) < _FALLEN:  # over an edge of its sole, in whose frame it stays
            self.state = np.full(6, np.nan)

    def ahead(self, now: Now, com: Array, com_vel: Array, plan: Plan, horizons: Array) -> Array:
        """Through the stride before, if the robot repeats it: from the filtered joints, whatever the state handed in.

        Else as planned from the state handed in (without a plan as fast as now), while the horizontal deflection fades,
        unless the robot stands.
        """
        assert self._terms is not None and self._filtered is not None
        terms = self._terms
        self._stride.add(now, terms, self.reference)
        repeated = self._stride.ahead(now, terms, self._filtered, horizons)
        self._repeated, self.repeating = None if repeated is None else repeated[:, 3:], repeated is not None
        if repeated is not None:
            return repeated[:, :3]
        fading = 0.0 if now.standing else 1.0 / _FADES
        left = np.outer(np.exp(-fading * horizons), np.ones(3))  # of the deflection
        left[:, 2] = 1.0  # the sag stays
        left[:, self._following] = 0.0
        moved = np.array([look_ahead(*plan, self.reference_vel, h)[0] for h in horizons])
        return self.reference + moved + left * (com - self.reference)

    def deflections(self, now: Now, horizons: int) -> Array:
        """As in `Dynamics`: now by the filter; ahead by the stride before, else as they are now."""
        assert self._terms is not None and self._filtered is not None
        out, foot = np.empty((1 + horizons, 3 + len(self._no_spring_torque))), self._foot
        deflections(
            out[0], self._terms.block, self._filtered.y, now.sample.q, self._order[foot], now.com, self.reference,
            foot == Foot.LEFT,
        )  # fmt: skip
        out[1:] = out[0] if self._repeated is None else self._repeated
        return out

    def _publish(self) -> None:
        """The free run as COM and tilt."""
        t, free, values = self._terms, self._free, np.empty(8)
        assert t is not None and free is not None
        com_and_tilt(values, t.block, self._posture.R[t.foot], self._posture.up, free.y, free.w)
        self.state, self.tilt = values[:6], values[6:]
        if len(self._above):
            self.state[3:] += self._posture.com_in_sole(t.foot)[1]
        for axis in self._following:
            self.state[axis], self.state[3 + axis] = self.reference[axis], self.reference_vel[axis]

    def _change_leg(self, foot: Foot) -> None:
        self._foot, t = foot, self._terms
        if t is None:
            return
        self._R_odom_sole = self._R_odom_sole @ flat(*self._posture.sole_to_sole(t.foot, foot))[0]
        edges = self.robot.soles[foot]
        if self._filtered is not None:
            self._filtered = switch_support(self._filtered, t.terms.linear, edges)
        if self._free is not None:
            self._free = switch_support(self._free, t.terms.linear, edges)

    def _assemble(self, now: Now, before: Assembled | None) -> Assembled:
        """The equation of motion at the posture of the free run, or of the filter while there is none."""
        sample, foot, state = now.sample, self._foot, self._filtered if self._free is None else self._free
        assert state is not None and sample.motor_q is not None and sample.motor_qd is not None
        order, posture, robot = self._order[foot], self._posture, self.robot
        made = self._spare[self._spare[0] is before]
        made.foot, made.double = foot, now.support.phase == Phase.DOUBLE
        block, v, a = made.block, self._v, self._a
        pose_legs(
            block, state.y, state.w, order, sample.motor_q, sample.motor_qd, robot.idx_v, self._q, self._rates, v
        )  # fmt: skip
        posture.update(self._q, self._rates)
        known = before is not None and before.foot == foot
        last, dt = (before.block, now.dt) if before is not None and known else (block, 0.0)
        pose = self._poses[foot]
        take_posture(block, last, pose, self._ground[foot], state.y, state.w, dt, v, a)
        if self._down is not LEVEL:
            self._tilt_gravity(made.terms.geometry.down, state.y[-3:], now)
        if len(self._above):
            self._move_above(now.dt)
        inertia, tau = pin.crba(self._pin, self._data, posture.configuration), self._no_torque
        if self._swing:  # how the moving masses resist, the joints of the legs not accelerating
            tau = pin.rnea(self._pin, self._data, posture.configuration, v, a)
        weight = self.model.mass * self.model.gravity
        share = support_share(state.P) if made.double else 1.0
        loads = share * weight, (1.0 - share) * weight
        K, D, torque = self._springs(made.terms, loads, state, sample.motor_qd)
        assemble(
            block, inertia, tau, self.model.gravity, pose.columns, K, D, torque, loads,
            self.model.springs.gravity_stiffness,
        )  # fmt: skip
        if not self._swing:  # the legs move without reaction
            n, m, M = len(order) // 2, len(order), made.terms.M
            M[:n, n:m] = M[n:m, :n] = M[m:, n:m] = M[n:m, m:] = 0.0
        if self._pushing:
            self._add_push(made.terms, now)
        return made

    def _pose(self, foot: Foot) -> Pose:
        """Views of the model's posture, of which that leg is the support leg."""
        posture, robot, other = self._posture, self.robot, foot.other
        columns, edges = robot.idx_v[self._order[foot]], np.array([robot.soles[foot], robot.soles[other]])
        return Pose(
            posture.com, posture.J, posture.J_com, posture.R[foot], posture.p[foot], posture.R[other],
            posture.p[other], columns, edges,
        )  # fmt: skip

    def _tilt_gravity(self, down: Array, turned: Array, now: Now) -> None:
        """Fill in `Geometry.down` (3,) on a slope, the support sole turned against it by small angles (3,) [rad]."""
        R_odom_sole = now.T_odom_sole[:3, :3] if self._free is None else self._R_odom_sole
        in_sole = R_odom_sole.T @ self._down
        down[:] = self._posture.R[self._foot] @ (in_sole - np.cross(turned, in_sole))

    def _move_above(self, dt: float) -> None:
        """Move the joints outside the legs, accelerating as their motors did since the last sample.

        The step of the model takes that for its whole length: momentum changes by that of the rates, and their noise
        does not add up. Call after `take_posture`.
        """
        rate, columns = self._rates.copy(), self.robot.idx_v[self._above]
        twist = -self._posture.J[:, self._between] @ self._v[self._between]
        self._v[:6] += twist
        if self._above_rate is not None and dt > 0.0:
            self._a[columns] = (rate - self._above_rate)[self._above] / dt
            self._a[:6] += (twist - self._above_twist) / dt
        else:
            self._a[columns] = 0.0
        self._above_rate, self._above_twist = rate, twist

    def _add_push(self, terms: TrunkTerms, now: Now) -> None:
        """Add what effects push the robot with to the forces, in place."""
        f, g = terms.linear.f, terms.geometry
        push = Push(self._posture, now.T_odom_sole[:3, :3] if self._free is None else self._R_odom_sole)
        for effect in self._pushing:
            effect.push(push, now)
        f[: g.J.shape[1]] += push.force @ g.J[:3] + push.moment @ g.J[3:]
        f[: g.V.shape[1]] += push.trunk @ g.V

    def _springs(
        self, terms: TrunkTerms, loads: tuple[float, float], state: State, motor_rate: Array
    ) -> tuple[Array, Array, Array]:
        """Stiffness, damping (m, m) and torque (m,) at no deflection of the springs of both legs.

        Args:
            terms: with their geometry.
            loads: weight on the support leg and on the other one [N].
            state: deflections are those of it.
            motor_rate: (nj,) [rad/s].
        """
        foot, springs, posture, g = self._foot, self.model.springs, self._posture, terms.geometry
        K, D, torque = self._K[foot], self._D[foot], self._no_spring_torque
        if springs.nominal:
            return K, D, torque
        motor_rate = motor_rate[self._order[foot]]
        m, n = len(motor_rate), len(motor_rate) // 2
        K, D, torque = K.copy(), D.copy(), torque.copy()
        deflection, rate = state.y[:m] - terms.theta, state.w[:m] - motor_rate
        other_com = posture.R[foot.other].T @ (posture.com - posture.p[foot.other])
        for side, part, J, com, load in (
            (foot, slice(0, n), g.J[:, :n], g.com, loads[0]),
            (foot.other, slice(n, m), g.J_other, other_com, loads[1]),
        ):
            leg = springs.leg(side, J, com, load, deflection[part], rate[part], motor_rate[part])
            K[part, part], D[part, part], torque[part] = leg.K_q, leg.D_q, leg.torque
        return K, D, torque


def copied(state: State) -> State:
    """A state of its own."""
    return State(state.y.copy(), state.w.copy(), state.P.copy())
