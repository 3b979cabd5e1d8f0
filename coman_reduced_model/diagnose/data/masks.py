# SPDX-License-Identifier: BSD-3-Clause
"""Which samples of a recording each law may use: it stands steadily, flat on its soles, has a foot in the air."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...core.base.types import Array, Booleans, Foot, Integers, Phase
from .landings import CONTACT_S, Slide, blows, usual_slides
from .recording import RATE, Recording
from .signals import SMOOTHING, barely_smooth, encoder_noise, lagged, noise_share, smooth
from .strides import in_stride
from .world import World

TICKS = 25.0  # [Hz] at which residuals are looked at
_REACH = round(2.5 * SMOOTHING * RATE)  # [samples] that it takes from each side
_AIR_S = 0.12  # [s] after lift-off until a foot counts as unloaded
SCUFF = 6.0  # standard deviations beyond which a foot in the air touches; at least the limit `scuff`
TIPPED_SHARE = 0.8  # of the time
EDGE_STEP = 0.5  # of a step so stood: the rest of it is no better
EDGE_SHARE = 0.5  # of the time on an edge: then soles are wrong
BEARS = 0.05  # of the weight, on a foot of which the centre of pressure means something


@dataclass(frozen=True)
class Masks:
    """Where each residual means something; fixed by the measurement, the same for every hypothesis but `taken_up`."""

    ticks: Integers  # (m,) indices into the grid
    steady: Booleans  # (m,) no change of contact near, on the ground
    flat: Booleans  # (m,) the same, and no foot bears at the edge of its sole, on which it may turn
    complete: Booleans  # (m,) no gap in the recording near
    air: dict[Foot, Booleans]  # (m,) the foot is unloaded
    double: Booleans  # (m,) both feet stand
    touchdown: Integers  # (m,) index of the tick at which this double support was first steady and flat
    left: Array  # (n,) smooth share of the left foot, on the grid
    segment: Integers  # (m,) number of the phase: what belongs together
    slides: tuple[Slide, ...]  # landings that show whether the foot slides
    blow: Array  # (m,) [Ns] of a landing, at the tick before it; NaN elsewhere
    taken_up: Array  # (m, nj) -1..1, at which end of its play a joint would be, if it had some
    stride: Array  # (m,) strides so far
    staggers: bool = False  # nearly always on the edge of a foot

    @property
    def share(self) -> Array:
        """(m,) of the left foot."""
        return self.left[self.ticks]


def masks(recording: Recording, world: World) -> Masks:
    """Of one recording, with the nominal world."""
    phase, n = recording.phase, len(recording.t)
    step = round(RATE / TICKS)
    ticks = np.arange(_REACH, n - _REACH, step)
    changes = np.flatnonzero(np.diff(phase)) + 1
    number = np.searchsorted(changes, np.arange(n), side="right")
    near = np.zeros(n, dtype=bool)
    for change in changes:
        near[max(0, change - round(CONTACT_S * RATE)) : change + round(CONTACT_S * RATE)] = True
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
    share = np.where(phase == Phase.LEFT, 1.0, np.where(phase == Phase.RIGHT, 0.0, recording.left_share))
    share = np.clip(smooth(share[:, None])[:, 0], 0.0, 1.0)
    blow, taken_up = blows(recording, ticks, world), _taken_up(recording, world)[ticks]
    slides = usual_slides(recording, ticks, world)
    stride = in_stride(phase, RATE)[ticks]
    return Masks(
        ticks, steady[ticks], steady[ticks], ~gap[ticks], air, double, _touchdown(segment, double), share, segment,
        slides, blow, taken_up, stride,
    )  # fmt: skip


def _touchdown(segment: Integers, both: Booleans) -> Integers:
    """(m,) index of the first tick of each phase at which both feet stand so."""
    out = np.zeros(len(segment), dtype=np.intp)
    for value in np.unique(segment[both]):
        mine = np.flatnonzero((segment == value) & both)
        out[mine] = mine[0]
    return out


def supports(channel: str) -> tuple[str, ...]:
    """Kinds of support in which the noise of a channel differs; springs bear torques in any."""
    return ("any",) if channel.startswith("spring/") else ("double", "single")


def parts(where: Masks, channel: str) -> tuple[tuple[str, Booleans], ...]:
    """Ticks (m,) of each of the `supports` of a channel."""
    ticks = {"any": np.ones_like(where.double), "double": where.double, "single": ~where.double}
    return tuple((name, ticks[name]) for name in supports(channel))


def part_of(where: Masks, begin: float, end: float) -> Masks:
    """Masks of a part of the recording, from one share of its ticks to another."""
    m = len(where.ticks)
    first, last = round(begin * m), round(end * m)
    inside = (np.arange(m) >= first) & (np.arange(m) < last)
    return replace(
        where,
        steady=where.steady & inside,
        flat=where.flat & inside,
        complete=where.complete & inside,
        air={foot: air & inside for foot, air in where.air.items()},
        double=where.double & inside,
        slides=tuple(slide for slide in where.slides if first <= slide.tick < last),
        blow=np.where(inside, where.blow, np.nan),
    )


def not_on_edges(where: Masks, recording: Recording, world: World) -> Masks:
    """Not `flat` where the centre of pressure of a foot that bears is at the edge of its sole.

    Unless that is most of a kind of support: then it is no edge, or sensors have zeros that hide where the foot bears.
    """
    edge = np.zeros(len(where.ticks), dtype=bool)
    for foot, load in ((Foot.LEFT, where.share), (Foot.RIGHT, 1.0 - where.share)):
        x0, x1, y0, y1 = world.robot.soles[foot]
        wrench = smooth(recording.wrench[foot])[where.ticks]
        if where.air[foot].any():
            wrench = wrench - np.median(wrench[where.air[foot]], axis=0)
        pressed = np.stack([-wrench[:, 4], wrench[:, 3]]) / np.maximum(wrench[:, 2], 1e-9)
        off = np.abs(pressed.T - 0.5 * np.array([x0 + x1, y0 + y1])) / (0.5 * np.array([x1 - x0, y1 - y0]))
        edge |= (load > BEARS) & (off > world.limits["sole_edge"]).any(axis=1)
    for kind in (where.double, ~where.double):
        mine = where.steady & kind
        if edge[mine].sum() > EDGE_SHARE * mine.sum():
            edge &= ~kind
    return _flat_only(where, ~edge)


def _flat_only(where: Masks, there: Booleans) -> Masks:
    """`flat` only there (m,), and what follows of it."""
    flat = where.flat & there
    return replace(where, flat=flat, touchdown=_touchdown(where.segment, where.double & flat))


def _scuffs(force: Array, air: Booleans, world: World) -> Booleans:
    """(m,) where a foot in the air touches the ground: its force (m,) is far from what it usually is there."""
    if not air.any():
        return air
    off = np.abs(force - np.median(force[air]))
    least = world.limits["scuff"] * world.robot.mass * world.gravity
    far = off > max(SCUFF * 1.4826 * float(np.median(off[air])), least)
    return np.asarray(np.convolve(far, np.ones(3), "same") > 0)


def with_taken_up(where: Masks, before: Recording, recording: Recording, world: World) -> Masks:
    """Masks with the play as seen in this recording, if the streams that show it differ from those before."""
    if all(getattr(recording, name) is getattr(before, name) for name in ("q", "tau", "motor_q")):
        return where
    return replace(where, taken_up=_taken_up(recording, world)[where.ticks])


def sure_torque(world: World) -> float:
    """Beyond it, the sign of a joint's torque is sure [Nm]."""
    return world.limits["torque_sure"] * world.robot.mass * world.gravity


def _taken_up(recording: Recording, world: World) -> Array:
    """(n, nj) A torque beyond the error of its sensor takes up the play; below that, play is where it is seen to be.

    As far as noise of the encoders does not make what is seen: that would be in the residual and in its derivative.
    """
    out = np.zeros_like(recording.q)
    if recording.motor_q is None or recording.tau is None:
        return out  # then the torque that the ground asks for decides, see balance.py
    sure, noise = sure_torque(world), encoder_noise(recording)
    for j in np.flatnonzero(np.isfinite(world.stiffness) & np.isfinite(recording.tau).all(axis=0)):
        torque, stretch = recording.tau[:, j], recording.motor_q[:, j] - recording.q[:, j]
        borne = lagged(torque, world.damping[j] / world.stiffness[j])  # by the spring beside its damper
        law = stretch - borne / world.stiffness[j]
        smoothed = smooth(law)
        low, high = np.percentile(smoothed, (3.0, 97.0))  # about their middle: an encoder's zero says nothing of an end
        middle = 0.5 * (low + high)
        seen = np.clip((barely_smooth(law) - middle) / max(world.limits["play_seen"], 0.5 * (high - low)), -1.0, 1.0)
        seen *= 1.0 - noise_share(smoothed - middle, noise[j])
        borne = barely_smooth(borne)
        loaded = np.clip(np.abs(borne) / sure - 1.0, 0.0, 1.0)
        out[:, j] = loaded * np.sign(borne) + (1.0 - loaded) * seen
    return smooth(out)


def on_flat_soles(where: Masks, residuals: Mapping[str, Array], world: World) -> Masks:
    """Without the ticks at which, by the IMU, it stood on the edge of a foot: rigid soles explain nothing there.

    Unless that is nearly always: then little would be left, and the robot `staggers`.
    """
    tipped = np.zeros(len(where.ticks), dtype=bool)
    for axis in ("roll", "pitch"):
        tilt = residuals.get(f"tilt/{axis}")
        if tilt is not None and where.air[Foot.LEFT].any() and where.air[Foot.RIGHT].any():
            # What it usually is on this foot: an encoder of one leg may be off, or the IMU.
            left, right = (_usual(tilt[where.air[foot]]) for foot in (Foot.RIGHT, Foot.LEFT))
            tipped |= np.abs(tilt - where.share * left - (1.0 - where.share) * right) > world.limits["sole_turned"]
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
    return _flat_only(replace(where, steady=where.steady & ~tipped, double=where.double & ~tipped), ~tipped)


def _usual(values: Array) -> float:
    """The middle of the narrowest range that holds a quarter of the values: most others may be of rocking."""
    values = np.sort(values[np.isfinite(values)])
    if not len(values):
        return 0.0
    count = max(1, len(values) // 4)
    first = int(np.argmin(values[count - 1 :] - values[: len(values) - count + 1]))
    return float(np.median(values[first : first + count]))
