# SPDX-License-Identifier: BSD-3-Clause
"""Inverse kinematics of a plan: COM, soles and a level trunk to the configuration of the whole robot, by Newton."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..base.compiled import Held, all_finite, apply, compiled, hold, inverse_positive, mul
from ..base.types import Array, Booleans, Foot, Integers, Reference
from ..robot.robot import Robot

_ITERATIONS = 30
_LONGEST = 0.3  # [rad], [m] of one iteration: the first ones may come from far
_DAMPING = 1e-9  # [m^2], [rad^2], where legs are stretched
_REACHED = 1e-8  # [m], [rad]: accelerations are second differences over some milliseconds
_NEAR = 1e-6  # [m], [rad]: from here one step more gets there, as what it leaves is of second order
_FAR = 0.3  # [m] from which on the robot is carried there before it bends


class _Task(NamedTuple):
    """Where COM and frames are, in odom, and how they move; views of Pinocchio's data."""

    com: Array  # (3,) [m]
    J_com: Array  # (3, nv)
    J: Array  # (6, nv) velocity of the point at the origin of odom that moves with what a joint carries
    R_left: Array  # (3, 3)
    p_left: Array  # (3,) [m]
    R_right: Array
    p_right: Array
    R_trunk: Array
    free: Integers  # (k,) columns of root link and legs
    carried: Booleans  # (3, k) whether they move left sole, right sole and trunk


class PlannedPosture:
    """Solves for root link and legs; joints outside the legs are given.

    Attributes:
        model, data: Pinocchio's model of the robot and its state.
        q: configuration of the last solution, from which the next one starts.
    """

    def __init__(self, robot: Robot, gravity: float) -> None:
        """`gravity` [m/s^2] acts along -z of odom."""
        self.robot = robot
        self.model = robot.model.copy()
        self.model.gravity.linear = np.array([0.0, 0.0, -gravity])
        self.data = self.model.createData()
        self.q = pin.neutral(self.model)
        legs = np.concatenate((robot.leg_columns[Foot.LEFT], robot.leg_columns[Foot.RIGHT]))
        places = {joint.idx_v: range(joint.idx_q, joint.idx_q + joint.nq) for joint in self.model.joints}
        self._leg_places = np.array([place for column in legs for place in places[column]])
        self._step = np.zeros(self.model.nv)
        self._task = hold(self._views(np.concatenate((np.arange(6), legs))))
        self._turned = self._turn_of_trunk()
        # Compiled or loaded now, not in a walk.
        _newton(self._step, self._task, np.zeros(3), np.eye(4), np.eye(4), self._turned)

    def _views(self, free: Integers) -> _Task:
        robot, model, data = self.robot, self.model, self.data
        pin.jacobianCenterOfMass(model, data, self.q, False)  # its containers keep their addresses from now on
        frames = robot.sole_ids[Foot.LEFT], robot.sole_ids[Foot.RIGHT], robot.base_id
        above = [list(model.supports[model.frames[frame].parentJoint])[1:] for frame in frames]
        moving = [[model.joints[j].idx_v + i for j in joints for i in range(model.joints[j].nv)] for joints in above]
        left, right, trunk = (data.oMf[frame] for frame in frames)
        return _Task(
            data.com[0], data.Jcom, data.J, left.rotation, left.translation, right.rotation, right.translation,
            trunk.rotation, free, np.array([np.isin(free, columns) for columns in moving]),
        )  # fmt: skip

    def _turn_of_trunk(self) -> float:
        """Yaw [rad] of the trunk's x against that of the soles, by quarters: its x need not point forward."""
        pin.framesForwardKinematics(self.model, self.data, pin.neutral(self.model))
        left, right, trunk = (
            self.data.oMf[frame].rotation
            for frame in (self.robot.sole_ids[Foot.LEFT], self.robot.sole_ids[Foot.RIGHT], self.robot.base_id)
        )
        ahead = trunk.T @ (left[:, 0] + right[:, 0])
        return float(-0.5 * np.pi * np.round(np.arctan2(ahead[1], ahead[0]) / (0.5 * np.pi)))

    def start(self, joints: Array) -> None:
        """Begin at joint positions (nj,) [rad]: knees bend as there, and joints outside the legs stay there."""
        self.robot.scatter(joints, self.q)

    def hold(self, joints: Array) -> None:
        """Bring the joints outside the legs to those of (nj,) [rad]; the next solution has them there."""
        legs = self.q[self._leg_places].copy()
        self.robot.scatter(joints, self.q)
        self.q[self._leg_places] = legs

    def solve(self, plan: Reference) -> bool:
        """Bring the robot to where the plan has COM and soles, its trunk level.

        Returns:
            Whether the legs reach it; if not, `q` is as before.
        """
        model, data, before = self.model, self.data, self.q
        left, right = plan.T_odom_left, plan.T_odom_right
        if not (all_finite(plan.com) and all_finite(left.ravel()) and all_finite(right.ravel())):
            return False
        far = plan.com - pin.centerOfMass(model, data, self.q)
        if np.abs(far).max() > _FAR:  # odom has begun again, or elsewhere
            self.q = np.concatenate((self.q[:3] + far, self.q[3:]))
        for _ in range(_ITERATIONS):
            pin.jacobianCenterOfMass(model, data, self.q, False)
            pin.updateFramePlacements(model, data)
            off = _newton(self._step, self._task, plan.com, left, right, self._turned)
            if off < _REACHED:
                return True
            self.q = pin.integrate(model, self.q, self._step)
            if off < _NEAR:
                return True
        self.q = before
        return False


@compiled
def _newton(step: Array, held: Held, com: Array, left: Array, right: Array, turned: float) -> float:
    """The step (nv,) towards a COM (3,), poses of both soles (4, 4), and a trunk that is level between them.

    turned: yaw of the trunk's x against that of the soles [rad].

    Fills in `step`, the shortest one that leads there from where the held `_Task` is, and returns the largest error
    [m], [rad].
    """
    task = held.value
    k, free = task.free.shape[0], task.free
    off, A, trunk, at = np.empty(18), np.zeros((18, k)), np.zeros((3, 3)), np.zeros(3)
    x, y = left[0, 0] + right[0, 0], left[1, 0] + right[1, 0]
    yaw = np.arctan2(y, x) + turned
    trunk[0, 0] = trunk[1, 1] = np.cos(yaw)
    trunk[1, 0], trunk[0, 1], trunk[2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    _turn(off[6:9], left, task.R_left)
    _turn(off[12:15], right, task.R_right)
    _turn(off[15:], trunk, task.R_trunk)
    for i in range(3):
        off[i], off[3 + i] = com[i] - task.com[i], left[i, 3] - task.p_left[i]
        off[9 + i] = right[i, 3] - task.p_right[i]
        for j in range(k):
            A[i, j] = task.J_com[i, free[j]]
    for frame in range(3):
        if frame < 2:
            at = task.p_left if frame == 0 else task.p_right
        for j in range(k):
            if not task.carried[frame, j]:
                continue
            c = free[j]
            for i in range(3):
                a, b, row = (i + 1) % 3, (i + 2) % 3, 3 + 6 * frame + i
                if frame == 2:
                    A[row, j] = task.J[3 + i, c]
                else:
                    A[row, j] = task.J[i, c] + task.J[3 + a, c] * at[b] - task.J[3 + b, c] * at[a]
                    A[row + 3, j] = task.J[3 + i, c]
    square = mul(A, A.T.copy())  # by rows: several times faster
    for i in range(18):
        square[i, i] += _DAMPING
    shortest, most = apply(A.T, apply(inverse_positive(square), off)), 0.0
    for j in range(k):
        most = max(most, abs(shortest[j]))
    for j in range(k):
        step[free[j]] = shortest[j] * min(1.0, _LONGEST / most)
    return np.abs(off).max()


@compiled
def _turn(out: Array, wanted: Array, R: Array) -> None:
    """Fill in the rotation vector (3,) [rad] that turns R (3, 3) to `wanted` (3, 3) or more, both in the same axes."""
    T = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                T[i, j] += wanted[i, k] * R[j, k]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        out[i] = 0.5 * (T[b, a] - T[a, b])
    sine, cosine = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2), 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-6:
        out *= angle / sine
    elif cosine < 0.0:  # half a turn, about the longest row of (T + 1) / 2
        i = 0
        for row in range(1, 3):
            i = row if T[row, row] > T[i, i] else i
        T[i, i] += 1.0
        out[:] = angle / np.sqrt(T[i, 0] ** 2 + T[i, 1] ** 2 + T[i, 2] ** 2) * T[i]
