# SPDX-License-Identifier: BSD-3-Clause
"""By how much the springs will give way under the planned load: what motors have to lead the planned joints by.

Nothing that is measured enters, and that is what makes it fit for a controller. A deflection that is measured, or
predicted from a measured state, depends on what the motors do; a lead that follows it makes the springs stiffer by
1 / (1 - gain), and with both feet on the ground that stiffness acts against the other leg: the forces by which the feet
push against each other grow by as much, until a foot slides. The plan has no such forces.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import pinocchio as pin

from ..base.compiled import compiled
from ..base.types import Array, Foot, Phase, PlannedDeflection, Reference
from ..config.schema import Config
from ..effects.catalogue import build_effects
from ..gait.load_share import share_one
from ..model.springs import Springs
from ..robot.leg import leg_jacobian
from ..robot.robot import Robot
from .posture import PlannedPosture

_SPACING_NS = 10_000_000  # between points of the plan that are used: accelerations are second differences
_GAP_NS = 100_000_000  # a plan that has a gap, or goes back, begins again
_JUMP = 0.05  # [m] and so does one whose COM jumps


class Feedforward:
    """Planned deflections of one robot, from the points of `com/reference` as they come.

    Attributes:
        started: whether `start` was called.
        loads: vertical loads (2,) of the left and the right foot [N] at the last one.

    Example:
        >>> import coman_reduced_model as coman
        >>> from coman_reduced_model.core.feedforward.feedforward import Feedforward
        >>> with coman.Session(coman.bag_path("test1")) as session:
        ...     feedforward = Feedforward(session.robot, session.config)
        ...     for sample in session.samples():
        ...         feedforward.start(sample.q)
        ...         planned = sample.reference and feedforward.update(sample.reference)
        ...         if planned:
        ...             break
        >>> planned.deflection.shape
        (12,)
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        """Springs, masses and effects are those of the configuration.

        Raises:
            ConfigError: an effect does not fit the robot.
        """
        config = config.with_joints_of(robot)
        effects, robot = build_effects(config.effects, robot)
        self._prepare(robot, Springs(config.robot, effects, False), config.robot.gravity)

    @classmethod
    def of(cls, robot: Robot, springs: Springs, gravity: float) -> Feedforward:
        """For a robot that carries what effects load it with, and its springs; `gravity` [m/s^2]."""
        made = cls.__new__(cls)
        made._prepare(robot, springs, gravity)
        return made

    def _prepare(self, robot: Robot, springs: Springs, gravity: float) -> None:
        self._robot, self._springs, self._gravity = robot, springs, gravity
        self._posture = PlannedPosture(robot, self._gravity)
        self._columns = np.concatenate((robot.leg_columns[Foot.LEFT], robot.leg_columns[Foot.RIGHT]))
        self._stiffness, self._damping = (
            np.concatenate((of[Foot.LEFT], of[Foot.RIGHT])) for of in (springs.stiffness, springs.damping)
        )
        data = self._posture.data
        root = data.oMi[1]
        self._carried = data.J, root.rotation, root.translation  # views: their containers keep their addresses
        self.started = False
        self.loads = np.zeros(2)
        zero = np.zeros(3)
        at_rest = Reference(0, zero, zero, zero, zero, np.eye(4), np.eye(4), Phase.DOUBLE, 0)
        self._torques(at_rest, self._posture.q, *np.zeros((2, robot.model.nv)))  # compiled or loaded now, not in a walk
        self.reset()

    def reset(self) -> None:
        """Forget the points so far."""
        self._points: deque[tuple[Reference, Array]] = deque(maxlen=3)
        self._last: PlannedDeflection | None = None

    def start(self, joints: Array) -> None:
        """Begin at joint positions (nj,) [rad] near the first point of the plan; later calls change nothing.

        Measured ones will do: they only say which way the knees bend, and where joints outside the legs stay.
        """
        if not self.started:
            self._posture.start(joints)
            self.started = True

    def set_surroundings(self, joints: Array, down: Array) -> None:
        """Joints (nj,) [rad] of which those outside the legs are kept, and gravity's direction (3,), from now on."""
        self._posture.hold(joints)
        self._posture.model.gravity.linear = self._gravity * down

    @property
    def planned(self) -> tuple[Reference, Array, Array]:
        """The point of the last deflection, its configuration (nq,) of the model and its velocities (nv,)."""
        (_, q0), (middle, q1), (_, q2) = self._points
        before, after = (self._points[i + 1][0].stamp_ns - self._points[i][0].stamp_ns for i in range(2))
        return middle, q1, pin.difference(self._posture.model, q0, q2) / ((before + after) * 1e-9)

    def update(self, plan: Reference) -> PlannedDeflection | None:
        """Take the next point of the plan.

        Points closer than 10 ms to the last one that was used are left out.

        Returns:
            The deflection at the point before: its accelerations need its neighbours. None: it is the first one, has
            been left out, plans no support, is out of reach of the legs, or jumps: no feet push a COM faster than g.
        """
        if self._points and not self._continues(plan):
            if 0 <= plan.stamp_ns - self._points[-1][0].stamp_ns < _SPACING_NS - 1000:
                return None
            self.reset()
        if not self.started or plan.phase == Phase.FLIGHT or not self._posture.solve(plan):
            self.reset()
            return None
        self._points.append((plan, self._posture.q.copy()))
        if len(self._points) < 3:
            return None
        (first, q0), (middle, q1), (last, q2) = self._points
        model = self._posture.model
        before, after = (middle.stamp_ns - first.stamp_ns) * 1e-9, (last.stamp_ns - middle.stamp_ns) * 1e-9
        change = (last.com - middle.com) / after - (middle.com - first.com) / before
        if np.linalg.norm(change) > 0.5 * (before + after) * self._gravity:  # planned anew, or a point that is off
            self.reset()
            self._points.append((plan, q2))
            return None
        v0, v1 = pin.difference(model, q0, q1) / before, pin.difference(model, q1, q2) / after
        v = (after * v0 + before * v1) / (before + after)
        torque, self.loads = self._torques(middle, q1, v, 2.0 * (v1 - v0) / (before + after))
        deflection = self._deflections(torque, self.loads, before)
        self._last = PlannedDeflection(middle.stamp_ns, deflection, torque)
        return self._last

    def _continues(self, plan: Reference) -> bool:
        last = self._points[-1][0]
        near = all(abs(moved) < _JUMP for moved in (plan.com - last.com).tolist())
        return near and _SPACING_NS - 1000 <= plan.stamp_ns - last.stamp_ns < _GAP_NS

    def _torques(self, plan: Reference, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Torques (m,) [Nm] of the legs' joints in the planned motion, and the vertical loads (2,) of the feet [N]."""
        model, data = self._posture.model, self._posture.data
        needed = pin.rnea(model, data, q, v, a)
        pin.jacobianCenterOfMass(model, data, q, False)
        torque, loads = np.empty(len(self._columns)), np.empty(2)
        legs = self._columns, len(self._robot.legs[Foot.LEFT])
        _bear(needed, *self._carried, plan.T_odom_left, plan.T_odom_right, int(plan.phase), legs, torque, loads)
        return torque, loads

    def _deflections(self, torque: Array, loads: Array, dt: float) -> Array:
        """(m,) [rad] of springs that transmit torques (m,), dt [s] after the last ones, by their law at these."""
        data, last = self._posture.data, self._last
        before = np.zeros(len(torque)) if last is None else last.deflection
        if self._springs.nominal:
            damping = self._damping / dt if last is not None else 0.0
            nominal: Array = (damping * before - torque) / (self._stiffness + damping)
            return nominal
        pin.updateFramePlacements(self._posture.model, data)
        com = data.com[0]
        out, n = np.empty(len(torque)), len(self._robot.legs[Foot.LEFT])
        still = np.zeros(len(torque))
        for foot, part, load in zip((Foot.LEFT, Foot.RIGHT), (slice(0, n), slice(n, None)), loads, strict=True):
            sole = data.oMf[self._robot.sole_ids[foot]]
            J = leg_jacobian(data.J, self._robot.leg_columns[foot], com, sole.rotation)
            at = sole.actInv(com)
            leg = self._springs.leg(foot, J, at, load, before[part], still[part], still[part])
            # -torque = K d + D d' + what the law has more, its rate by the implicit Euler rule.
            damping = leg.D_q / dt if last is not None else 0.0 * leg.D_q
            out[part] = np.linalg.solve(leg.K_q + damping, damping @ before[part] - torque[part] - leg.torque)
        return out


@compiled
def _bear(
    needed: Array, J: Array, R: Array, p: Array, T_left: Array, T_right: Array, phase: int, legs: tuple[Array, int],
    torque: Array, loads: Array,
) -> None:  # fmt: skip
    """Fill in torques (m,) [Nm] of the legs' joints, and the vertical loads (2,) of the feet [N].

    Args:
        needed: (nv,) forces of the motion without ground, of which the first six act on the root link.
        J: (6, nv) of `PlannedPosture`.
        R, p: pose (3, 3), (3,) of the root link [m].
        T_left, T_right: (4, 4) of both soles.
        phase: of the plan.
        legs: columns (m,) of their joints, and how many are of the left leg, which are first.
        torque, loads: filled in.
    """
    ground, shares, (columns, n) = np.zeros(6), np.empty((2, 6)), legs
    for i in range(3):
        for j in range(3):
            ground[i] += R[i, j] * needed[j]
            ground[3 + i] += R[i, j] * needed[3 + j]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        ground[3 + i] += p[a] * ground[b] - p[b] * ground[a]
    height = T_left[2, 3] if phase == 1 else T_right[2, 3] if phase == 2 else 0.5 * (T_left[2, 3] + T_right[2, 3])
    share_one(ground, T_left, T_right, phase, height, shares)
    for i in range(columns.shape[0]):
        torque[i] = needed[columns[i]]
        for j in range(6):
            torque[i] -= J[j, columns[i]] * shares[0 if i < n else 1, j]
    loads[0], loads[1] = shares[0, 2], shares[1, 2]
