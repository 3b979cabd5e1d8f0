# SPDX-License-Identifier: BSD-3-Clause
"""Poses of the links of a URDF, each in the frame of its parent link, as /tf has them: for displays."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..base.types import Array
from .robot import Robot


class Links:
    """All links of a robot but its root; joints with several degrees of freedom are held at zero.

    Attributes:
        moving: names of parent and child where a joint is between them.
        fixed: the same where nothing moves, with the pose (7,) position [m] and quaternion x y z w.
    """

    def __init__(self, robot: Robot) -> None:
        model, numbers = robot.model, {name: number for number, name in enumerate(robot.joint_names)}
        links = [(i, frame) for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
        self.moving: list[tuple[str, str]] = []
        self.fixed: list[tuple[str, str, Array]] = []
        joints, at_zero, motion = [], [], []
        for index, link in links[1:]:
            above = _link_above(model, index)
            placed = above.placement.inverse()
            if link.parentJoint == above.parentJoint:
                self.fixed.append((above.name, link.name, pin.SE3ToXYZQUAT(placed * link.placement)))
                continue
            pose = pin.SE3ToXYZQUAT(placed * model.jointPlacements[link.parentJoint] * link.placement)
            number = numbers.get(model.names[link.parentJoint])
            if number is None:
                self.fixed.append((above.name, link.name, pose))
                continue
            self.moving.append((above.name, link.name))
            joints.append(number)
            at_zero.append(pose)
            motion.append(model.joints[link.parentJoint].createData().S.ravel())
        self._joints = np.array(joints, dtype=np.intp)
        self._at_zero = np.array(at_zero).reshape(-1, 7)
        self._slide, self._axis = np.split(np.array(motion).reshape(-1, 6), 2, axis=1)  # in the frame of the link
        self._slide = _rotate(self._at_zero[:, 3:], self._slide)

    def poses(self, q: Array) -> Array:
        """Poses (n, 7) of the moving links, position [m] and quaternion x y z w, at joint positions (nj,) [rad]."""
        out, at = self._at_zero.copy(), q[self._joints][:, None]
        out[:, :3] += self._slide * at
        v, w = self._at_zero[:, 3:6], self._at_zero[:, 6:]
        s, c = np.sin(0.5 * at) * self._axis, np.where(self._axis.any(axis=1, keepdims=True), np.cos(0.5 * at), 1.0)
        out[:, 3:6] = w * s + c * v + _cross(v, s)
        out[:, 6:] = w * c - (v * s).sum(axis=1, keepdims=True)
        return out


def _link_above(model: pin.Model, index: int) -> pin.Frame:
    above = model.frames[model.frames[index].parentFrame]
    while above.type != pin.FrameType.BODY:
        above = model.frames[above.parentFrame]
    return above


def _cross(a: Array, b: Array) -> Array:
    """Row by row, (n, 3); some times faster than np.cross."""
    return a[:, _NEXT] * b[:, _LAST] - a[:, _LAST] * b[:, _NEXT]


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def _rotate(quaternions: Array, vectors: Array) -> Array:
    """Vectors (n, 3) turned by quaternions (n, 4) x y z w."""
    v, w = quaternions[:, :3], quaternions[:, 3:]
    twice = 2.0 * _cross(v, vectors)
    return vectors + w * twice + _cross(v, twice)
