# SPDX-License-Identifier: BSD-3-Clause
"""Structured residuals: laws that hold on any robot, each blind to some effects. No reduced model is involved.

`spring`    motor - link - torque / k - (d / k) rate: the spring law of a joint [rad]
`torque`    measured torque of a joint against inverse dynamics from the ground up [Nm]
`force`     sum of the foot forces against the rate of momentum and weight [N]
`moment`    the same about the COM: the centre of pressure against the motion [Nm]
`feet`      one sole in the frame of the other while both stand: height, roll and pitch, which are zero on a flat
            floor, and y, yaw since touchdown, which do not change [m, rad]
`slide`     how far a sole that has landed moves along its x axis while the other stands still [m]
`tilt`      roll and pitch of the robot by the IMU against kinematics from a flat sole [rad]
`plan`      where the motor side carries the COM against where com/reference plans it, over the stance sole [m]
`landing`   by how much the force on a landing foot goes beyond what it bears before and after, and beyond the jolt of
            any landing: the impulse of a blow [Ns]
`unloaded`  what a foot's sensor reads while the foot is in the air [N, Nm]

`force`, `moment` and `tilt` are along the heading: x level and between the forward axes of both soles, so that feet
turned out cancel, z up. It owes nothing to the axes of the root link or of `robot.base_frame`, which point backwards on
some robots. What stays where it is while the robot turns (pull, slope) is in `odom`, as in the predictor's effects.

All signals pass the same smoothing (Gaussian, zero phase), so that it cancels: before anything else, but after what
changes sign (friction, play, slips). The residuals are taken at TICKS a second; but for `slide` and `landing`, one
value for each landing, from the samples as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from ...core.base.types import Array, Foot, Integers
from ..data.computed import owing_to_wrenches
from ..data.landings import slide_lengths
from ..data.masks import Masks, sure_torque
from ..data.recording import FEET, RATE, WRENCH, Recording
from ..data.signals import SOFTEST, Smoothed, noise_share, rate_of, slipped, smooth, spring_stretch
from ..data.world import World
from .motion import (
    Motion,
    free_motion,
    inertial_forces,
    motion_of,
    normal,
    seen_from,
    share_of,
    sunk,
    turned,
    yielding_of,
)

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class State:
    """All residuals of one recording under one hypothesis, and what they were made of (for the next hypothesis)."""

    recording: Recording
    world: World
    motion: Motion
    up: dict[Foot, Array]
    free: list[tuple[Array, Array, Array]]  # m configurations, velocities and accelerations of the model
    inertial: Array  # (m, nv) generalised forces of motion and weight
    rest: Array  # (m, nv) of them that the ground does not give
    R: Array  # (m, 3, 3) heading <- root
    balance: dict[str, Array]  # residuals of force and moment
    feet: dict[str, Array]  # residuals of the closed loop of the legs
    slid: Array  # (k,) along its x axis, by each foot that landed [m]
    residuals: dict[str, Array]
    smoothed: Smoothed

    def inertial_of(self, model: pin.Model) -> Array:
        """`inertial` of bodies with other masses: linear in what changes."""
        bodies = range(1, model.njoints)
        change = np.concatenate([
            model.inertias[k].toDynamicParameters() - self.world.model.inertias[k].toDynamicParameters() for k in bodies
        ])  # fmt: skip
        which = np.flatnonzero(change)
        return np.asarray(self.inertial + self._regressor[:, :, which] @ change[which])

    @cached_property
    def _regressor(self) -> Array:
        """(m, nv, 10 a body) of `inertial` by the bodies' dynamic parameters."""
        model = self.world.model
        data = model.createData()
        out = np.empty((len(self.free), model.nv, 10 * (model.njoints - 1)))
        for i, each in enumerate(self.free):
            out[i] = pin.computeJointTorqueRegressor(model, data, *each)
        return out


def evaluate(recording: Recording, world: World, where: Masks, before: State | None = None) -> State:
    """Every residual by its name, (m,) at the ticks; NaN where it says nothing.

    Names: `spring/JOINT`, `torque/JOINT`, `force/x`, `moment/x`, `feet/roll`, `tilt/pitch`, `unloaded/left/fz` ...

    Args:
        recording: possibly with other arrays than were measured.
        world: what is believed.
        where: of the measured recording.
        before: a state whose parts are taken over where nothing has changed that they depend on.
    """
    robot, ticks = world.robot, where.ticks
    same_q = before is not None and recording.q is before.recording.q
    slid = before.slid if before and same_q else slide_lengths(world, recording.q, where.slides)
    smoothed = Smoothed(before.smoothed if before else None)
    yaw = {foot: recording.yaw[foot][ticks] for foot in FEET}
    motion = before.motion if before and same_q else motion_of(world.robot, smoothed(recording.q), ticks)
    on_grid = {foot: smoothed(recording.wrench[foot]) for foot in FEET}
    wrench = {foot: value[ticks] for foot, value in on_grid.items()}
    # Soft ground couples the forces into the motion; else motion and weight do not depend on what the sensors read.
    same_ground = before is not None and all(
        _same(world, before.world, name) for name in ("slope", "tilting", "sinking", "softness")
    )
    same_forces = before is not None and recording.wrench is before.recording.wrench
    if before and same_q and same_ground and (same_forces or not world.gives_way):
        up = before.up
    else:
        up = {foot: normal(world, motion.R[foot], _turned(world, foot, wrench, where), yaw[foot]) for foot in FEET}
    if before and up is before.up:
        R, free = before.R, before.free
        inertial = before.inertial if world.model is before.world.model else before.inertial_of(world.model)
    else:
        R, free = free_motion(world, motion, up, where.share, yielding_of(world, on_grid, motion, ticks, where.left))
        inertial = inertial_forces(world.model, free)
    if before and same_forces and inertial is before.inertial and _same(world, before.world, "pull"):
        rest, balance = before.rest, before.balance
    else:
        # What motion and weight need beyond what the ground gives: nothing for the trunk, the springs' torques for
        # joints.
        rest = inertial - sum(np.einsum("nij,ni->nj", motion.J[foot], wrench[foot]) for foot in FEET)
        if world.pull.any():
            level = seen_from(0.5 * (yaw[Foot.LEFT] + yaw[Foot.RIGHT]), world.pull)
            force = np.einsum("nki,nk->ni", R[:, :2], level)
            rest = rest - np.hstack([force, np.cross(motion.trunk, force), np.zeros((len(R), rest.shape[1] - 6))])
        moment = rest[:, 3:6] - np.cross(motion.com, rest[:, :3])
        balance = {}  # what the sensors say too much
        for name, value in (("force", rest[:, :3]), ("moment", moment)):
            balance |= {f"{name}/{axis}": -np.einsum("nj,nj->n", R[:, k], value) for k, axis in enumerate(AXES)}
    needed = rest[:, robot.idx_v] + _resisted(recording, world, ticks, smoothed)
    torques = _torques(recording, ticks, needed, smoothed)
    out = balance | _joints(recording, world, where, needed, torques, smoothed)
    if recording.up is not None:
        leaning = np.einsum("nij,nj->ni", R, smoothed(recording.up)[ticks])
        tilt = {"tilt/roll": leaning[:, 1], "tilt/pitch": -leaning[:, 0]}
        out |= {name: np.where(where.flat, value, np.nan) for name, value in tilt.items()}
    # A spring whose torque is measured owes nothing to the ground.
    anywhere = {name.replace("torque", "spring", 1) for name in out if name.startswith("torque/")}
    out = {
        name: np.where(where.complete if name in anywhere else where.steady, value, np.nan)
        for name, value in out.items()
    }
    feet = before.feet if before and up is before.up else _feet(motion, where, world, wrench)
    out |= feet
    if recording.plan is not None and recording.moved is not None:
        gap = (smoothed(recording.moved) - smoothed(recording.plan))[ticks]
        if world.yielded:
            behind = _yielded(world.yielded, world, recording, ticks, torques, smoothed)
            gap = gap + _com_by_joints(world, motion, where.share, behind)
        if world.lead and recording.motor_q is not None:
            planned = _planned_torque(world, smoothed(recording.motor_q), where)
            ahead = world.lead * np.nan_to_num(planned / world.stiffness)
            gap = gap - _com_by_joints(world, motion, where.share, ahead)
        out |= {
            f"plan/{axis}": np.where(where.steady & ~where.double, gap[:, k], np.nan) for k, axis in enumerate("xy")
        }
    out["landing/z"] = where.blow - world.limits["blow_seen"] * world.impulse
    out["slide/x"] = np.full(len(ticks), np.nan)
    for value, slide in zip(slid, where.slides, strict=True):
        out["slide/x"][slide.tick] = value + slide.share * world.slip[FEET.index(slide.foot)]
    for foot in FEET:
        for k, name in enumerate(WRENCH):
            out[f"unloaded/{foot.name.lower()}/{name}"] = np.where(where.air[foot], wrench[foot][:, k], np.nan)
    if recording.computed:
        out |= dict.fromkeys(owing_to_wrenches(out), np.full(len(ticks), np.nan))
    return State(recording, world, motion, up, free, inertial, rest, R, balance, feet, slid, out, smoothed)


SLOW = 0.1  # [s] below which a torque sensor is believed, and above which motion and ground


def balanced(state: State, where: Masks, noise: float | Array) -> State:
    """The state with wrenches that are what motion and weight ask for, shared by the feet as measured.

    The noise of the foot sensors would otherwise be in the residuals and in what a gain of the sensors makes of them.
    The same of what is fast in the torques, but what their noise does not make is believed: where a large effect is
    missing, motion and weight along the motion of a nominal robot are wrong.

    Args:
        state: of the recording without most of its noise.
        where: of the measured recording.
        noise: standard deviation of the torque sensors (nj,), smoothed [Nm].
    """
    recording, missing = state.recording, state.rest[:, :6]
    grid = np.arange(len(recording.t))
    steady = where.steady & np.isfinite(missing).all(axis=1)
    if steady.sum() < 2:
        return state
    wrench = {}
    for foot in FEET:
        share = share_of(foot, where.share)
        wanted = np.linalg.solve(state.motion.J[foot][:, :, :6].transpose(0, 2, 1), missing[:, :, None])[:, :, 0]
        wanted = np.where(steady[:, None], share[:, None] * wanted, 0.0)
        added = np.column_stack([np.interp(grid, where.ticks, column) for column in wanted.T])
        wrench[foot] = recording.wrench[foot] + added
    out = evaluate(recording.changed(wrench=wrench), state.world, where, state)
    if recording.tau is None:
        return out
    needed = out.rest[:, out.world.robot.idx_v]
    less = smooth(recording.tau)[where.ticks] - needed
    less = np.where(steady[:, None], less, 0.0)
    less = np.column_stack([np.interp(grid, where.ticks, column) for column in less.T])
    fast = less - np.asarray(gaussian_filter1d(less, SLOW * RATE, axis=0, mode="nearest"))
    tau = recording.tau - np.nan_to_num(noise_share(fast, noise) * fast)
    return evaluate(out.recording.changed(tau=tau), out.world, where, out)


def _same(world: World, other: World, name: str) -> bool:
    return bool(np.array_equal(getattr(world, name), getattr(other, name)))


def _torques(recording: Recording, ticks: Integers, needed: Array, smoothed: Smoothed) -> Array:
    """(m, nj) [Nm] that the springs bear: measured, or else what motion and ground ask for."""
    if recording.tau is None:
        return needed
    efforts = smoothed(recording.tau)
    return np.where(smoothed.complete(efforts), efforts[ticks], needed)


def _resisted(recording: Recording, world: World, ticks: Integers, smoothed: Smoothed) -> Array | float:
    """(m, nj) [Nm] that friction takes."""
    return world.friction * smoothed.rubbing(recording.q, world.creep)[ticks] if world.friction.any() else 0.0


def _on_grid(values: Array, ticks: Integers) -> Array:
    """Values (m, k) at the ticks, at each sample from the first tick to the last."""
    return np.asarray(CubicSpline(ticks, values)(np.arange(ticks[0], ticks[-1] + 1)))


def _yielded(
    compliance: float, world: World, recording: Recording, ticks: Integers, torque: Array, smoothed: Smoothed
) -> Array:
    """(m, nj) [rad] by which position loops yield to torques (m, nj) and to their rotors, a lag later."""
    load = torque - world.settling * RATE * CubicSpline(ticks, torque)(ticks, 1)
    if world.rotor and recording.motor_q is not None:
        load = load + world.rotor * rate_of(rate_of(smoothed(recording.motor_q)))[ticks]
    return compliance * load


def _planned_torque(world: World, motors: Array, where: Masks) -> Array:
    """(m, nj) [Nm] that the smoothed motion (n, nj) of the motor side asks for if one foot bears it all, as planned."""
    motion = motion_of(world.robot, motors, where.ticks)
    left = np.where(where.share >= 0.5, 1.0, 0.0)
    upright = {foot: motion.R[foot][:, :, 2] for foot in FEET}
    inertial = inertial_forces(world.model, free_motion(world, motion, upright, left, None)[1])
    J = left[:, None, None] * motion.J[Foot.LEFT] + (1.0 - left[:, None, None]) * motion.J[Foot.RIGHT]
    wrench = np.linalg.solve(J[:, :, :6].transpose(0, 2, 1), inertial[:, :6, None])
    return (inertial - (J.transpose(0, 2, 1) @ wrench)[:, :, 0])[:, world.robot.idx_v]


def _com_by_joints(world: World, motion: Motion, share: Array, joints: Array) -> Array:
    """x, y (m, 2) by which joints (m, nj) [rad] move the COM in the frame of the stance sole, to first order."""
    left, idx_v = share >= 0.5, world.robot.idx_v

    def stance(by_foot: dict[Foot, Array]) -> Array:
        return np.where(left.reshape(-1, *(1,) * (by_foot[Foot.LEFT].ndim - 1)), *(by_foot[foot] for foot in FEET))

    R = stance(motion.R)
    sole = np.einsum("nij,nj->ni", stance(motion.J)[:, :, idx_v], joints)
    com = np.einsum("nji,njk,nk->ni", R, motion.com_J[:, :, idx_v], joints, optimize=True)
    lever = np.einsum("nji,nj->ni", R, motion.com - stance(motion.p))
    return (com - sole[:, :3] - np.cross(sole[:, 3:], lever))[:, :2]


def _joints(
    recording: Recording, world: World, where: Masks, needed: Array, torques: Array, smoothed: Smoothed
) -> dict[str, Array]:
    """`torque` and `spring`; torques (m, nj) that motion and ground ask for (`needed`), and that the springs bear."""
    robot, ticks = world.robot, where.ticks
    efforts = None if recording.tau is None else smoothed(recording.tau)
    stretch = None if recording.motor_q is None else (smoothed(recording.motor_q) - smoothed(recording.q))[ticks]
    warmed = -np.expm1(-recording.t[ticks, None] / world.warming) * world.drift if world.drift.any() else None
    yielding = None
    if world.yielding:
        yielding = _yielded(world.yielding, world, recording, ticks, torques, smoothed)
    measured = np.zeros(len(robot.joint_names), dtype=bool) if efforts is None else smoothed.complete(efforts)
    legs = np.concatenate([robot.legs[foot] for foot in FEET])
    asked = [j for j in legs if not measured[j]]  # of these joints, motion and ground say what their springs bear
    between = dict(zip(asked, _on_grid(torques[:, asked], ticks).T, strict=True)) if asked else {}
    out: dict[str, Array] = {}
    for j in legs:
        name = robot.joint_names[j]
        lost = None
        if recording.tau is not None and efforts is not None and measured[j]:
            out[f"torque/{name}"] = torques[:, j] - needed[:, j]
            elastic = smoothed.stretch(world, j, efforts)[ticks]
            lost = smoothed.slipped(world, j, recording.tau)[ticks] if world.lost[j] else None
        else:
            elastic = spring_stretch(world, j, between[j])[ticks - ticks[0]]
        borne = world.stiffness[j] * elastic
        if warmed is not None:
            elastic = elastic / np.maximum(1.0 + warmed[:, j], SOFTEST)
        if stretch is not None:
            play = where.taken_up[:, j] if where.taken_up[:, j].any() else np.tanh(borne / sure_torque(world))
            bent = elastic + 0.5 * world.play[j] * play
            if world.lost[j]:
                bent = bent + (slipped(world, j, between[j])[ticks - ticks[0]] if lost is None else lost)
            out[f"spring/{name}"] = stretch[:, j] - (bent if yielding is None else bent + yielding[:, j])
    return out


def _turned(world: World, foot: Foot, wrench: dict[Foot, Array], where: Masks) -> Array:
    """(m, 2) [rad] by which a foot has turned, of wrenches at the ticks."""
    return turned(world, foot, wrench[foot], share_of(foot, where.share))


def _feet(motion: Motion, where: Masks, world: World, wrench: dict[Foot, Array]) -> dict[str, Array]:
    """The right sole in the frame of the left one, both taken back to a hard level floor."""
    R = np.einsum("nji,njk->nik", motion.R[Foot.LEFT], motion.R[Foot.RIGHT])
    p = np.einsum("nji,nj->ni", motion.R[Foot.LEFT], motion.p[Foot.RIGHT] - motion.p[Foot.LEFT])
    left, right = (_turned(world, foot, wrench, where) for foot in FEET)
    # A foot turns against the ground's moment on it, and sinks against its force.
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    apart = seen_from(yaw, left.T) - right  # in axes of the right sole, as roll and pitch are
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2]) - apart[:, 0]
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0)) - apart[:, 1]
    sunken = sunk(world, Foot.LEFT, wrench[Foot.LEFT]) - sunk(world, Foot.RIGHT, wrench[Foot.RIGHT])
    height = p[:, 2] - sunken - left[:, 0] * p[:, 1] + left[:, 1] * p[:, 0]
    since = {"y": p[:, 1], "yaw": yaw}
    out = {"feet/z": height, "feet/roll": roll, "feet/pitch": pitch}
    out |= {f"feet/{name}": value - value[where.touchdown] for name, value in since.items()}
    return {name: np.where(where.double & where.flat, value, np.nan) for name, value in out.items()}
