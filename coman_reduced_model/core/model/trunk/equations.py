# SPDX-License-Identifier: BSD-3-Clause
"""The equations of motion of `TrunkModel` at a posture: of the robot as it is, or as it is planned to be."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...base.compiled import hold
from ...base.pose import LEVEL
from ...base.types import Array, Foot, Integers
from ...config.schema import Config
from ...effects.catalogue import Effect
from ...effects.hooks import Now, Push
from ...robot.robot import Robot
from ..cartesian import Model
from .contact import ROWS, State, support_share
from .kinematics import (
    Assembled,
    Pose,
    TrunkTerms,
    assemble,
    pose_legs,
    take_posture,
    terms_of,
    terms_size,
)

LIFTED = 0.001  # [m] of all corners above the ground, up to which a foot that lifts still touches it


class Equations:
    """Assembles the equations of motion, one posture after the other.

    Attributes:
        posture: of the last ones.
        order: by foot, indices (m,) of the legs' joints, that leg's first.
        above: indices of the joints outside the legs: waist, arms, head.
    """

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        """Share the effects and constants of the point-mass model."""
        self.robot = robot
        self.model = model
        self.posture = robot.posture()
        self._swing = config.uses("swing_momentum")
        self._pushing = [e for e in model.effects if type(e).push is not Effect.push]
        left, right = robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]
        self.order: dict[Foot, Integers] = {
            Foot.LEFT: np.concatenate((left, right)),
            Foot.RIGHT: np.concatenate((right, left)),
        }
        self._K, self._D = (
            {foot: np.diag(np.concatenate((values[foot], values[foot.other]))) for foot in (Foot.LEFT, Foot.RIGHT)}
            for values in (model.springs.stiffness, model.springs.damping)
        )
        m = len(left) + len(right)
        blocks = np.zeros((2, terms_size(m)))
        even, odd = (terms_of(block, m) for block in blocks)
        # Those of a posture, in turn.
        self._spare = [Assembled(blocks[0], even, hold((even, odd))), Assembled(blocks[1], odd, hold((odd, even)))]
        self._poses = {foot: hold(self._pose(foot)) for foot in (Foot.LEFT, Foot.RIGHT)}
        self._columns = {foot: robot.idx_v[order] for foot, order in self.order.items()}
        self._no_spring_torque = np.zeros(m)
        self._pin = robot.model.copy()
        self._pin.gravity.linear = np.zeros(3)
        self._data = robot.model.createData()
        self._v, self._a = np.zeros((2, robot.model.nv))
        self._no_torque = np.zeros(robot.model.nv)
        self._q, self._rates = np.zeros((2, len(robot.joint_names)))
        self.above = np.setdiff1d(np.arange(len(robot.joint_names)), self.order[Foot.LEFT])
        # Columns of those of them between root link and legs: none, if the legs hang on the root link.
        self._between = np.setdiff1d(robot.sole_columns[Foot.LEFT], robot.leg_columns[Foot.LEFT])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._above_rate: Array | None = None  # (nj,) of joints outside the legs at the last posture [rad/s]
        self._above_twist = np.zeros(6)  # of the root link by them

    def assemble(
        self, now: Now, foot: Foot, state: State, double: bool, ground: Array, down: Array, R_odom_sole: Array,
        before: Assembled | None, motors: tuple[Array, Array, float],
    ) -> Assembled:  # fmt: skip
        """The equations at a state.

        Args:
            now: this sample, for what pushes the robot.
            foot: the support foot.
            state: of it.
            double: whether both feet stand. One that lifts may touch the ground until it is `LIFTED` above it.
            ground: (3,) under the other sole, as in `contact.Sole`.
            down: (3,) direction of gravity in odom.
            R_odom_sole: (3, 3) orientation of the support sole.
            before: those of the posture before; None: there are none.
            motors: positions and speeds (nj,) of all [rad], [rad/s], and the time since the posture before [s].
        """
        motor_q, motor_qd, elapsed = motors
        order, posture, robot = self.order[foot], self.posture, self.robot
        made = self._spare[self._spare[0] is before]
        made.foot, made.double = foot, double
        held, v, a = made.held, self._v, self._a
        pose_legs(made.terms.theta, state.y, state.w, order, motor_q, motor_qd, robot.idx_v, self._q, self._rates, v)
        posture.update(self._q, self._rates)
        dt = elapsed if before is not None and before.foot == foot else 0.0
        take_posture(held, self._poses[foot], ground, state.y, state.w, dt, v, a)
        if before is not None and before.double:
            made.double = double or bool(made.terms.linear.height[ROWS : ROWS + 4].min() < LIFTED)
        made.terms.linear.most[0] = np.inf if double else 0.5 * now.lifting  # toes have two corners
        if down is not LEVEL:
            self._tilt_gravity(made, state.y[-3:], R_odom_sole.T @ down)
        if len(self.above):
            self._move_above(elapsed)
        inertia, tau = pin.crba(self._pin, self._data, posture.configuration), self._no_torque
        if self._swing:  # how the moving masses resist, the joints of the legs not accelerating
            tau = pin.rnea(self._pin, self._data, posture.configuration, v, a)
        weight = self.model.mass * self.model.gravity
        share = support_share(state.P) if made.double else 1.0
        loads = share * weight, (1.0 - share) * weight
        K, D, torque = self._springs(made, loads, state, motor_qd)
        assemble(
            held, inertia, tau, self.model.gravity, self._columns[foot], K, D, torque, loads,
            self.model.springs.gravity_stiffness,
        )  # fmt: skip
        if not self._swing:  # the legs move without reaction
            n, m, M = len(order) // 2, len(order), made.terms.M
            M[:n, n:m] = M[n:m, :n] = M[m:, n:m] = M[n:m, m:] = 0.0
        if self._pushing:
            self._add_push(made.terms, now, R_odom_sole)
        return made

    def _pose(self, foot: Foot) -> Pose:
        """Views of the model's posture, of which that leg is the support leg."""
        posture, robot, other = self.posture, self.robot, foot.other
        columns, edges = robot.idx_v[self.order[foot]], np.array([robot.soles[foot], robot.soles[other]])
        return Pose(
            posture.com, posture.J, posture.J_com, posture.R[foot], posture.p[foot], posture.R[other],
            posture.p[other], columns, edges,
        )  # fmt: skip

    def _tilt_gravity(self, made: Assembled, turned: Array, down: Array) -> None:
        """Fill in `Geometry.down` on a slope, the support sole turned by small angles (3,) [rad] against down (3,)."""
        made.terms.geometry.down[:] = self.posture.R[made.foot] @ (down - np.cross(turned, down))

    def _move_above(self, dt: float) -> None:
        """Move the joints outside the legs, accelerating as their motors did since the last sample.

        The step of the model takes that for its whole length: momentum changes by that of the rates, and their noise
        does not add up. Call after `take_posture`.
        """
        rate, columns = self._rates.copy(), self.robot.idx_v[self.above]
        twist = -self.posture.J[:, self._between] @ self._v[self._between]
        self._v[:6] += twist
        if self._above_rate is not None and dt > 0.0:
            self._a[columns] = (rate - self._above_rate)[self.above] / dt
            self._a[:6] += (twist - self._above_twist) / dt
        else:
            self._a[columns] = 0.0
        self._above_rate, self._above_twist = rate, twist

    def _add_push(self, terms: TrunkTerms, now: Now, R_odom_sole: Array) -> None:
        """Add what effects push the robot with to the forces, in place."""
        f, g = terms.linear.f, terms.geometry
        push = Push(self.posture, R_odom_sole)
        for effect in self._pushing:
            effect.push(push, now)
        f[: g.J.shape[1]] += push.force @ g.J[:3] + push.moment @ g.J[3:]
        f[: g.V.shape[1]] += push.trunk @ g.V

    def _springs(
        self, made: Assembled, loads: tuple[float, float], state: State, motor_rate: Array
    ) -> tuple[Array, Array, Array]:
        """Stiffness, damping (m, m) and torque (m,) at no deflection of the springs of both legs.

        Args:
            made: with their geometry.
            loads: weight on the support leg and on the other one [N].
            state: deflections are those of it.
            motor_rate: (nj,) [rad/s].
        """
        foot, terms, springs, posture = made.foot, made.terms, self.model.springs, self.posture
        g = terms.geometry
        K, D, torque = self._K[foot], self._D[foot], self._no_spring_torque
        if springs.nominal:
            return K, D, torque
        motor_rate = motor_rate[self.order[foot]]
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
