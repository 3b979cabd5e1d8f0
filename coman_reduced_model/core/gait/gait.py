# SPDX-License-Identifier: BSD-3-Clause
"""The reference generator: gait parameters -> footsteps -> ZMP -> COM (LIPM) and swing feet.

    plan = plan_walk(gait("test1", com_height_m=0.40))
    point = plan.sample(2.5)                        # com, zmp, sole poses, phase at 2.5 s
    message = plan.reference(2.5, stamp_ns, 0.02, 20)

Everything is in `odom`. Unless the caller says where the feet stand, odom lies on the ground midway between them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from ...errors import ConfigError
from ..base.types import Array, Foot, Phase, PlannedSteps, Reference
from .footsteps import FootMotion, Footstep, compose, ground_pose, place_footsteps, side
from .lipm import LipmCom, rest_at_both_ends
from .parameters import GaitParameters


@dataclass(slots=True)
class PlanPoint:
    """The plan at one time, or at n times (then every field has a leading axis n and phase, step are int arrays).

    Twists are linear, then angular velocity of the sole origin along the axes of odom.
    """

    t: float | Array  # [s] since the start of the plan
    com: Array  # (3,) [m]
    com_vel: Array  # (3,) [m/s]
    com_acc: Array  # (3,) [m/s^2]
    zmp: Array  # (3,) [m], on the ground
    T_odom_left: Array  # (4, 4)
    T_odom_right: Array  # (4, 4)
    left_twist: Array  # (6,) [m/s, rad/s]
    right_twist: Array  # (6,) [m/s, rad/s]
    phase: Any  # Phase
    step: Any  # int: the last step whose swing has begun, from 0; -1 before the first


class WalkPlan:
    """A planned walk from rest to rest: evaluate it at any time; outside 0..duration_s it stands still."""

    def __init__(self, parameters: GaitParameters, footsteps: list[Footstep], feet: FootMotion, lipm: LipmCom):
        """Made by `plan_walk`."""
        self.parameters = parameters
        self.footsteps = footsteps
        self.duration_s = float(lipm.times[-1])
        self._feet = feet
        self._lipm = lipm
        self._corrected: PPoly | None = None  # COM, velocity and acceleration of with_com

    def sample(self, t: float) -> PlanPoint:
        """The plan at time t [s]."""
        many = self.sample_many(np.array([t], dtype=float))
        one = PlanPoint(*(getattr(many, f.name)[0] for f in fields(PlanPoint)))
        one.t, one.phase, one.step = float(one.t), Phase(one.phase), int(one.step)
        return one

    def sample_many(self, t: Array) -> PlanPoint:
        """The plan at the times t (n,) [s], vectorised."""
        t = np.asarray(t, dtype=float)
        com, com_vel, com_acc, zmp = self._com(t).swapaxes(0, 1)
        (T, phase, step), twist = self._feet(t), self._feet.twists(t)
        left, right, left_twist, right_twist = T[:, 0], T[:, 1], twist[:, 0], twist[:, 1]
        return PlanPoint(t, com, com_vel, com_acc, zmp, left, right, left_twist, right_twist, phase, step)

    def reference(self, t: float, stamp_ns: int, preview_dt: float = 0.0, preview_n: int = 0) -> Reference:
        """The message of the trajectory node for time t [s], with preview_n points at t + preview_dt, ... [s]."""
        return self.references(np.array([t], dtype=float), [stamp_ns], preview_dt, preview_n)[0]

    def references(
        self, t: Array, stamps_ns: Sequence[int], preview_dt: float = 0.0, preview_n: int = 0
    ) -> list[Reference]:
        """The same for the times t (n,) [s] with their stamps, at once."""
        times = t[:, None] + preview_dt * np.arange(preview_n + 1.0)
        points = self._com(times.ravel()).reshape(*times.shape, 4, 3)
        T, phase, step = self._feet(t)
        soles, phases = self._feet.poses(times[:, 1:])
        found = []
        for k, stamp_ns in enumerate(stamps_ns):
            com, com_vel, com_acc, zmp = points[k, 0]
            now = Reference(stamp_ns, com, com_vel, com_acc, zmp, T[k, 0], T[k, 1], Phase(phase[k]), int(step[k]))
            if preview_n:
                now.preview_dt, now.preview_com, now.preview_com_vel = preview_dt, points[k, 1:, 0], points[k, 1:, 1]
                now.steps = PlannedSteps(stamp_ns, preview_dt, now.preview_com, soles[k], phases[k])
            found.append(now)
        return found

    def with_com(self, t_grid: Array, com: Array) -> WalkPlan:
        """The same walk with another COM (n, 3) [m] at the times t_grid (n,) [s]: a C2 spline, at rest at its ends.

        For a COM corrected for the mass distribution of a whole robot; ZMP and feet remain those of the plan.
        """
        spline = CubicSpline(t_grid, com, bc_type="clamped")
        derivatives = [np.pad(spline.derivative(n).c, ((n, 0), (0, 0), (0, 0))) for n in range(3)]
        plan = copy.copy(self)
        plan._corrected = PPoly(np.stack(derivatives, axis=2), spline.x)  # one evaluation gives all three
        return plan

    def on_floor(self, height: Callable[[Foot, float], float]) -> WalkPlan:
        """The same walk with its feet on a floor of that height [m] under a foot that stands at x [m] of odom."""
        plan = copy.copy(self)
        plan._feet = self._feet.on_floor(height)
        return plan

    def _com(self, t: Array) -> Array:
        """COM, its velocity, its acceleration and the ZMP: (n, 4, 3)."""
        points = self._lipm(t)
        if self._corrected is not None:
            x = self._corrected.x
            points[:, :3] = self._corrected(np.minimum(np.maximum(t, x[0]), x[-1]))
            points[(t < x[0]) | (t > x[-1]), 1:3] = 0.0
        return points


def plan_walk(
    parameters: GaitParameters, T_odom_left: Array | None = None, T_odom_right: Array | None = None
) -> WalkPlan:
    """Plans a walk.

    Args:
        parameters: the gait.
        T_odom_left: (4, 4) pose of the left sole at the start; the feet are taken as flat, at their mean height.
            Default: step_width_m beside the other foot; if none is given, odom is on the ground between the feet.
        T_odom_right: (4, 4) the same for the right sole.

    Raises:
        ConfigError: the standing time is too short to set off from rest, or to come to rest.
        ComanError: a given pose is not that of a flat foot.
    """
    p = parameters
    width = p.step_width_m
    if T_odom_left is not None:
        left, ground = ground_pose(T_odom_left, "T_odom_left")
        right = compose(left, 0.0, -width)
    else:
        left, right, ground = np.array([0.0, width / 2, 0.0]), np.array([0.0, -width / 2, 0.0]), 0.0
    if T_odom_right is not None:
        right, z_right = ground_pose(T_odom_right, "T_odom_right")
        if T_odom_left is None:
            left, ground = compose(right, 0.0, width), z_right
        ground = (ground + z_right) / 2
        right[2] = left[2] + math.remainder(right[2] - left[2], math.tau)
    footsteps = place_footsteps(p, left, right)
    lipm = _com_over(p, left, right, ground, footsteps)
    return WalkPlan(p, footsteps, FootMotion(p, left, right, ground, footsteps), lipm)


def _com_over(p: GaitParameters, left: Array, right: Array, ground: float, footsteps: list[Footstep]) -> LipmCom:
    """ZMP under the feet, and the COM over it that starts and ends at rest midway between the feet."""
    feet = {Foot.LEFT: left, Foot.RIGHT: right}

    def under(foot: Foot, inwards: float) -> Array:
        x, y, _ = compose(feet[foot], p.zmp_offset_x_m, -side(foot) * inwards)
        return np.array([x, y, ground])

    def middle() -> Array:
        return (under(Foot.LEFT, 0.0) + under(Foot.RIGHT, 0.0)) / 2

    times, zmp = [0.0, p.stand_before_s / 2, p.stand_before_s], [middle()] * 3
    for step in footsteps:
        times += [step.t_lift, step.t_land]
        zmp += [under(step.foot.other, p.zmp_offset_y_m)] * 2
        feet[step.foot] = step.pose
    end = times[-1] + (p.double_support_s if footsteps else 0.0)
    if footsteps:
        times.append(end)
        zmp.append(middle())
    times += [end + p.stand_after_s / 2, end + p.stand_after_s]
    zmp += [middle()] * 2
    knots, planned = np.array(times), np.array(zmp)
    moved = rest_at_both_ends(knots, planned, p.omega, (1, -2))
    for key, i in (("stand_before_s", 1), ("stand_after_s", -2)):
        counter = float(np.linalg.norm(moved[i] - planned[i]))
        if counter > p.step_width_m / 2:  # beyond the soles' origins: the robot would topple
            raise ConfigError(
                f"gait: {key}: {getattr(p, key):g} s is too short: the ZMP must swing out by {counter:.3f} m to"
                f" start or stop the COM (allowed: half the step width, {p.step_width_m / 2:.3f} m)"
            )
    return LipmCom(knots, moved, p.com_height_m, p.omega)
