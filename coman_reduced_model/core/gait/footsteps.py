# SPDX-License-Identifier: BSD-3-Clause
"""Where and when the feet step, and how the swing foot gets there.

Poses on the ground are (x, y, yaw) in `odom` [m, m, rad]. Yaw accumulates (it is never wrapped), so that a swing turns
the short way.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from ...errors import ComanError
from ..base.types import Array, Foot, Integers, Phase

if TYPE_CHECKING:
    from .parameters import GaitParameters


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
            share = 1.0 + p.variation * math.sin(math.tau * i / 8.0)
            length, turn = share * p.step_length_m, share * p.turn_rad
            lateral = 2.0 * share * p.lateral_m if share * p.lateral_m * side(swing) > 0.0 else 0.0
            c, s = math.cos(turn / 2), math.sin(turn / 2)  # along the chord of the arc
            body = compose(body, c * length - s * lateral, s * length + c * lateral, turn)
        feet[swing] = compose(body, 0.0, side(swing) * p.step_width_m / 2)
        t_lift = p.stand_before_s + p.double_support_s + i * (p.single_support_s + p.double_support_s)
        steps.append(Footstep(swing, feet[swing], t_lift, t_lift + p.single_support_s))
        swing = stance
    return steps


_IDENTITY = np.eye(4)

# Swing profiles as coefficients of s = 0..1, highest power first. Both have zero velocity and acceleration at lift and
# landing, so that a landing that comes early or late on soft legs is still a gentle one.
_ALONG = np.array([0.0, 6.0, -15.0, 10.0, 0.0, 0.0, 0.0])  # the quintic from 0 to 1
_UP = 64.0 * np.array([-1.0, 3.0, -3.0, 1.0, 0.0, 0.0, 0.0])  # (4 s (1 - s))^3: from 0 over 1 back to 0


class FootMotion:
    """Poses and twists of both soles over the plan: still on the ground, or in a smooth swing (C2)."""

    def __init__(self, p: GaitParameters, left: Array, right: Array, ground: float, steps: list[Footstep]):
        """Args: the gait; standing poses (3,) each; height of the ground [m]; the footsteps."""
        knots = [0.0]
        c = np.zeros((7, 2 * len(steps) + 1, 2, 4))  # power, interval (still, swing, still, ...), foot, x y z yaw
        pose = np.array([[*left[:2], ground, left[2]], [*right[:2], ground, right[2]]])
        self._phase = np.full(2 * len(steps) + 1, int(Phase.DOUBLE))
        for k, step in enumerate(steps):
            knots += [step.t_lift, step.t_land]
            foot, swing = step.foot - 1, 2 * k + 1
            x, y, yaw = step.pose
            target = np.array([x, y, ground, yaw])
            scale = (step.t_land - step.t_lift) ** -np.arange(6.0, -1.0, -1.0)
            c[-1, swing - 1 : swing + 1] = pose
            c[:, swing, foot] += np.outer(_ALONG * scale, target - pose[foot])
            c[:, swing, foot, 2] += _UP * scale * p.step_height_m
            self._phase[swing] = step.foot.other  # the stance foot; Phase and Foot share their numbers
            pose[foot] = target
        c[-1, -1] = pose
        self._switches = np.array(knots[1:])
        self._step = (np.arange(len(knots)) + 1) // 2 - 1
        self._pose = PPoly(c, [*knots, knots[-1] + 1.0])  # still intervals extend to any time
        self._rate = self._pose.derivative()

    def on_floor(self, height: Callable[[Foot, float], float]) -> FootMotion:
        """The same on a floor of that height [m] under a foot whose sole stands at x [m] of odom."""
        feet = copy.copy(self)
        c, knots = self._pose.c.copy(), self._pose.x
        for foot in (0, 1):
            under = np.array([height(Foot(foot + 1), x) for x in c[-1, ::2, foot, 0]])  # while the feet stand
            rise = np.diff(under)
            c[-1, ::2, foot, 2] += under
            c[-1, 1::2, foot, 2] += under[:-1]
            scale = np.diff(knots)[1::2] ** -np.arange(6.0, -1.0, -1.0)[:, None]
            c[:, 1::2, foot, 2] += _ALONG[:, None] * scale * rise
        feet._pose = PPoly(c, knots)
        feet._rate = feet._pose.derivative()
        return feet

    def __call__(self, t: Array) -> tuple[Array, NDArray[np.int_], NDArray[np.int_]]:
        """Poses (n, 2, 4, 4) of the left and right sole, phase (n,) and step index (n,) at the times t (n,) [s]."""
        pose = self._pose(t)
        yaw = pose[..., 3]
        T = np.empty((len(t), 2, 4, 4))
        T[:] = _IDENTITY
        T[..., 0, 0] = T[..., 1, 1] = np.cos(yaw)
        T[..., 1, 0] = sine = np.sin(yaw)
        T[..., 0, 1] = -sine
        T[..., :3, 3] = pose[..., :3]
        interval = self._switches.searchsorted(t, side="right")
        return T, self._phase[interval], self._step[interval]

    def poses(self, t: Array) -> tuple[Array, Integers]:
        """The same at times t (...) [s] as positions and quaternions of both soles (..., 14), with the phase (...)."""
        pose = self._pose(t)
        out = np.zeros((*t.shape, 2, 7))
        out[..., :3] = pose[..., :3]
        out[..., 5], out[..., 6] = np.sin(0.5 * pose[..., 3]), np.cos(0.5 * pose[..., 3])
        return out.reshape(*t.shape, 14), self._phase[self._switches.searchsorted(t, side="right")].astype(np.int64)

    def twists(self, t: Array) -> Array:
        """Linear, then angular velocity (n, 2, 6) of both sole origins along the axes of odom [m/s, rad/s]."""
        twist = np.zeros((len(t), 2, 6))
        twist[..., [0, 1, 2, 5]] = self._rate(t)
        return twist
