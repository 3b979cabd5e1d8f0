# SPDX-License-Identifier: BSD-3-Clause
"""What a robot cannot do: limits of its joints, and of its forces and speeds by weight and leg length."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
import pinocchio as pin

from ..base.types import Array
from .robot import Robot

_BEYOND = 0.5  # of its range that a joint of a leg may be beyond its limits: encoders have zeros, URDFs are guessed
_BEYOND_LEAST = 0.5  # [rad], or half a leg's length: a joint with a small range
_TURN = 2.0 * pi  # [rad] by which other joints may be, whose encoders often are not set to zero at all
_STEP = 0.05  # of its range that a joint may move in no time: noise, and clocks that are not exact
_STEP_LEAST = 0.1  # [rad], or a tenth of a leg's length
_FORCE = 20.0  # weights on a foot: landings of stiff robots take less than ten
_SPEED = 3.0  # times sqrt(g l): the COM of a runner; at 1 a walker's soles leave the ground


@dataclass(frozen=True)
class Limits:
    """Limits that values must exceed by far to be refused: what is beyond contradicts physics or the URDF.

    Arrays are in the order of `Robot.joint_names`, infinite where nothing is known; rad, or m where a joint slides.

    Attributes:
        lower, upper: positions (nj,).
        step: (nj,) that a joint may move in no time, beside `speed` times the time.
        speed: (nj,) a turn in the time sqrt(l / g) in which the robot falls [1/s].
        force: [N] on a foot.
        moment: [Nm] on a foot.
        com_speed: [m/s] of the COM past a sole.
        reach: [m] of the COM from a sole.
        gravity: [m/s^2].
    """

    lower: Array
    upper: Array
    step: Array
    speed: Array
    force: float
    moment: float
    com_speed: float
    reach: float
    gravity: float


def limits_of(robot: Robot, gravity: float, weight: float) -> Limits:
    """The limits of a robot, by its URDF, its weight [N] and the length of its legs."""
    length = leg_length(robot)
    lower, upper = joint_limits(robot)
    legs = {*robot.config.leg_joints}
    ours = np.array([name in legs for name in robot.joint_names])
    slides = _slides(robot)
    turns = np.isinf(upper - lower)
    unit = np.where(slides, length, 1.0)
    span = np.where(turns, 0.0, upper - lower)
    beyond = np.maximum(_BEYOND * span, _BEYOND_LEAST * unit) + np.where(ours, 0.0, _TURN * unit)
    step = np.maximum(_STEP * span, _STEP_LEAST * unit)
    speed = unit * _TURN / sqrt(length / gravity)
    # A joint without limits may count its turns or begin again after one, and may be a wheel or a spinning sensor.
    speed[turns & ~ours] = np.inf
    step[turns] = np.inf
    return Limits(
        lower - beyond, upper + beyond, step, speed, _FORCE * weight, _FORCE * weight * length,
        _SPEED * sqrt(gravity * length), 4.0 * length, gravity,
    )  # fmt: skip


def joint_limits(robot: Robot) -> tuple[Array, Array]:
    """Lower and upper limits (nj,) of the URDF; infinite where it has none, or both at one place."""
    model = robot.model
    lower, upper = np.full((2, len(robot.joint_names)), np.inf)
    lower *= -1.0
    for i, name in enumerate(robot.joint_names):
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:  # else it is continuous
            low, high = (float(side[joint.idx_q]) for side in (model.lowerPositionLimit, model.upperPositionLimit))
            if high - low > 0.0 and np.isfinite(high - low):
                lower[i], upper[i] = low, high
    return lower, upper


def leg_length(robot: Robot) -> float:
    """Length [m] of a stretched leg, the longer one: from joint to joint and on to the sole."""
    model, lengths = robot.model, []
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    for foot, sole in robot.sole_ids.items():
        joints = [model.getJointId(robot.joint_names[i]) for i in robot.legs[foot]]
        points = np.array([*(data.oMi[joint].translation for joint in joints), data.oMf[sole].translation])
        lengths.append(float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))
    return max(*lengths, 0.01)


def _slides(robot: Robot) -> Array:
    kinds = [robot.model.joints[robot.model.getJointId(name)].shortname() for name in robot.joint_names]
    return np.array(["JointModelP" in kind for kind in kinds])
