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

from ...base.types import Array, Foot, Phase, Sample
from ...config.schema import Config
from ...effects.catalogue import Effect
from ...effects.hooks import Now, Push
from ...measured.odometry import flat
from ...measured.standing import StandingSoles
from ...robot.robot import Robot
from ..cartesian import Model
from ..dynamics import Dynamics
from ..reference import look_ahead, motor_com, plan_ahead
from .contact import ROWS, Linear, Options, State, support_share, switch_support, track
from .kinematics import (
    Geometry,
    Pose,
    TrunkTerms,
    add_gravity,
    base_motion,
    com_and_tilt,
    geometry,
    project_dynamics,
)
from .stride import Stride, swapped

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
        self._ground = self._soles.planes()

    def stop(self) -> None:
        """End the free run and the filter: an input is missing. The last stride is kept."""
        self.state = None
        self._foot = Foot.NONE
        self._free: State | None = None  # free run at the last sample
        self._next: State | None = None  # the same at this sample
        self._filtered: State | None = None  # the measurement
        self._terms: TrunkTerms | None = None
        self._repeated: Array | None = None  # deflections ahead, if the robot repeats its stride
        self._above_rate: Array | None = None  # (nj,) of joints outside the legs at the last sample [rad/s]
        self._above_twist = np.zeros(6)  # of the root link by them
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
            self._ground = self._soles.planes()
        if now.foot != self._foot:
            self._change_leg(now.foot)
        before, first = self._terms, self._filtered is None
        if self._filtered is None:
            self._filtered = self._measured(sample)
        self._terms = self._assemble(now)
        if not first:
            self._step(now, before)
        return True

    def _step(self, now: Now, before: TrunkTerms | None) -> None:
        """Filter and free run to this sample, by its own terms and the motors since the sample before."""
        terms, filtered = self._terms, self._filtered
        assert terms is not None and filtered is not None
        theta = terms.theta
        if before is not None:
            theta = before.theta if before.foot == terms.foot else swapped(before.theta)
        self._next = copied(filtered if self._free is None else self._free)
        finite = track(
            filtered, self._next, terms.linear, terms.M, terms.double, theta, terms.theta,
            now.sample.q[self._order[now.foot]], now.dt, self._options,
        )  # fmt: skip
        if not finite:  # with the free run, at whose posture all terms are taken
            self._filtered = self._measured(now.sample)

    def _measured(self, sample: Sample) -> State:
        """The state by the encoders alone, the support sole level on the ground."""
        order = self._order[self._foot]
        y, w = np.zeros((2, len(order) + 6))
        y[: len(order)], w[: len(order)] = sample.q[order], sample.qd[order]
        return State(y, w, np.zeros(2 * ROWS))

    def switch(self, now: Now, T_odom_sole: Array) -> None:
        """`prepare` has expressed the free run by the new support leg: the joints stay as they are."""

    def restart(self, now: Now) -> None:
        """From the filtered measurement."""
        self._ground = self._soles.planes()
        assert self._filtered is not None
        self._free = copied(self._filtered)
        self._R_odom_sole = now.T_odom_sole[:3, :3]
        self._publish()
        if self.state is None or not np.isfinite(self.state).all():
            # The terms are those of a free run that has left all bounds.
            self.state, self.tilt = np.concatenate((now.com, now.com_vel)), now.tilt

    def advance(self, now: Now) -> None:
        """To where `prepare` has already brought it."""
        self._free = self._next
        self._publish()
        assert self._free is not None and self.state is not None
        if not np.abs(self._free.y[-6:]).max() < _FALLEN:  # over an edge of its sole, in whose frame it stays
            self.state = np.full(6, np.nan)

    def ahead(self, now: Now, horizons: Array) -> Array:
        """Through the stride before, if the robot repeats it.

        Else as planned from here (without a plan as fast as now), while the horizontal deflection fades.
        """
        assert self._terms is not None and self._filtered is not None
        self._stride.add(now, self._terms, self.reference)
        repeated = self._stride.ahead(now, self._terms, self._filtered, horizons)
        self._repeated, self.repeating = None if repeated is None else repeated[:, 3:], repeated is not None
        if repeated is not None:
            return repeated[:, :3]
        plan = plan_ahead(now.sample, now.foot)
        left = np.outer(np.exp(-horizons / _FADES), np.ones(3))  # of the deflection
        left[:, 2] = 1.0  # the sag stays
        left[:, self._following] = 0.0
        moved = np.array([look_ahead(*plan, self.reference_vel, h)[0] for h in horizons])
        return self.reference + moved + left * (now.com - self.reference)

    def deflections(self, now: Now, horizons: int) -> Array:
        """As in `Dynamics`: now by the filter; ahead by the stride before, else as they are now."""
        assert self._terms is not None and self._filtered is not None
        m, order = len(self._terms.theta), self._order[self._foot]
        out = np.empty((1 + horizons, 3 + m))
        off = self._filtered.y[:m] - now.sample.q[order]
        out[0, :3] = now.com - self.reference + self._terms.geometry.J[:3] @ off
        bent = self._filtered.y[:m] - self._terms.theta
        out[0, 3:] = bent if self._foot == Foot.LEFT else swapped(bent)
        out[1:] = out[0] if self._repeated is None else self._repeated
        return out

    def _publish(self) -> None:
        """The free run as COM and tilt."""
        t, free = self._terms, self._free
        assert t is not None and free is not None
        g, R = t.geometry, self._posture.R[Foot(t.foot)]
        values = com_and_tilt(g.com, g.J, R, self._posture.up, free.y - t.linear.y, free.w)
        self.state, self.tilt = values[:6], values[6:]
        self.state[3:] += self._posture.com_in_sole(Foot(t.foot))[1]  # by the joints outside the legs
        for axis in self._following:
            self.state[axis], self.state[3 + axis] = self.reference[axis], self.reference_vel[axis]

    def _change_leg(self, foot: Foot) -> None:
        self._foot, t = foot, self._terms
        if t is None:
            return
        self._R_odom_sole = self._R_odom_sole @ flat(*self._posture.sole_to_sole(Foot(t.foot), foot))[0]
        edges = self.robot.soles[foot]
        if self._filtered is not None:
            self._filtered = switch_support(self._filtered, t.linear, edges)
        if self._free is not None:
            self._free = switch_support(self._free, t.linear, edges)

    def _assemble(self, now: Now) -> TrunkTerms:
        """The equation of motion at the posture of the free run, or of the filter while there is none."""
        sample, foot, order = now.sample, self._foot, self._order[self._foot]
        state = self._filtered if self._free is None else self._free
        assert state is not None and sample.motor_q is not None and sample.motor_qd is not None
        m, theta, columns = len(order), sample.motor_q[order], self.robot.leg_columns
        double = now.support.phase == Phase.DOUBLE
        self._pose(sample.motor_q, sample.motor_qd, state)
        inertia = pin.crba(self._pin, self._data, self._q)
        g = self._geometry(inertia, state)
        self._move_base(g, state.w, now.dt)
        self._move_above(now.dt)
        # How the moving masses resist, the joints of the legs not accelerating.
        tau = pin.rnea(self._pin, self._data, self._q, self._v, self._a) if self._swing else self._no_torque
        weight_down = self.model.gravity * g.down
        M, f = project_dynamics(inertia, tau, weight_down, g.V, g.A, columns[foot], columns[foot.other])
        if not self._swing:  # the legs move without reaction
            n = len(columns[foot])
            M[:n, n:m] = M[n:m, :n] = M[m:, n:m] = M[n:m, m:] = 0.0
        self._add_push(f, g, now)
        share = support_share(state.P) if double else 1.0
        K, D = self._springs(f, g, share, state.y[:m] - theta, state.w[:m], sample.motor_qd[order])
        edges = self.robot.soles[foot.other]
        reach = 0.5 * float(min(edges[1] - edges[0], edges[3] - edges[2]))
        linear = Linear(state.y.copy(), K, D, f, g.C, g.height, reach)
        return TrunkTerms(int(foot), double, theta, M, linear, g)

    def _pose(self, motor_q: Array, motor_qd: Array, state: State) -> None:
        """Set posture, configuration and velocity of the model: legs by the state, other joints by their motors."""
        order = self._order[self._foot]
        q, qd = motor_q.copy(), motor_qd.copy()
        q[order], qd[order] = state.y[: len(order)], state.w[: len(order)]
        above = self._still.copy()
        above[self._above] = qd[self._above]
        self._posture.update(q, above)
        self.robot.scatter(q, self._q)
        self._v[self.robot.idx_v] = qd

    def _geometry(self, inertia: Array, state: State) -> Geometry:
        posture, robot, foot, other = self._posture, self.robot, self._foot, self._foot.other
        pose = Pose(
            self.model.mass, posture.com, inertia, posture.J,
            posture.R[foot], posture.p[foot], robot.leg_columns[foot], robot.soles[foot],
            posture.R[other], posture.p[other], robot.leg_columns[other], robot.soles[other], self._ground[foot],
        )  # fmt: skip
        return geometry(pose, state.y[-6:])

    def _move_base(self, g: Geometry, w: Array, dt: float) -> None:
        before = self._terms
        if before is None or before.foot != self._foot:
            base_motion(g.V, g.A, g.V, g.A, w, 0.0, self._v, self._a)
        else:
            base_motion(g.V, g.A, before.geometry.V, before.geometry.A, w, dt, self._v, self._a)

    def _move_above(self, dt: float) -> None:
        """Move the joints outside the legs, accelerating as their motors did since the last sample.

        The step of the model takes that for its whole length: momentum changes by that of the rates, and their noise
        does not add up. Call after `_move_base`.
        """
        rate = self._still.copy()
        columns = self.robot.idx_v[self._above]
        rate[self._above] = self._v[columns]
        twist = -self._posture.J[:, self._between] @ self._v[self._between]
        self._v[:6] += twist
        if self._above_rate is not None and dt > 0.0:
            self._a[columns] = (rate - self._above_rate)[self._above] / dt
            self._a[:6] += (twist - self._above_twist) / dt
        else:
            self._a[columns] = 0.0
        self._above_rate, self._above_twist = rate, twist

    def _add_push(self, f: Array, g: Geometry, now: Now) -> None:
        """Add what effects push the robot with to the forces f (m + 6,), in place."""
        if not self._pushing:
            return
        R_odom_sole = now.T_odom_sole[:3, :3] if self._free is None else self._R_odom_sole
        push = Push(self._posture, R_odom_sole)
        for effect in self._pushing:
            effect.push(push, now)
        f[: g.J.shape[1]] += push.force @ g.J[:3] + push.moment @ g.J[3:]
        f[: g.V.shape[1]] += push.trunk @ g.V

    def _springs(
        self, f: Array, g: Geometry, share: float, deflection: Array, rate: Array, motor_rate: Array
    ) -> tuple[Array, Array]:
        """Stiffness and damping (m, m) of both legs; what their springs pull besides goes into f (m + 6,), in place.

        Args:
            f: the forces.
            g: the geometry.
            share: of the weight on the support leg.
            deflection, rate, motor_rate: (m,) link minus motor [rad], speed of the links and of the motors [rad/s].
        """
        foot, springs, weight = self._foot, self.model.springs, self.model.mass * self.model.gravity
        loads = (share * weight, (1.0 - share) * weight)
        K, D, n = self._K[foot].copy(), self._D[foot], g.V.shape[1]
        if not springs.nominal:
            D, posture = D.copy(), self._posture
            other_com = posture.R[foot.other].T @ (posture.com - posture.p[foot.other])
            for side, part, J, com, load in (
                (foot, slice(0, n), g.J[:, :n], g.com, loads[0]),
                (foot.other, slice(n, None), g.J_other, other_com, loads[1]),
            ):
                leg = springs.leg(side, J, com, load, deflection[part], rate[part] - motor_rate[part], motor_rate[part])
                K[part, part], D[part, part] = leg.K_q, leg.D_q
                f[: len(rate)][part] -= leg.torque
        add_gravity(g.J, g.J_other, *loads, deflection, K if springs.gravity_stiffness else K.copy(), f)
        return K, D


def copied(state: State) -> State:
    """A state of its own."""
    return State(state.y.copy(), state.w.copy(), state.P.copy())
