# SPDX-License-Identifier: BSD-3-Clause
"""Structured residuals: laws that hold on any robot, each blind to some effects. No reduced model is involved.

`spring`    motor - link - torque / k - (d / k) rate: the spring law of a joint [rad]
`torque`    measured torque of a joint against inverse dynamics from the ground up [Nm]
`force`     sum of the foot forces against the rate of momentum and weight, heading-aligned axes [N]
`moment`    the same about the COM: the centre of pressure against the motion [Nm]
`feet`      one sole in the frame of the other while both stand: height, roll and pitch, which are zero on a flat
            floor, and y, yaw since touchdown, which do not change [m, rad]
`slide`     how far a sole that has landed moves along its x axis while the other stands still [m]
`tilt`      the trunk's roll and pitch by the IMU against kinematics from a flat sole [rad]
`plan`      where the motor side carries the COM against where com/reference plans it, over the stance sole [m]
`landing`   by how much the force on a landing foot goes beyond what it bears before and after, and beyond the jolt of
            any landing: the impulse of a blow [Ns]
`unloaded`  what a foot's sensor reads while the foot is in the air [N, Nm]

All signals pass the same smoothing (Gaussian, zero phase) before anything else, so that it cancels, and the residuals
are taken at TICKS a second; but for `slide` and `landing`, one value for each landing, from the samples as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from ..core.compiled import compiled
from ..core.config import Config
from ..core.effects.foot_slip import SLIPS_TO, glide
from ..core.effects.joint_friction import CREEP
from ..core.robot import Robot
from ..core.types import Array, Foot, Phase
from .recording import FEET, RATE, Recording

TICKS = 25.0  # [Hz] at which residuals are looked at
SMOOTHING = 0.02  # [s] standard deviation of the Gaussian: half amplitude at 9 Hz, nothing left above 20
_REACH = round(2.5 * SMOOTHING * RATE)  # [samples] that it takes from each side
_CONTACT_S = 0.06  # [s] around a change of contact where the balance is left out: rigid bodies do not explain impacts
_BLOW, _BESIDE = 3, 2  # samples that a blow lasts at most, and before and after it, where the load is felt
_LANDING_S = 0.16  # [s] after a foot has touched the ground until its blow is over: its edge may touch long before
_SELDOM_S = 0.0085  # [s] between samples, from which on a blow cannot be told
_SWING_S = 0.15  # [s] in the air, after which a foot lands: else it only chatters
_LANDED_S = (0.02, 0.055)  # [s] after the landing: where it came down
_SLID_S = 0.03  # [s] where it is at the end of its slide, or so long before the other foot begins to leave the ground
_SHORTEST_SLIDE_S = 0.12  # [s] after the landing, until then the other foot has to stand
STUMBLE, STUMBLE_SHARE = 0.002, 0.5  # [m], and share of the usual, by which a slide differs when a robot stumbles
UNLIKE = 0.01  # [m/s], and STUMBLE_SHARE of the usual, by which a blow at landing differs from most
_AIR_S = 0.12  # [s] after lift-off until a foot counts as unloaded
SCUFF, SCUFF_SHARE = 6.0, 0.01  # standard deviations, and share of the weight, beyond which a foot in the air touches
TAKEN_UP = 0.4  # [Nm] beyond which a torque's sign is sure
SOFTEST = 0.2  # tangent of a softening spring at its softest, over that at rest
TIPPED = 0.004  # [rad] by which a sole that is believed flat has turned, in truth
TIPPED_SHARE = 0.8  # of the time
EDGE_STEP = 0.5  # of a step so stood: the rest of it is no better
JOLT = 0.004  # [m/s] by which any landing stops the robot
TOLD = 0.8  # of a blow: the rest cannot be told from the load that comes (on the virtual robot)
NOISY = 0.05  # of a joint's torques, from which on the noise of their sensor matters for derivatives
SEEN = 0.001  # [rad] of play that smoothed encoders surely show
AXES = ("x", "y", "z")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass
class World:
    """What the robot and its surroundings are believed to be; effects change it.

    Attributes:
        model: the URDF's model; bodies may be changed after `copy`.
        stiffness, damping: (nj,) of the series springs; NaN where the configuration names none.
        slope: roll, pitch (2,) of the floor [rad].
        pull: constant force at the trunk (2,), heading-aligned axes [N].
        tilting: rotation of a foot for its moment [rad/Nm]; sinking: for its force [m/N].
        cubic: (nj,) torque = k d (1 + cubic d^2) [1/rad^2]; play: (nj,) full backlash [rad].
        friction, creep: (nj,) at the link side, against its motion [Nm], and the speed below which it creeps [rad/s].
        yielding, settling, rotor: of the motors' position loops [rad/Nm], the time constant [s] with which they yield,
            and the reflected inertia [kg m^2] that they carry beside the spring.
        yielded: the same as yielding [rad/Nm], of motors whose states tell where they really are.
        lead: share of the springs' sag under the planned torques by which motors are commanded ahead.
        slip: (2,) how far the left, the right foot slides back each time after it has landed [m].
        impulse: of the ground on each landing foot beyond the load that it takes over [Ns].
    """

    robot: Robot
    model: pin.Model
    stiffness: Array
    damping: Array
    gravity: float
    cubic: Array
    play: Array
    friction: Array
    creep: Array
    slope: Array = field(default_factory=lambda: np.zeros(2))
    pull: Array = field(default_factory=lambda: np.zeros(2))
    tilting: float = 0.0
    sinking: float = 0.0
    yielding: float = 0.0
    settling: float = 0.0
    rotor: float = 0.0
    yielded: float = 0.0
    lead: float = 0.0
    slip: Array = field(default_factory=lambda: np.zeros(2))
    impulse: float = 0.0

    @classmethod
    def nominal(cls, robot: Robot, config: Config) -> World:
        stiffness = np.full(len(robot.joint_names), np.nan)
        damping = stiffness.copy()
        for foot, leg in ((Foot.LEFT, config.robot.left), (Foot.RIGHT, config.robot.right)):
            stiffness[robot.legs[foot]], damping[robot.legs[foot]] = leg.stiffness, leg.damping
        none = np.zeros(len(robot.joint_names))
        model = robot.model.copy()
        model.gravity.linear = np.array([0.0, 0.0, -config.robot.gravity])
        return cls(robot, model, stiffness, damping, config.robot.gravity, none, none, none, none + CREEP)

    def changed(self, **fields: object) -> World:
        """A copy with other figures."""
        return replace(self, **fields)  # type: ignore[arg-type]

    def add_mass(self, mass: float, position: Array, frame: int) -> World:
        """A copy with a point mass [kg] at a position (3,) [m] in a frame of the URDF."""
        model = self.model.copy()
        at = model.frames[frame]
        inertia = pin.Inertia(mass, at.placement.act(np.asarray(position, dtype=float)), np.zeros((3, 3)))
        model.inertias[at.parentJoint] = model.inertias[at.parentJoint] + inertia
        return self.changed(model=model)


@dataclass(frozen=True)
class Slide:
    """A landing after which the other foot stands for long enough that a slide would show."""

    tick: int  # before it
    foot: Foot  # that has landed
    first: slice  # of the grid: it has just come down
    last: slice  # ... and slid
    share: float  # of a slide that is gone by between the two


@dataclass(frozen=True)
class Masks:
    """Where each residual means something; fixed by the measurement, the same for every hypothesis but `taken_up`."""

    ticks: Array  # (m,) indices into the grid
    steady: Array  # (m,) no change of contact near, on the ground
    air: dict[Foot, Array]  # (m,) the foot is unloaded
    double: Array  # (m,) both feet stand
    touchdown: Array  # (m,) index of the tick at which this double support was first steady
    share: Array  # (m,) smooth share of the left foot
    segment: Array  # (m,) number of the phase: what belongs together
    slides: tuple[Slide, ...]  # landings that show whether the foot slides
    blow: Array  # (m,) [Ns] of a landing, at the tick before it; NaN elsewhere
    taken_up: Array  # (m, nj) -1..1, at which end of its play a joint would be, if it had some
    staggers: bool = False  # nearly always on the edge of a foot


def masks(recording: Recording, world: World) -> Masks:
    """Of one recording, with the nominal world."""
    phase, n = recording.phase, len(recording.t)
    step = round(RATE / TICKS)
    ticks = np.arange(_REACH, n - _REACH, step)
    changes = np.flatnonzero(np.diff(phase)) + 1
    number = np.searchsorted(changes, np.arange(n), side="right")
    near = np.zeros(n, dtype=bool)
    for change in changes:
        near[max(0, change - round(_CONTACT_S * RATE)) : change + round(_CONTACT_S * RATE)] = True
    gap = np.convolve(~recording.valid, np.ones(2 * _REACH + 1), "same") > 0
    steady = ~near & ~gap & (phase != Phase.FLIGHT)
    air = {}
    for foot, other in ((Foot.LEFT, Phase.RIGHT), (Foot.RIGHT, Phase.LEFT)):
        inside = phase == other
        settled = np.convolve(~inside, np.ones(2 * round(_AIR_S * RATE) + 1), "same") == 0
        air[foot] = (settled & ~gap)[ticks]
        air[foot] &= ~_scuffs(smooth(recording.wrench[foot][:, 2:3])[ticks, 0], air[foot], world)
    double = (steady & (phase == Phase.DOUBLE))[ticks]
    segment = number[ticks]
    touchdown = np.zeros(len(ticks), dtype=np.intp)
    for value in np.unique(segment):
        mine = np.flatnonzero((segment == value) & double)
        if len(mine):
            touchdown[mine] = mine[0]
    share = np.where(phase == Phase.LEFT, 1.0, np.where(phase == Phase.RIGHT, 0.0, recording.left_share))
    share = np.clip(smooth(share[:, None])[:, 0], 0.0, 1.0)[ticks]
    blow, taken_up = _blow(recording, ticks, world.robot.mass), _taken_up(recording, world)[ticks]
    slides = _usual_slides(world, recording, _slides(recording, ticks))
    return Masks(ticks, steady[ticks], air, double, touchdown, share, segment, slides, blow, taken_up)


def _scuffs(force: Array, air: Array, world: World) -> Array:
    """(m,) where a foot in the air touches the ground: its force (m,) is far from what it usually is there."""
    if not air.any():
        return air
    off = np.abs(force - np.median(force[air]))
    far = off > max(SCUFF * 1.4826 * float(np.median(off[air])), SCUFF_SHARE * world.robot.mass * world.gravity)
    return np.convolve(far, np.ones(3), "same") > 0


def taken_up_anew(where: Masks, before: Recording, recording: Recording, world: World) -> Masks:
    """With the play of the joints as it is seen in this recording, if other streams than before tell of it."""
    if all(getattr(recording, name) is getattr(before, name) for name in ("q", "tau", "motor_q")):
        return where
    return replace(where, taken_up=_taken_up(recording, world)[where.ticks])


def on_flat_soles(where: Masks, state: State) -> Masks:
    """Without the ticks at which, by the IMU, it stood on the edge of a foot: rigid soles explain nothing there.

    Unless that is nearly always: then little would be left, and the robot `staggers`.
    """
    tipped = np.zeros(len(where.ticks), dtype=bool)
    for axis in ("roll", "pitch"):
        tilt = state.residuals.get(f"tilt/{axis}")
        if tilt is not None and where.air[Foot.LEFT].any() and where.air[Foot.RIGHT].any():
            # What it usually is on this foot: an encoder of one leg may be off, or the IMU.
            left, right = (_usual(tilt[where.air[foot]]) for foot in (Foot.RIGHT, Foot.LEFT))
            tipped |= np.abs(tilt - where.share * left - (1.0 - where.share) * right) > TIPPED
    tipped = np.convolve(tipped, np.ones(3), "same") > 0
    if where.steady.any() and tipped[where.steady].mean() > TIPPED_SHARE:
        return replace(where, staggers=True)
    whole = tipped.copy()
    for value in np.unique(where.segment):
        step = where.steady & ~where.double & (where.segment == value)
        whole |= step & (tipped[step].mean() > EDGE_STEP if step.any() else False)
    single = where.steady & ~where.double
    if (single & ~whole).sum() >= 0.5 * (single & ~tipped).sum():  # else it hardly does anything but stagger
        tipped = whole
    return replace(where, steady=where.steady & ~tipped, double=where.double & ~tipped)


def _usual(values: Array) -> float:
    """The middle of the narrowest range that holds a quarter of the values: most others may be of rocking."""
    values = np.sort(values[np.isfinite(values)])
    if not len(values):
        return 0.0
    count = max(1, len(values) // 4)
    first = int(np.argmin(values[count - 1 :] - values[: len(values) - count + 1]))
    return float(np.median(values[first : first + count]))


def _slides(recording: Recording, ticks: Array) -> tuple[Slide, ...]:
    """Landings at which a slide would show."""
    out = []
    for landed, tick, _, i, leaves in _landings(recording.phase, ticks):
        end = min(i + round(SLIPS_TO * RATE), leaves - round(_CONTACT_S * RATE))
        if end - i < _SHORTEST_SLIDE_S * RATE or not recording.valid[i:end].all():
            continue
        first = slice(i + round(_LANDED_S[0] * RATE), i + round(_LANDED_S[1] * RATE))
        last = slice(end - round(_SLID_S * RATE), end)
        gone = [np.mean([glide((k - i) / RATE)[0] for k in range(w.start, w.stop)]) for w in (first, last)]
        out.append(Slide(tick, landed, first, last, float(gone[1] - gone[0])))
    return tuple(out)


def _usual_slides(world: World, recording: Recording, slides: tuple[Slide, ...]) -> tuple[Slide, ...]:
    """Those that are much like most of the same foot: when a robot stumbles, it does so now and then."""
    whole = _slid(world, recording.q, slides) / np.array([slide.share for slide in slides])
    usual = np.zeros(len(slides), dtype=bool)
    for foot in FEET:
        mine = np.array([slide.foot == foot for slide in slides], dtype=bool)
        if not mine.any():
            continue
        alike = _alike(whole[mine], STUMBLE)
        if alike.mean() > 0.5:
            usual[np.flatnonzero(mine)[alike]] = True
    return tuple(slide for slide, kept in zip(slides, usual, strict=True) if kept)


def _alike(values: Array, least: float) -> Array:
    """(k,) those of values (k,) that are much like their median: within `least`, or a share of it."""
    middle = float(np.median(values))
    return np.abs(values - middle) < max(least, STUMBLE_SHARE * abs(middle))


def _landings(phase: Array, ticks: Array) -> Iterator[tuple[Foot, int, int, int, int]]:
    """Each foot that lands, the tick before it, and on the grid when it left the ground, lands, and what is next."""
    changes = np.concatenate([[0], np.flatnonzero(np.diff(phase)) + 1, [len(phase)]])
    for left, i, leaves in zip(changes[:-2], changes[1:-1], changes[2:], strict=True):
        tick = int(np.searchsorted(ticks, i)) - 1
        if tick >= 0 and phase[i] == Phase.DOUBLE and phase[i - 1] in (Phase.LEFT, Phase.RIGHT):
            yield Foot(phase[i - 1]).other, tick, left, i, leaves


def _blow(recording: Recording, ticks: Array, mass: float) -> Array:
    """(m,) [Ns] of the blows at landing, at the tick before; NaN elsewhere."""
    out = np.full(len(ticks), np.nan)
    if recording.period > _SELDOM_S:
        return out
    for landed, tick, left, i, leaves in _landings(recording.phase, ticks):
        end = min(i + round(_LANDING_S * RATE), leaves)
        if i - left >= _SWING_S * RATE and recording.valid[i - 1 : end].all():
            out[tick] = blow(recording.wrench[landed][i:end, 2])
    # A blow that comes after the next foot has left is not heard: most landings tell, if they are alike.
    heard = np.flatnonzero(np.isfinite(out))
    if len(heard) and (alike := _alike(out[heard], UNLIKE * mass)).mean() > 0.5:
        out[heard[~alike]] = np.nan
    return out


def blow(force: Array) -> float:
    """The largest impulse [Ns] of a few samples beyond what the foot bears before and after, at RATE.

    A force (n,) [N] that only rises after the landing gives nothing; NaN if there is too little of it. The node
    (core/laws.py) judges a landing by its first touch; this also finds the blow of a foot whose edge came first.
    """
    if len(force) < _BLOW + _BESIDE:
        return float("nan")
    force = np.concatenate([np.zeros(_BESIDE), force])  # in the air before
    around = sliding_window_view(force, _BLOW + 2 * _BESIDE)
    before, felt, after = np.split(around, [_BESIDE, _BESIDE + _BLOW], axis=1)
    borne = np.maximum(before.mean(axis=1), after.mean(axis=1)).clip(0.0)
    return max(0.0, float((felt - borne[:, None]).sum(axis=1).max()) / RATE)


def _taken_up(recording: Recording, world: World) -> Array:
    """(n, nj) A torque beyond the error of its sensor takes up the play; below that, play is where it is seen to be."""
    out = np.zeros_like(recording.q)
    if recording.motor_q is None or recording.tau is None:
        return out  # then the torque that the ground asks for decides, see _joints
    for j in np.flatnonzero(np.isfinite(world.stiffness) & np.isfinite(recording.tau).all(axis=0)):
        torque = recording.tau[:, j]
        law = (
            recording.motor_q[:, j]
            - recording.q[:, j]
            - lagged(torque, world.damping[j] / world.stiffness[j]) / (world.stiffness[j])
        )
        law = gaussian_filter1d(law, SMOOTHING * RATE)
        low, high = np.percentile(law, (3.0, 97.0))  # about their middle: an encoder's zero tells of no end
        seen = np.clip((law - 0.5 * (low + high)) / max(SEEN, 0.5 * (high - low)), -1.0, 1.0)
        loaded = np.clip((np.abs(smooth(torque[:, None])[:, 0]) - TAKEN_UP) / TAKEN_UP, 0.0, 1.0)
        out[:, j] = loaded * np.sign(torque) + (1.0 - loaded) * seen
    return smooth(out)


@dataclass(frozen=True)
class Motion:
    """Smoothed joints at the ticks, and the soles against the trunk.

    Attributes:
        q, qd, qdd: (m, nj).
        R, p: by foot (m, 3, 3), (m, 3) of the sole in the root link's frame.
        twist, twist_rate: by foot (m, 6) of the root link, in its frame, if that sole stands still.
        J: by foot (m, 6, nv) of the sole, in its own frame.
        com: (m, 3) by the URDF, in the root link's frame, and com_J (m, 3, nv) by joints.
    """

    q: Array
    qd: Array
    qdd: Array
    R: dict[Foot, Array]
    p: dict[Foot, Array]
    twist: dict[Foot, Array]
    twist_rate: dict[Foot, Array]
    J: dict[Foot, Array]
    com: Array
    com_J: Array


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
    R: Array  # (m, 3, 3) world, heading as the root's x axis <- root
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


class Smoothed:
    """Smoothed arrays, and what is made of them, remembered: most hypotheses leave most arrays as they are."""

    def __init__(self, before: Smoothed | None = None) -> None:
        self._known: dict[tuple[Any, ...], tuple[Array, Array]] = {} if before is None else dict(before._known)

    def __call__(self, values: Array) -> Array:
        return self._made(("smooth", id(values)), values, smooth)

    def complete(self, values: Array) -> Array:
        """(k,) which columns of smoothed values (n, k) have no gap."""
        return self._made(("complete", id(values)), values, lambda each: np.isfinite(each).all(axis=0))

    def stretch(self, world: World, j: int, torques: Array) -> Array:
        """(n,) [rad] of the spring of joint j under smoothed torques (n, nj) at RATE."""
        law = float(world.stiffness[j]), float(world.damping[j]), float(world.cubic[j])
        return self._made((j, *law), torques, lambda each: _stretch(world, j, each[:, j], 1.0 / RATE))

    def _made(self, key: tuple[Any, ...], of: Array, make: Callable[[Array], Array]) -> Array:
        found = self._known.get(key)
        if found is None or found[0] is not of:
            found = self._known[key] = (of, make(of))
        return found[1]


def smooth(values: Array) -> Array:
    """Values (n, k) without what is faster than the balance can follow."""
    return np.asarray(gaussian_filter1d(values, SMOOTHING * RATE, axis=0, mode="nearest"))


def _rate(values: Array) -> Array:
    return np.gradient(values, 1.0 / RATE, axis=0)


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
    slid = before.slid if before and same_q else _slid(world, recording.q, where.slides)
    smoothed = Smoothed(before.smoothed if before else None)
    motion = before.motion if before and same_q else _motion(world.robot, smoothed(recording.q), ticks)
    wrench = {foot: smoothed(recording.wrench[foot])[ticks] for foot in FEET}
    # Soft ground couples the forces into the motion; else motion and weight do not depend on what the sensors read.
    same_ground = before is not None and all(
        _same(world, before.world, name) for name in ("slope", "tilting", "sinking")
    )
    same_forces = before is not None and recording.wrench is before.recording.wrench
    if before and same_q and same_ground and (same_forces or not (world.tilting or world.sinking)):
        up = before.up
    else:
        up = {foot: _normal(world, motion.R[foot], wrench[foot]) for foot in FEET}
    if before and up is before.up:
        R, free = before.R, before.free
        inertial = before.inertial if world.model is before.world.model else before.inertial_of(world.model)
    else:
        R, free = _free_motion(world, motion, up, where.share, _yield(world, recording, motion, ticks))
        inertial = _inertial(world.model, free)
    if before and same_forces and inertial is before.inertial and _same(world, before.world, "pull"):
        rest, balance = before.rest, before.balance
    else:
        # What motion and weight need beyond what the ground gives: nothing for the trunk, the springs' torques for
        # joints.
        rest = inertial - sum(np.einsum("nij,ni->nj", motion.J[foot], wrench[foot]) for foot in FEET)
        if world.pull.any():
            force = np.einsum("nji,nj->ni", R, np.append(world.pull, 0.0)[None].repeat(len(R), 0))
            trunk = robot.model.frames[robot.base_id].placement.translation
            rest = rest - np.hstack([force, np.cross(trunk, force), np.zeros((len(R), rest.shape[1] - 6))])
        moment = rest[:, 3:6] - np.cross(motion.com, rest[:, :3])
        balance = {}  # what the sensors say too much
        for name, value in (("force", rest[:, :3]), ("moment", moment)):
            balance |= {f"{name}/{axis}": -np.einsum("nj,nj->n", R[:, k], value) for k, axis in enumerate(AXES)}
    needed = rest[:, robot.idx_v] + world.friction * np.tanh(motion.qd / world.creep)
    torques = _torques(recording, ticks, needed, smoothed)
    out = balance | _joints(recording, world, where, needed, torques, smoothed)
    if recording.up is not None:
        believed = _blend(up, where.share)
        turn = np.cross(smoothed(recording.up)[ticks], believed / np.linalg.norm(believed, axis=1)[:, None])
        out |= {"tilt/roll": turn[:, 0], "tilt/pitch": turn[:, 1]}
    out = {name: np.where(where.steady, value, np.nan) for name, value in out.items()}
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
    out["landing/z"] = where.blow - JOLT * robot.mass - TOLD * world.impulse
    out["slide/x"] = np.full(len(ticks), np.nan)
    for value, slide in zip(slid, where.slides, strict=True):
        out["slide/x"][slide.tick] = value + slide.share * world.slip[FEET.index(slide.foot)]
    for foot in FEET:
        for k, name in enumerate(WRENCH):
            out[f"unloaded/{foot.name.lower()}/{name}"] = np.where(where.air[foot], wrench[foot][:, k], np.nan)
    return State(recording, world, motion, up, free, inertial, rest, R, balance, feet, slid, out, smoothed)


def _same(world: World, other: World, name: str) -> bool:
    return bool(np.array_equal(getattr(world, name), getattr(other, name)))


def _blend(by_foot: dict[Foot, Array], share: Array) -> Array:
    """(m, k) by the load share of the left foot."""
    w = share[:, None]
    blended: Array = w * by_foot[Foot.LEFT] + (1.0 - w) * by_foot[Foot.RIGHT]
    return blended


def _motion(robot: Robot, smoothed: Array, ticks: Array) -> Motion:
    """From smoothed positions (n, nj)."""
    rate = _rate(smoothed)
    q, qd, qdd = smoothed[ticks], rate[ticks], _rate(rate)[ticks]
    model, m = robot.model, len(q)
    data = model.createData()
    configuration, velocity, acceleration = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    R, p, J = ({foot: np.empty((m, *shape)) for foot in FEET} for shape in ((3, 3), (3,), (6, model.nv)))
    twist, twist_rate = ({foot: np.empty((m, 6)) for foot in FEET} for _ in range(2))
    com, com_J = np.empty((m, 3)), np.empty((m, 3, model.nv))
    for i in range(m):
        robot.scatter(q[i], configuration)
        velocity[robot.idx_v], acceleration[robot.idx_v] = qd[i], qdd[i]
        pin.forwardKinematics(model, data, configuration, velocity, acceleration)
        com_J[i] = pin.jacobianCenterOfMass(model, data, False)
        com[i] = data.com[0]
        for foot, frame in robot.sole_ids.items():
            placement = pin.updateFramePlacement(model, data, frame)
            R[foot][i], p[foot][i] = placement.rotation, placement.translation
            J[foot][i] = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            # What the sole does while the trunk is still is the trunk's to undo; both twists are parallel, so that no
            # term of Coriolis is between them.
            twist[foot][i] = -pin.getFrameVelocity(model, data, frame, pin.WORLD).vector
            twist_rate[foot][i] = -pin.getFrameAcceleration(model, data, frame, pin.WORLD).vector
    return Motion(q, qd, qdd, R, p, twist, twist_rate, J, com, com_J)


def _normal(world: World, R: Array, wrench: Array) -> Array:
    """Against gravity (m, 3) in the root's frame, by a foot on a floor that slopes and gives way under its moment."""
    roll, pitch = world.slope
    turned = np.column_stack(
        [-(pitch - world.tilting * wrench[:, 4]), roll - world.tilting * wrench[:, 3], np.ones(len(R))]
    )
    return np.einsum("nij,nj->ni", R, turned / np.linalg.norm(turned, axis=1)[:, None])


def _yield(
    world: World, recording: Recording, motion: Motion, ticks: Array
) -> tuple[dict[Foot, Array], dict[Foot, Array]] | None:
    """Twist and its rate (m, 6) that soles moving on soft ground give the root link (its frame); None: hard ground."""
    if not (world.tilting or world.sinking):
        return None
    flexible = -np.array([0.0, 0.0, world.sinking, world.tilting, world.tilting, 0.0])
    twist, twist_rate = {}, {}
    for foot in FEET:
        first = _rate(smooth(recording.wrench[foot]))
        for out, value in ((twist, first), (twist_rate, _rate(first))):
            sole = value[ticks] * flexible
            linear, angular = (np.einsum("nij,nj->ni", motion.R[foot], part) for part in (sole[:, :3], sole[:, 3:]))
            out[foot] = np.hstack([linear + np.cross(motion.p[foot], angular), angular])
    return twist, twist_rate


def _free_motion(
    world: World,
    motion: Motion,
    up: dict[Foot, Array],
    share: Array,
    yielding: tuple[dict[Foot, Array], dict[Foot, Array]] | None,
) -> tuple[Array, list[tuple[Array, Array, Array]]]:
    """The rotation (m, 3, 3) world <- root, and m configurations, velocities and accelerations of the model."""
    robot, model = world.robot, world.robot.model
    against, twist, rate = (_blend(each, share) for each in (up, motion.twist, motion.twist_rate))
    if yielding is not None:
        twist, rate = twist + _blend(yielding[0], share), rate + _blend(yielding[1], share)
    z = against / np.linalg.norm(against, axis=1)[:, None]
    x = np.array([1.0, 0.0, 0.0]) - z[:, :1] * z
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


def _inertial(model: pin.Model, motion: Sequence[tuple[Array, Array, Array]]) -> Array:
    """Generalised forces (m, nv) of motion and weight."""
    data = model.createData()
    return np.array([pin.rnea(model, data, *each) for each in motion])


def _torques(recording: Recording, ticks: Array, needed: Array, smoothed: Smoothed) -> Array:
    """(m, nj) [Nm] that the springs bear: measured, or else what motion and ground ask for."""
    if recording.tau is None:
        return needed
    efforts = smoothed(recording.tau)
    return np.where(smoothed.complete(efforts), efforts[ticks], needed)


def _yielded(
    compliance: float, world: World, recording: Recording, ticks: Array, torque: Array, smoothed: Smoothed
) -> Array:
    """(m, nj) [rad] by which position loops yield to torques (m, nj) and to their rotors, a lag later."""
    load = torque - world.settling * np.gradient(torque, 1.0 / TICKS, axis=0)
    if world.rotor and recording.motor_q is not None:
        load = load + world.rotor * _rate(_rate(smoothed(recording.motor_q)))[ticks]
    return compliance * load


def _planned_torque(world: World, motors: Array, where: Masks) -> Array:
    """(m, nj) [Nm] that the smoothed motion (n, nj) of the motor side asks for if one foot bears it all, as planned."""
    motion = _motion(world.robot, motors, where.ticks)
    left = np.where(where.share >= 0.5, 1.0, 0.0)
    upright = {foot: motion.R[foot][:, :, 2] for foot in FEET}
    inertial = _inertial(world.model, _free_motion(world, motion, upright, left, None)[1])
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
    yielding = None
    if world.yielding:
        yielding = _yielded(world.yielding, world, recording, ticks, torques, smoothed)
    out: dict[str, Array] = {}
    for j in np.concatenate([robot.legs[foot] for foot in FEET]):
        name = robot.joint_names[j]
        torque = torques[:, j]
        if efforts is not None and smoothed.complete(efforts)[j]:
            out[f"torque/{name}"] = torque - needed[:, j]
            elastic = smoothed.stretch(world, j, efforts)[ticks]
        else:
            elastic = _stretch(world, j, torque, 1.0 / TICKS)
        if stretch is not None:
            play = where.taken_up[:, j] if where.taken_up[:, j].any() else np.tanh(torque / TAKEN_UP)
            bent = elastic + 0.5 * world.play[j] * play
            out[f"spring/{name}"] = stretch[:, j] - (bent if yielding is None else bent + yielding[:, j])
    return out


def _stretch(world: World, j: int, torque: Array, dt: float) -> Array:
    """Between motor and link (n,) [rad], of spring and damper, for a torque (n,) every dt."""
    k, d = float(world.stiffness[j]), float(world.damping[j])
    if world.cubic[j]:
        return np.asarray(bent_stretch(np.ascontiguousarray(torque), k, d, float(world.cubic[j]), dt))
    if dt == 1.0 / RATE:
        return lagged(torque, d / k) / k
    return (torque - d / k * np.gradient(torque, dt)) / k  # ticks are too far apart for the lag itself


def lagged(values: Array, time_constant: float) -> Array:
    """First-order lag along the first axis; a negative time constant leads (for difference quotients around zero)."""
    if time_constant <= 0.0:
        return values - time_constant * _rate(values)
    a = np.exp(-1.0 / RATE / time_constant)
    # Exact for values that are linear between samples.
    b = time_constant * RATE * (1.0 - a)
    state = b * values[:1]  # as if it had been at its first value for ever
    return np.asarray(lfilter([1.0 - b, b - a], [1.0, -a], values, axis=0, zi=state)[0])


def without_noise(recording: Recording, world: World) -> Recording:
    """The same motion without the quantisation of the link encoders, and torques without most of their noise.

    Motor side minus stretched springs if both are known, else smoothed twice as much. Where a torque sensor is noisy
    and the link encoder tells the spring's torque better, the encoder tells both but for the slow part.
    """
    q = np.asarray(gaussian_filter1d(recording.q, 2.0 * SMOOTHING * RATE, axis=0, mode="nearest"))
    if recording.motor_q is None or recording.tau is None:
        return recording.changed(q=q)
    stride = recording.stride
    stretch = recording.motor_q - recording.q
    noise = white(recording.tau[::stride])
    coarse = np.maximum(recording.count / np.sqrt(12.0), white(stretch[::stride])) * world.stiffness
    tau = recording.tau.copy()
    known = np.isfinite(world.stiffness + recording.tau.sum(axis=0) + recording.motor_q.sum(axis=0))
    for j in np.flatnonzero(known):
        noisy = noise[j] > max(NOISY * float(np.std(recording.tau[:, j])), 2.0 * coarse[j])
        if noisy and not (world.play[j] or world.cubic[j]):
            x = gaussian_filter1d(stretch[:, j], 2.0 * SMOOTHING * RATE, mode="nearest")
            torque = world.stiffness[j] * x + world.damping[j] * _rate(x)
            tau[:, j] = torque + _slow(recording.tau[:, j] - torque)
            q[:, j] = recording.motor_q[:, j] - x
        else:
            bent = _stretch(world, j, recording.tau[:, j], 1.0 / RATE)
            q[:, j] = recording.motor_q[:, j] - bent - _slow(stretch[:, j] - bent)  # what is slow is the encoder's
    return recording.changed(q=q, tau=tau)


def _slow(values: Array) -> Array:
    return np.asarray(gaussian_filter1d(values, 0.5 * RATE, mode="nearest"))


def white(values: Array) -> Array:
    """Standard deviation (k,) of the white noise of a signal (n, k): by its fastest part but for impacts."""
    fast = values - gaussian_filter1d(values, 1.0, axis=0)
    gain = 0.70  # root of the sum of squares of the kernel: what is left of white noise
    return np.asarray(1.4826 * np.median(np.abs(fast), axis=0) / gain)


@compiled
def bent_stretch(torque: Array, k: float, d: float, cubic: float, dt: float) -> Array:
    """Stretch (n,) of a spring k x (1 + cubic x^2) with a damper d beside it, under a torque (n,) [Nm] every dt [s].

    Backward Euler, as stiff springs need. A softening spring goes on straight where its tangent has fallen to a fifth.
    """
    straight = 1e9
    if cubic < 0.0:
        straight = np.sqrt((1.0 - SOFTEST) / (-3.0 * cubic))
    out = np.empty(len(torque))
    x = torque[0] / k
    for i in range(len(torque)):
        last = x
        for _ in range(200 if i == 0 else 6):
            at = min(max(x, -straight), straight)
            force = k * (at + cubic * at**3)
            tangent = k * (1.0 + 3.0 * cubic * at**2)
            force += tangent * (x - at)
            slope = tangent
            if i > 0:
                force += d * (x - last) / dt
                slope += d / dt
            x -= (force - torque[i]) / slope
        out[i] = x
    return out


def _feet(motion: Motion, where: Masks, world: World, wrench: dict[Foot, Array]) -> dict[str, Array]:
    """The right sole in the frame of the left one, both taken back to a hard level floor."""
    R = np.einsum("nji,njk->nik", motion.R[Foot.LEFT], motion.R[Foot.RIGHT])
    p = np.einsum("nji,nj->ni", motion.R[Foot.LEFT], motion.p[Foot.RIGHT] - motion.p[Foot.LEFT])
    left, right = (world.tilting * wrench[foot][:, 3:5] for foot in FEET)
    # A foot turns against the ground's moment on it, and sinks against its force.
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2]) - (left - right)[:, 0]
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0)) - (left - right)[:, 1]
    sunk = world.sinking * (wrench[Foot.LEFT][:, 2] - wrench[Foot.RIGHT][:, 2])
    height = p[:, 2] - sunk - left[:, 0] * p[:, 1] + left[:, 1] * p[:, 0]
    since = {"y": p[:, 1], "yaw": np.arctan2(R[:, 1, 0], R[:, 0, 0])}
    out = {"feet/z": height, "feet/roll": roll, "feet/pitch": pitch}
    out |= {f"feet/{name}": value - value[where.touchdown] for name, value in since.items()}
    return {name: np.where(where.double, value, np.nan) for name, value in out.items()}


def _slid(world: World, q: Array, slides: Sequence[Slide]) -> Array:
    """(k,) [m] along its x axis, by each foot that landed, against the other foot."""
    posture, still = world.robot.posture(), np.zeros(q.shape[1])

    def at(slide: Slide, window: slice) -> tuple[Array, Array]:
        posture.update(q[window].mean(axis=0), still)
        return posture.sole_to_sole(slide.foot.other, slide.foot)

    out = np.empty(len(slides))
    for k, slide in enumerate(slides):
        (R, landed), (_, now) = at(slide, slide.first), at(slide, slide.last)
        out[k] = R[:, 0] @ (now - landed)
    return out
