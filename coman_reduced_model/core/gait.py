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
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from coman_reduced_model.core.footsteps import FootMotion, Footstep, compose, ground_pose, place_footsteps, side
from coman_reduced_model.core.lipm import LipmCom, rest_at_both_ends
from coman_reduced_model.core.types import Array, Foot, Phase, Reference
from coman_reduced_model.errors import ConfigError


def _number(default: float, low: float, high: float, unit: str, description: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": unit, "description": description})


@dataclass(frozen=True)
class GaitParameters:
    """One gait. Units are in the names; bounds and descriptions in the metadata of the fields.

    Raises:
        ConfigError: a value is of the wrong type or out of its range.
    """

    step_length_m: float = _number(
        0.03, -1.0, 1.0, "m", "advance of a step: swing sole lands so far ahead of the stance"
    )
    step_width_m: float = _number(0.1452, 0.02, 1.0, "m", "distance of the sole origins in y")
    step_height_m: float = _number(0.03, 0.0, 0.5, "m", "clearance of the sole in mid-swing")
    single_support_s: float = _number(0.5, 0.05, 60.0, "s", "duration of a swing")
    double_support_s: float = _number(0.2, 0.02, 60.0, "s", "duration of the double support before and after a swing")
    com_height_m: float = _number(0.42, 0.05, 3.0, "m", "height of the COM above the soles, constant")
    steps: int = _number(14, 0, 100_000, "", "number of steps; 0 stands")
    turn_rad: float = _number(0.0, -0.5, 0.5, "rad", "yaw of a step, positive to the left")
    lateral_m: float = _number(0.0, -0.5, 0.5, "m", "mean sideways advance of a step, positive to the left")
    stand_before_s: float = _number(1.0, 0.1, 1e6, "s", "standing before the first load transfer")
    stand_after_s: float = _number(1.0, 0.1, 1e6, "s", "standing after the last load transfer")
    zmp_offset_x_m: float = _number(0.0, -0.5, 0.5, "m", "ZMP ahead of the sole origin")
    zmp_offset_y_m: float = _number(0.0, -0.5, 0.5, "m", "ZMP inwards of the sole origin in single support")
    gravity: float = _number(9.81, 0.1, 100.0, "m/s^2", "acceleration of gravity")
    first_swing: str = field(default="left", metadata={"unit": "", "description": "foot that steps first: left, right"})

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "first_swing":
                if value not in ("left", "right"):
                    raise ConfigError(f"first_swing = {value!r}: allowed: left, right")
                continue
            kind: type | tuple[type, ...] = (int, np.integer) if f.name == "steps" else (int, float, np.number)
            low, high, unit = f.metadata["low"], f.metadata["high"], f.metadata["unit"]
            if isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high:
                what = "an integer" if f.name == "steps" else "a number"
                raise ConfigError(f"{f.name} = {value!r}: allowed: {what}, {low:g} to {high:g} {unit}".rstrip())

    @property
    def omega(self) -> float:
        """Natural frequency of the pendulum sqrt(g / z_c) [rad/s]."""
        return math.sqrt(self.gravity / self.com_height_m)


GAITS: Mapping[str, GaitParameters] = {
    "test1": GaitParameters(),  # the two validation gaits of the paper
    "test2": GaitParameters(step_length_m=0.06, single_support_s=0.6),
    "stand": GaitParameters(steps=0, stand_before_s=5.0, stand_after_s=5.0),
    "in_place": GaitParameters(step_length_m=0.0),
    "backwards": GaitParameters(step_length_m=-0.03),
    "turn": GaitParameters(step_length_m=0.02, turn_rad=0.1),
    "sideways": GaitParameters(step_length_m=0.0, lateral_m=0.015),
    "wide": GaitParameters(step_width_m=0.18),
}


def gait(name: str, **overrides: Any) -> GaitParameters:
    """A gait by its name in `GAITS`, with some parameters changed.

    Raises:
        ConfigError: the gait or a parameter does not exist, or a value is not allowed.
    """
    if name not in GAITS:
        raise ConfigError(f"gait = {name!r}: allowed: {', '.join(GAITS)}")
    values = {f.name: getattr(GAITS[name], f.name) for f in fields(GaitParameters)}
    if unknown := set(overrides) - set(values):
        raise ConfigError(f"{min(unknown)}: no such gait parameter; allowed: {', '.join(values)}")
    return GaitParameters(**(values | overrides))


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
        self.parameters = parameters
        self.footsteps = footsteps
        self.duration_s = float(lipm.times[-1])
        self._feet = feet
        self._lipm = lipm
        self._spline: CubicSpline | None = None  # COM of with_com

    def sample(self, t: float) -> PlanPoint:
        """The plan at time t [s]."""
        many = self.sample_many(np.array([t], dtype=float))
        one = PlanPoint(*(getattr(many, name)[0] for name in PlanPoint.__slots__))
        one.t, one.phase, one.step = float(one.t), Phase(one.phase), int(one.step)
        return one

    def sample_many(self, t: Array) -> PlanPoint:
        """The plan at the times t (n,) [s], vectorised."""
        t = np.asarray(t, dtype=float)
        com, com_vel, com_acc, zmp = self._com(t)
        T, twist, phase, step = self._feet(t)
        return PlanPoint(t, com, com_vel, com_acc, zmp, T[:, 0], T[:, 1], twist[:, 0], twist[:, 1], phase, step)

    def reference(self, t: float, stamp_ns: int, preview_dt: float = 0.0, preview_n: int = 0) -> Reference:
        """The message of the trajectory node for time t [s], with preview_n points at t + preview_dt, ... [s]."""
        com, com_vel, com_acc, zmp = self._com(t + preview_dt * np.arange(preview_n + 1))
        T, _, phase, step = self._feet(np.array([t], dtype=float))
        return Reference(
            stamp_ns,
            com[0],
            com_vel[0],
            com_acc[0],
            zmp[0],
            T[0, 0],
            T[0, 1],
            Phase(int(phase[0])),
            int(step[0]),
            preview_dt if preview_n else 0.0,
            com[1:],
            com_vel[1:],
        )

    def with_com(self, t_grid: Array, com: Array) -> WalkPlan:
        """The same walk with another COM (n, 3) [m] at the times t_grid (n,) [s]: a C2 spline, at rest at its ends.

        For a COM corrected for the mass distribution of a whole robot; ZMP and feet remain those of the plan.
        """
        plan = copy.copy(self)
        plan._spline = CubicSpline(t_grid, com, bc_type="clamped")
        return plan

    def _com(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """COM, its velocity and acceleration, ZMP; each (n, 3)."""
        p, ground = self.parameters, self._feet.ground
        com, com_vel, com_acc, zmp = np.zeros((4, len(t), 3))
        com[:, :2], com_vel[:, :2], zmp[:, :2] = self._lipm(t)
        com_acc[:, :2] = p.omega**2 * (com[:, :2] - zmp[:, :2])
        com[:, 2], zmp[:, 2] = ground + p.com_height_m, ground
        if self._spline is not None:
            inside = np.clip(t, self._spline.x[0], self._spline.x[-1])
            com, com_vel, com_acc = (self._spline(inside, nu) for nu in range(3))
        return com, com_vel, com_acc, zmp


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
    given = [
        ground_pose(T, n) for T, n in ((T_odom_left, "T_odom_left"), (T_odom_right, "T_odom_right")) if T is not None
    ]
    if len(given) == 2:
        (left, z_left), (right, z_right) = given
        ground = (z_left + z_right) / 2
        right[2] = left[2] + math.remainder(right[2] - left[2], math.tau)
    elif T_odom_left is not None:
        left, ground = given[0]
        right = compose(left, 0.0, -width)
    elif T_odom_right is not None:
        right, ground = given[0]
        left = compose(right, 0.0, width)
    else:
        left, right, ground = np.array([0.0, width / 2, 0.0]), np.array([0.0, -width / 2, 0.0]), 0.0
    footsteps = place_footsteps(p, left, right)
    lipm = _com_over(p, left, right, footsteps)
    return WalkPlan(p, footsteps, FootMotion(p, left, right, ground, footsteps), lipm)


def _com_over(p: GaitParameters, left: Array, right: Array, footsteps: list[Footstep]) -> LipmCom:
    """ZMP under the feet, and the COM over it that starts and ends at rest midway between the feet."""
    feet = {Foot.LEFT: left, Foot.RIGHT: right}

    def under(foot: Foot, inwards: float) -> Array:
        return compose(feet[foot], p.zmp_offset_x_m, -side(foot) * inwards)[:2]

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
                f"{key} = {getattr(p, key):g} s is too short: starting or stopping the COM would swing the ZMP out by"
                f" {counter:.3f} m; allowed: half the step width, {p.step_width_m / 2:.3f} m (stand longer)"
            )
    return LipmCom(knots, moved, p.omega)
