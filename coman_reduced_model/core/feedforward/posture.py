# SPDX-License-Identifier: BSD-3-Clause
"""Inverse kinematics of a plan: COM, soles and a level trunk to the configuration of the whole robot, by Newton."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..base.types import Array, Foot, Reference
from ..robot.robot import Robot

_ITERATIONS = 30
_LONGEST = 0.3  # [rad], [m] of one iteration: the first ones may come from far
_DAMPING = 1e-9  # [m^2], [rad^2], where legs are stretched
_REACHED = 1e-8  # [m], [rad]: accelerations are second differences over some milliseconds


class PlannedPosture:
    """Solves for root link and legs; joints outside the legs are given.

    Attributes:
        model, data: Pinocchio's model of the robot and its state at the last solution: placements, COM, Jacobians.
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
        self._free = np.concatenate((np.arange(6), legs))
        places = {joint.idx_v: range(joint.idx_q, joint.idx_q + joint.nq) for joint in self.model.joints}
        self._leg_places = np.array([place for column in legs for place in places[column]])
        self._frames = (robot.sole_ids[Foot.LEFT], robot.sole_ids[Foot.RIGHT])

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
        soles = (plan.T_odom_left, plan.T_odom_right)
        if not np.isfinite(np.concatenate((plan.com, soles[0].ravel(), soles[1].ravel()))).all():
            return False
        forward = soles[0][:2, 0] + soles[1][:2, 0]
        trunk = pin.utils.rotate("z", float(np.arctan2(forward[1], forward[0])))
        for _ in range(_ITERATIONS):
            pin.jacobianCenterOfMass(model, data, self.q, False)
            pin.updateFramePlacements(model, data)
            error, J = [plan.com - data.com[0]], [data.Jcom]
            for frame, wanted in zip(self._frames, soles, strict=True):
                at = data.oMf[frame]
                error += [wanted[:3, 3] - at.translation, at.rotation @ pin.log3(at.rotation.T @ wanted[:3, :3])]
                J.append(pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED))
            at = data.oMf[self.robot.base_id].rotation
            error.append(at @ pin.log3(at.T @ trunk))
            J.append(pin.getFrameJacobian(model, data, self.robot.base_id, pin.LOCAL_WORLD_ALIGNED)[3:])
            off = np.concatenate(error)
            if np.abs(off).max() < _REACHED:
                return True
            step, A = np.zeros(model.nv), np.vstack(J)[:, self._free]
            step[self._free] = A.T @ np.linalg.solve(A @ A.T + _DAMPING * np.eye(len(off)), off)  # the shortest one
            self.q = pin.integrate(model, self.q, step * min(1.0, _LONGEST / np.abs(step).max()))
        self.q = before
        return False
