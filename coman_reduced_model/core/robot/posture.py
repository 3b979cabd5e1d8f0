# SPDX-License-Identifier: BSD-3-Clause
"""The robot at one set of joint positions and velocities."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from ..base.compiled import Held, compiled, hold
from ..base.types import Array, Foot, Integers
from .leg import leg_jacobian


class Jointed(Protocol):
    """What a posture takes of its `Robot`, see there."""

    model: pin.Model
    joint_names: tuple[str, ...]
    idx_v: Integers
    base_id: int
    sole_ids: dict[Foot, int]
    legs: dict[Foot, Array]
    soles: dict[Foot, Array]
    leg_columns: dict[Foot, Array]
    sole_columns: dict[Foot, Array]

    @property
    def mass(self) -> float: ...

    def scatter(self, q: Array, out: Array, /) -> None: ...


def compact(columns: Integers) -> Integers | slice:
    """Indices (n,) as a slice, by which numpy is faster, if each follows the one before."""
    following = len(columns) > 0 and bool((np.diff(columns) == 1).all())
    return slice(int(columns[0]), int(columns[-1]) + 1) if following else columns


class Views(NamedTuple):
    """A posture for compiled functions: arrays of `Posture` by the same names."""

    com: Array
    J: Array
    J_com: Array
    v: Array  # (nv,) velocities of the model
    R_left: Array
    p_left: Array
    R_right: Array
    p_right: Array
    up: Array


class Posture:
    """The robot at one set of joint positions and velocities; `update` refreshes all quantities in place.

    Attributes, all in the base frame (views into Pinocchio's data: copy what is to be kept):
        configuration: (nq,) of the model.
        com: (3,) [m].
        R, p: by foot, rotation (3, 3) and position (3,) [m] of the sole.
        up: (3,) z of the trunk (`robot.base_frame`).
        J: (6, nv) velocity [linear; angular] of the point at the base origin that moves with what a joint carries.
        J_com: (3, nv) velocity of the COM.
        views: of these, held for compiled functions.
        base_in_sole: (6, 3) the root link, from the last `com_in_sole`: rotation and position [m] in the sole frame,
            linear [m/s] and angular velocity [rad/s] in its own axes.
        tilt: (2,) roll and pitch [rad] of the trunk about x, y of that sole, which lies flat.
    """

    def __init__(self, robot: Jointed) -> None:
        self.robot = robot
        self.data = robot.model.createData()
        self.configuration = pin.neutral(robot.model)
        self._v, self._columns = np.zeros(robot.model.nv), compact(robot.idx_v)
        self.base_in_sole, self.tilt = np.full((6, 3), np.nan), np.full(2, np.nan)
        self._orientations: dict[int, Array] = {}
        self.update(np.zeros(len(robot.joint_names)), np.zeros(len(robot.joint_names)))
        # Pinocchio's containers keep their addresses, so that the views stay valid and cost nothing to read.
        self.com, self.J, self.J_com = self.data.com[0], self.data.J, self.data.Jcom
        self._soles = {foot: self.data.oMf[index] for foot, index in robot.sole_ids.items()}
        self.R = {foot: placement.rotation for foot, placement in self._soles.items()}
        self.p = {foot: placement.translation for foot, placement in self._soles.items()}
        self.up = self.orientation(robot.base_id)[:, 2]
        left, right = self._soles[Foot.LEFT], self._soles[Foot.RIGHT]
        soles = left.rotation, left.translation, right.rotation, right.translation
        self.views = hold(Views(self.com, self.J, self.J_com, self._v, *soles, self.up))

    def update(self, q: Array, qd: Array) -> None:
        """Set joint positions (nj,) [rad] and velocities (nj,) [rad/s]."""
        robot = self.robot
        robot.scatter(q, self.configuration)
        self._v[self._columns] = qd
        pin.jacobianCenterOfMass(
            robot.model, self.data, self.configuration, False
        )  # COM, J_com, J, and where the joints are
        pin.updateFramePlacements(robot.model, self.data)

    def orientation(self, frame: int) -> Array:
        """Rotation (3, 3) of any frame of the model; a view."""
        if frame not in self._orientations:
            self._orientations[frame] = self.data.oMf[frame].rotation
        return self._orientations[frame]

    def leg_jacobian(self, foot: Foot) -> Array:
        """The Jacobian of (8), (6, n): see `stiffness.leg_jacobian`."""
        return leg_jacobian(self.J, self.robot.leg_columns[foot], self.com, self.R[foot])

    def com_in_sole(self, foot: Foot) -> tuple[Array, Array]:
        """COM and its velocity (3,), (3,) in the frame of a sole that stands still, flat on the ground."""
        out = np.empty((9, 3))  # what compiled code fills costs less than what it returns
        _com_in_sole(self.views, self.robot.sole_columns[foot], foot == Foot.LEFT, out)
        self.base_in_sole, self.tilt = out[2:8], out[8, :2]
        return out[0], out[1]

    def sole_pose(self, foot: Foot, other: Foot) -> Array:
        """Pose (4, 4) of the sole `other` in the frame of the sole `foot`."""
        T = np.empty((4, 4))
        _pose_in(self.R[foot], self.p[foot], self.R[other], self.p[other], T)
        return T

    def sole_to_sole(self, foot: Foot, other: Foot) -> tuple[Array, Array]:
        """The same as rotation (3, 3) and position (3,)."""
        T = self.sole_pose(foot, other)
        return T[:3, :3], T[:3, 3]


@compiled
def _com_in_sole(held: Held, columns: Array, left: bool, out: Array) -> None:
    at = held.value
    com, J, J_com, v = at.com, at.J, at.J_com, at.v
    R, p = (at.R_left, at.p_left) if left else (at.R_right, at.p_right)
    t0 = t1 = t2 = w0 = w1 = w2 = 0.0  # twist of the sole, by J
    for c in columns:
        t0, t1, t2 = t0 + J[0, c] * v[c], t1 + J[1, c] * v[c], t2 + J[2, c] * v[c]
        w0, w1, w2 = w0 + J[3, c] * v[c], w1 + J[4, c] * v[c], w2 + J[5, c] * v[c]
    v0 = -t0 - (w1 * com[2] - w2 * com[1])
    v1 = -t1 - (w2 * com[0] - w0 * com[2])
    v2 = -t2 - (w0 * com[1] - w1 * com[0])
    for c in range(v.shape[0]):
        v0, v1, v2 = v0 + J_com[0, c] * v[c], v1 + J_com[1, c] * v[c], v2 + J_com[2, c] * v[c]
    for i in range(3):
        out[0, i] = R[0, i] * (com[0] - p[0]) + R[1, i] * (com[1] - p[1]) + R[2, i] * (com[2] - p[2])
        out[1, i] = R[0, i] * v0 + R[1, i] * v1 + R[2, i] * v2
        out[5, i] = -(R[0, i] * p[0] + R[1, i] * p[1] + R[2, i] * p[2])
        for j in range(3):
            out[2 + i, j] = R[j, i]
    out[6, 0], out[6, 1], out[6, 2] = -t0, -t1, -t2
    out[7, 0], out[7, 1], out[7, 2] = -w0, -w1, -w2
    out[8, 0], out[8, 1] = tilt(R, at.up)


@compiled
def tilt(R: Array, up: Array) -> tuple[float, float]:
    """Roll and pitch [rad] of the trunk about x, y of a flat sole, whatever way the axes of root link and trunk point.

    Args:
        R, up: orientation (3, 3) of the sole and z (3,) of the trunk in the base frame.
    """
    x = R[0, 0] * up[0] + R[1, 0] * up[1] + R[2, 0] * up[2]
    y = R[0, 1] * up[0] + R[1, 1] * up[1] + R[2, 1] * up[2]
    z = R[0, 2] * up[0] + R[1, 2] * up[1] + R[2, 2] * up[2]
    return -np.arcsin(max(-1.0, min(1.0, y))), np.arctan2(x, z)


@compiled
def _pose_in(R: Array, p: Array, R_other: Array, p_other: Array, out: Array) -> None:
    for i in range(3):
        out[i, 3] = out[3, i] = 0.0
        for j in range(3):
            out[i, j] = R[0, i] * R_other[0, j] + R[1, i] * R_other[1, j] + R[2, i] * R_other[2, j]
            out[i, 3] += R[j, i] * (p_other[j] - p[j])
    out[3, 3] = 1.0
