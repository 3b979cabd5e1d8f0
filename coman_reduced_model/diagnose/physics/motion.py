# SPDX-License-Identifier: BSD-3-Clause
"""Motion of the whole robot from its joints and the soles that stand, for the laws of `balance`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ...core.base.types import Array, Foot, Integers
from ...core.robot.robot import Robot
from ..data.recording import FEET
from ..data.signals import rate_of
from ..data.world import World

LEAST_SHARE = 0.05  # of the weight on a foot, below which where it bears is not known


@dataclass(frozen=True)
class Motion:
    """Smoothed joints at the ticks, and the soles against the trunk.

    Attributes:
        q, qd, qdd: (m, nj).
        R, p: by foot (m, 3, 3), (m, 3) of the sole in the root link's frame.
        trunk: (m, 3) COM of the trunk, where `external_force` pulls, in the root link's frame.
        twist, twist_rate: by foot (m, 6) of the root link, in its frame, if that sole stands still.
        J: by foot (m, 6, nv) of the sole, in its own frame.
        com: (m, 3) by the URDF, in the root link's frame, and com_J (m, 3, nv) by joints.
    """

    q: Array
    qd: Array
    qdd: Array
    R: dict[Foot, Array]
    p: dict[Foot, Array]
    trunk: Array
    twist: dict[Foot, Array]
    twist_rate: dict[Foot, Array]
    J: dict[Foot, Array]
    com: Array
    com_J: Array


def blend(by_foot: dict[Foot, Array], share: Array) -> Array:
    """(m, k) by the load share of the left foot."""
    w = share[:, None]
    blended: Array = w * by_foot[Foot.LEFT] + (1.0 - w) * by_foot[Foot.RIGHT]
    return blended


def motion_of(robot: Robot, smoothed: Array, ticks: Integers) -> Motion:
    """From smoothed positions (n, nj)."""
    rate = rate_of(smoothed)
    q, qd, qdd = smoothed[ticks], rate[ticks], rate_of(rate)[ticks]
    model, m = robot.model, len(q)
    data = model.createData()
    configuration, velocity, acceleration = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    R, p, J = ({foot: np.empty((m, *shape)) for foot in FEET} for shape in ((3, 3), (3,), (6, model.nv)))
    twist, twist_rate = ({foot: np.empty((m, 6)) for foot in FEET} for _ in range(2))
    com, com_J, trunk = np.empty((m, 3)), np.empty((m, 3, model.nv)), np.empty((m, 3))
    body = model.frames[robot.base_id].parentJoint
    for i in range(m):
        robot.scatter(q[i], configuration)
        velocity[robot.idx_v], acceleration[robot.idx_v] = qd[i], qdd[i]
        pin.forwardKinematics(model, data, configuration, velocity, acceleration)
        com_J[i] = pin.jacobianCenterOfMass(model, data, False)
        com[i], trunk[i] = data.com[0], data.oMi[body].act(model.inertias[body].lever)
        for foot, frame in robot.sole_ids.items():
            placement = pin.updateFramePlacement(model, data, frame)
            R[foot][i], p[foot][i] = placement.rotation, placement.translation
            J[foot][i] = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            # What the sole does while the trunk is still is the trunk's to undo; both twists are parallel, so that no
            # term of Coriolis is between them.
            twist[foot][i] = -pin.getFrameVelocity(model, data, frame, pin.WORLD).vector
            twist_rate[foot][i] = -pin.getFrameAcceleration(model, data, frame, pin.WORLD).vector
    return Motion(q, qd, qdd, R, p, trunk, twist, twist_rate, J, com, com_J)


def seen_from(yaw: Array, v: Array) -> Array:
    """A level vector (2,) or (2, m) in axes (m, 2) that are turned by yaw (m,) [rad] against its own."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([c * v[0] + s * v[1], c * v[1] - s * v[0]])


def turned(world: World, foot: Foot, wrench: Array, share: Array) -> Array:
    """(m, 2) [rad] Rotation of a foot about x and y against its moment, by ground and soles that give way.

    Ground is as soft about x as about y. Soles are an even layer, so that length and width of the foot count, and the
    moment about its centre; and the less they are pressed, the softer they are: a foot turns by where it bears its
    load, not by how much that is.

    Args:
        wrench: (m, 6) on the foot, in the frame of its sole.
        share: (m,) of the weight that the foot bears.
    """
    moment = wrench[:, 3:5]
    if not world.softness:
        return np.asarray(world.tilting * moment)
    x0, x1, y0, y1 = world.robot.soles[foot]
    about_centre = moment + 0.5 * wrench[:, 2:3] * np.array([-(y0 + y1), x0 + x1])
    soles = world.softness * np.array([((x1 - x0) / (y1 - y0)) ** 2, 1.0]) / np.hypot(share, LEAST_SHARE)[:, None]
    return np.asarray(world.tilting * moment + soles * about_centre)


def sunk(world: World, foot: Foot, wrench: Array) -> Array:
    """(m,) [m] by which a foot has sunk under its force, by ground and soles that give way.

    A sole that bears at its ends gives way by the square of half its length times as much as it turns about y.

    Args:
        wrench: (m, 6) on the foot, in the frame of its sole.
    """
    x0, x1, *_ = world.robot.soles[foot]
    return np.asarray((world.sinking + world.softness * (0.5 * (x1 - x0)) ** 2) * wrench[:, 2])


def share_of(foot: Foot, left: Array) -> Array:
    """(m,) of the weight that a foot bears, by that of the left one."""
    return left if foot == Foot.LEFT else 1.0 - left


def normal(world: World, R: Array, turn: Array, yaw: Array) -> Array:
    """Against gravity (m, 3) in the root's frame, by a foot on a floor that slopes, on which it has `turned` (m, 2).

    R (m, 3, 3) of its sole in the root's frame, yaw (m,) [rad] in odom.
    """
    roll, pitch = world.slope
    level = seen_from(yaw, np.array([-pitch, roll])) + turn[:, [1, 0]] * [1.0, -1.0]
    up = np.column_stack([level, np.ones(len(R))])
    return np.einsum("nij,nj->ni", R, up / np.linalg.norm(up, axis=1)[:, None])


def yielding_of(
    world: World, wrench: dict[Foot, Array], motion: Motion, ticks: Integers, left: Array
) -> tuple[dict[Foot, Array], dict[Foot, Array]] | None:
    """Twist and its rate (m, 6) that soles moving on soft ground give the root link (its frame); None: hard ground.

    Args:
        wrench: (n, 6) by foot, smoothed.
        left: (n,) share of the left foot.
    """
    if not world.gives_way:
        return None
    twist: dict[Foot, Array] = {}
    twist_rate: dict[Foot, Array] = {}
    for foot in FEET:
        turn = turned(world, foot, wrench[foot], share_of(foot, left))
        first = rate_of(np.column_stack([sunk(world, foot, wrench[foot]), turn]))
        for out, value in ((twist, first), (twist_rate, rate_of(first))):
            sole = np.zeros((len(ticks), 6))
            sole[:, 2:5] = -value[ticks]
            linear, angular = (np.einsum("nij,nj->ni", motion.R[foot], part) for part in (sole[:, :3], sole[:, 3:]))
            out[foot] = np.hstack([linear + np.cross(motion.p[foot], angular), angular])
    return twist, twist_rate


def free_motion(
    world: World,
    motion: Motion,
    up: dict[Foot, Array],
    share: Array,
    yielding: tuple[dict[Foot, Array], dict[Foot, Array]] | None,
) -> tuple[Array, list[tuple[Array, Array, Array]]]:
    """The rotation (m, 3, 3) heading <- root, and m configurations, velocities and accelerations of the model."""
    robot, model = world.robot, world.robot.model
    against, twist, rate = (blend(each, share) for each in (up, motion.twist, motion.twist_rate))
    if yielding is not None:
        twist, rate = twist + blend(yielding[0], share), rate + blend(yielding[1], share)
    z = against / np.linalg.norm(against, axis=1)[:, None]
    x = motion.R[Foot.LEFT][:, :, 0] + motion.R[Foot.RIGHT][:, :, 0]
    x -= np.einsum("ni,ni->n", x, z)[:, None] * z
    x /= np.linalg.norm(x, axis=1)[:, None]
    R = np.stack([x, np.cross(z, x), z], axis=1)
    m = len(R)
    configuration = pin.neutral(model)[None].repeat(m, axis=0)
    velocity, acceleration = np.zeros((m, model.nv)), np.zeros((m, model.nv))
    configuration[:, 3:7] = Rotation.from_matrix(R).as_quat()
    velocity[:, :6], acceleration[:, :6] = twist, rate
    velocity[:, robot.idx_v], acceleration[:, robot.idx_v] = motion.qd, motion.qdd
    for q, out in zip(motion.q, configuration, strict=True):
        robot.scatter(q, out)
    return R, list(zip(configuration, velocity, acceleration, strict=True))


def inertial_forces(model: pin.Model, motion: Sequence[tuple[Array, Array, Array]]) -> Array:
    """Generalised forces (m, nv) of motion and weight."""
    data = model.createData()
    return np.array([pin.rnea(model, data, *each) for each in motion])
