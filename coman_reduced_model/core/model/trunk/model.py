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
nothing that is measured. A joint outside the legs without a motor stream has its link position for that of its motor.
"""

from __future__ import annotations

import numpy as np

from ...base.compiled import hold
from ...base.pose import LEVEL
from ...base.types import Array, Flags, Foot, Phase, Sample
from ...config.schema import Config
from ...effects.hooks import Now
from ...measured.odometry import flat
from ...measured.standing import StandingSoles
from ...robot.robot import Robot
from ..cartesian import Model
from ..dynamics import Dynamics
from ..reference import Plan, faded, motor_com
from .contact import ROWS, Options, State, switch_support
from .equations import Equations
from .kinematics import Assembled, advance
from .planned import PlannedWalk
from .published import Seen, publish
from .stride import Stride

# Bandwidth of the filter that follows the measured joints. Below it the encoders are believed (0.4 mrad of quantisation
# noise), above it the model: the velocity it gives has no lag, other than a slope over past samples.
_FILTER = 20.0  # [rad/s]
_LONGEST = 0.005  # [s] of the implicit steps: a foot leaves or meets the ground between two of them
_FADES = 0.1  # [s] time constant of a horizontal deflection whose future is not known


class TrunkModel(Dynamics):
    """Free run and filtered measurement of the trunk's six freedoms and of the other leg."""

    def __init__(self, robot: Robot, config: Config, model: Model) -> None:
        """Share the effects and constants of the point-mass model."""
        super().__init__()
        self.robot = robot
        self.model = model
        self.motor = robot.posture()
        self._equations = Equations(robot, config, model)
        friction = config.model.friction
        self._options = Options(friction, _LONGEST, _FILTER)
        self._following = [axis for axis in range(3) if axis not in model.axes]
        self._felt = np.isin(range(3), model.axes)
        self._order, self._posture = self._equations.order, self._equations.posture
        self._above = len(self._equations.above) > 0
        self._soles = StandingSoles()
        self._stride = Stride(friction, np.array([robot.soles[Foot.LEFT], robot.soles[Foot.RIGHT]]))
        self._planned = PlannedWalk(robot, config, model)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.stop()
        self._stride.reset()
        self._planned.forget()
        self._soles.reset()
        self._ground, self.flags = self._soles.planes(), Flags.OK

    def stop(self) -> None:
        """End the free run and the filter: an input is missing. The last stride is kept."""
        self.state = None
        self._foot = Foot.NONE
        self._free: State | None = None  # the free run
        self._filtered: State | None = None  # the measurement
        self._states: tuple[State, State] | None = None  # both, as they are held for compiled functions
        self._terms: Assembled | None = None
        self._ahead: Array | None = None  # deflections ahead, if stride or plan say them
        self._equations.reset()
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
        if first:  # compiled or loaded now, not in the middle of a walk
            switch_support(self._filtered, terms.terms.linear, self.robot.soles[now.foot])
        if first:
            self._publish(now)
        elif not self._advance(now, terms, before or terms):  # no longer finite, nor is the free run,
            self._filtered = self._measured(sample)  # at whose posture all terms are taken
            self._publish(now)
        return True

    def _advance(self, now: Now, terms: Assembled, before: Assembled) -> bool:
        """Filter and free run to this sample, by its own terms and the motors since the sample before."""
        same, order, seen = before.foot == terms.foot, self._order[self._foot], self._seen(now)
        finite: bool = advance(
            terms.held, same, self._held, now.sample.q, order, terms.double, now.dt, seen, self._published
        )
        return finite

    def _publish(self, now: Now) -> None:
        """What is published of states that `_advance` has not brought here."""
        assert self._terms is not None
        seen = self._seen(now)
        publish(self._published, self._terms.held, self._held, now.sample.q, self._order[self._foot], seen)

    def _seen(self, now: Now) -> Seen:
        """What `publish` needs, room for what it fills in being made and the states being held."""
        filtered, foot = self._filtered, self._foot
        assert filtered is not None
        states = filtered, copied(filtered) if self._free is None else self._free
        if self._states is None or states[0] is not self._states[0] or states[1] is not self._states[1]:
            self._states, self._held = states, hold((states, self._options))
        self._published = np.empty(11 + len(self._order[foot]))
        return self._posture.R[foot], self._posture.up, now.com, self.reference, foot == Foot.LEFT

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
        if now.support.phase == Phase.DOUBLE and not now.restarts:
            self._land(now)
        self._ground, self._down = self._soles.planes(), now.down
        assert self._filtered is not None
        self._free = copied(self._filtered)
        self._R_odom_sole = now.T_odom_sole[:3, :3]
        self._publish(now)
        self.advance(now)
        if self.state is None or not np.isfinite(self.state).all():
            # The terms are those of a free run that has left all bounds.
            self.state, self.tilt = np.concatenate((now.com, now.com_vel)), now.tilt

    def advance(self, now: Now) -> None:
        """`prepare` has already brought it there."""
        self.state, self.tilt = self._published[:6], self._published[6:8]
        if self._above:
            self.state[3:] += self._posture.com_in_sole(self._foot)[1]
        for axis in self._following:
            self.state[axis], self.state[3 + axis] = self.reference[axis], self.reference_vel[axis]

    def ahead(self, now: Now, com: Array, com_vel: Array, plan: Plan, horizons: Array) -> Array:
        """Through the stride before, if the robot repeats it: from the filtered joints, whatever the state handed in.

        Else through what the plan says of COM and feet, from there too; or else as planned from the state handed in
        (without a plan as fast as now), while the horizontal deflection fades, but for a robot that stands or is to.
        """
        assert self._terms is not None and self._filtered is not None
        terms = self._terms
        self._stride.add(now, terms, self.reference)
        self._planned.add(now, self._ground, self._down)
        course = self._stride.ahead(now, terms, self._filtered, horizons)
        self.lag_ns = 0 if course is None else self._stride.repeated_ns
        if course is None:
            course = self._planned.ahead(now, terms, self._filtered, horizons)
        self.stepping = course is not None and not self.repeating
        if course is not None:
            for axis in self._following:  # the plan, without a deflection
                course[:, axis] -= course[:, 3 + axis]
                course[:, 3 + axis] = 0.0
        self._ahead = None if course is None else course[:, 3:]
        if course is not None and len(course) == len(horizons):
            return course[:, :3]
        fading = 0.0 if now.standing or self._planned.stands else 1.0 / _FADES
        out = faded(com, self.reference, self.reference_vel, plan, horizons, fading, self._felt)
        if course is not None:  # as far as the stride goes
            out[: len(course)] = course[:, :3]
        return out

    def deflections(self, now: Now, horizons: int) -> Array:
        """As in `Dynamics`: now by the filter; ahead by the stride before or the plan, else as they are now."""
        out = np.empty((1 + horizons, len(self._published) - 8))
        out[:] = self._published[8:]
        out[:, self._following] = 0.0  # they are at their plan
        if self._ahead is not None:
            out[1 : 1 + len(self._ahead)] = self._ahead
        return out

    def _land(self, now: Now) -> None:
        """Look where the other foot has come down."""
        self._soles.land(now.link, now.foot)
        self.flags = Flags.UNKNOWN_GROUND if self._soles.aslant else Flags.OK

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
        foot, state = self._foot, self._filtered if self._free is None else self._free
        assert state is not None
        R = now.T_odom_sole[:3, :3] if self._free is None else self._R_odom_sole
        double = now.support.phase == Phase.DOUBLE
        if double and now.restarts:  # it presses where it has come down
            self._land(now)
            self._ground = self._soles.planes()
        assert now.sample.motor_q is not None and now.sample.motor_qd is not None
        motors = now.sample.motor_q, now.sample.motor_qd, now.dt
        return self._equations.assemble(now, foot, state, double, self._ground[foot], self._down, R, before, motors)


def copied(state: State) -> State:
    """A state of its own."""
    return State(state.y.copy(), state.w.copy(), state.P.copy())
