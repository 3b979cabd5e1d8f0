# SPDX-License-Identifier: BSD-3-Clause
"""Where and when the feet step, and how the swing foot gets there.

Poses on the ground are (x, y, yaw) in `odom` [m, m, rad]. Yaw accumulates (it is never wrapped), so that a swing turns
the short way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from coman_reduced_model.core.types import Array, Foot
from coman_reduced_model.errors import ComanError

if TYPE_CHECKING:
    from coman_reduced_model.core.gait import GaitParameters


@dataclass(frozen=True, slots=True)
class Footstep:
    """One step: the foot that swings, where it lands, and when it leaves and touches the ground."""

    foot: Foot
    pose: Array  # (3,) x, y, yaw of the sole in odom [m, m, rad]
    t_lift: float  # [s]
    t_land: float  # [s]


def compose(pose: Array, x: float, y: float, yaw: float = 0.0) -> Array:
    """The pose (3,) reached from `pose` by going x, y [m] in its own axes and turning by yaw [rad]."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([pose[0] + c * x - s * y, pose[1] + s * x + c * y, pose[2] + yaw])


def side(foot: Foot) -> float:
    """+1 for the left foot (y to the left), -1 for the right one."""
    return 1.0 if foot == Foot.LEFT else -1.0


def ground_pose(T: Array, name: str) -> tuple[Array, float]:
    """(x, y, yaw) (3,) and height [m] of a flat foot given as a (4, 4) transform.

    Raises:
        ComanError: it is not a finite transform with the sole level within 10 degrees.
    """
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4) or not np.all(np.isfinite(T)) or T[2, 2] < math.cos(math.radians(10.0)):
        raise ComanError(f"{name}: a finite (4, 4) pose of a sole flat on the ground (within 10 degrees) is needed")
    return np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])]), float(T[2, 3])


def place_footsteps(p: GaitParameters, left: Array, right: Array) -> list[Footstep]:
    """Footsteps of a gait from the two standing feet.

    Each foot belongs to a body frame midway between the feet. A step moves the body frame of the stance foot on by the
    step and puts the swing foot at its side; the last step leaves it where it is, which brings the feet together.
    Sideways, the foot that leads moves by two shares and the other one closes up, so that the feet never come closer
    than the step width.

    Args:
        p: the gait.
        left: (3,) x, y, yaw of the left sole before the walk.
        right: (3,) the same of the right sole.
    """
    feet = {Foot.LEFT: left, Foot.RIGHT: right}
    swing = Foot.LEFT if p.first_swing == "left" else Foot.RIGHT
    steps = []
    for i in range(p.steps):
        stance = swing.other
        body = compose(feet[stance], 0.0, -side(stance) * p.step_width_m / 2)
        if i < p.steps - 1:
            lateral = 2.0 * p.lateral_m if p.lateral_m * side(swing) > 0.0 else 0.0
            c, s = math.cos(p.turn_rad / 2), math.sin(p.turn_rad / 2)  # along the chord of the arc
            body = compose(body, c * p.step_length_m - s * lateral, s * p.step_length_m + c * lateral, p.turn_rad)
        feet[swing] = compose(body, 0.0, side(swing) * p.step_width_m / 2)
        t_lift = p.stand_before_s + p.double_support_s + i * (p.single_support_s + p.double_support_s)
        steps.append(Footstep(swing, feet[swing], t_lift, t_lift + p.single_support_s))
        swing = stance
    return steps


class FootMotion:
    """Poses and twists of both soles over the plan: still on the ground, or in a smooth swing (C2)."""

    def __init__(self, p: GaitParameters, left: Array, right: Array, ground: float, steps: list[Footstep]):
        """Args: the gait; standing poses (3,) each; height of the ground [m]; the footsteps."""
        n = len(steps)
        poses = np.empty((n + 1, 2, 3))  # where each foot stands after step k - 1
        poses[0] = left, right
        self._swings = np.zeros((n + 1, 2))  # height of the swing of each foot [m]
        for k, step in enumerate(steps):
            poses[k + 1] = poses[k]
            poses[k + 1, step.foot - 1] = step.pose
            self._swings[k + 1, step.foot - 1] = p.step_height_m
        # Row k + 1 is in force from the lift of step k to the lift of step k + 1, row 0 before the first step.
        self._from = poses[[0, *range(n)]]
        self._delta = poses - self._from
        self.t_lift = np.array([step.t_lift for step in steps])
        self._t_start = np.array([0.0, *self.t_lift])
        self.duration = p.single_support_s
        self.ground = ground
        self.swing_foot = np.array([Foot.NONE, *(step.foot for step in steps)], dtype=int)

    def __call__(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Poses (n, 2, 4, 4) and twists (n, 2, 6) of the left and right sole, phase (n,) and step index (n,) at t (n,).

        Twists are linear, then angular velocity of the sole origin along the axes of odom [m/s, rad/s].
        """
        k = self.t_lift.searchsorted(t, side="right")
        s = np.minimum(np.maximum((t - self._t_start[k]) / self.duration, 0.0), 1.0)
        rest = s * (1.0 - s)
        # Quintic along the ground; s^3 (1 - s)^3 upwards: both with zero velocity and acceleration at lift and landing,
        # so that a landing that comes early or late on soft legs is still a gentle one.
        along = (s * s * s * (10.0 + s * (6.0 * s - 15.0)))[:, None, None]
        up = (64.0 * rest**3)[:, None]
        along_rate = (30.0 * rest * rest / self.duration)[:, None, None]
        up_rate = (192.0 * rest * rest * (1.0 - 2.0 * s) / self.duration)[:, None]
        delta, height = self._delta[k], self._swings[k]
        pose, rate = self._from[k] + delta * along, delta * along_rate
        T = np.zeros((len(t), 2, 4, 4))
        c, si = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        T[..., 0, 0], T[..., 0, 1], T[..., 1, 0], T[..., 1, 1] = c, -si, si, c
        T[..., 2, 2] = T[..., 3, 3] = 1.0
        T[..., :2, 3] = pose[..., :2]
        T[..., 2, 3] = self.ground + height * up
        twist = np.zeros((len(t), 2, 6))
        twist[..., :2], twist[..., 2], twist[..., 5] = rate[..., :2], height * up_rate, rate[..., 2]
        swinging = (k > 0) & (s < 1.0)
        phase = np.where(swinging, 3 - self.swing_foot[k], 3)  # Phase numbers: the stance foot, or DOUBLE
        return T, twist, phase, k - 1
