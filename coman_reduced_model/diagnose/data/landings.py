# SPDX-License-Identifier: BSD-3-Clause
"""Landings: how far each foot slides after it has touched the ground, and the blow that it gets from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ...core.base.types import Array, Booleans, Foot, Integers, Phase
from ...core.effects.foot_slip import SLIPS_TO, glide
from .recording import FEET, RATE, Recording
from .strides import SWING_S
from .world import World

CONTACT_S = 0.06  # [s] around a change of contact where the balance is left out: rigid bodies do not explain impacts
_BLOW, _BESIDE = 3, 2  # samples that a blow lasts at most, and before and after it, where the load is felt
_LANDING_S = 0.16  # [s] after a foot has touched the ground until its blow is over: its edge may touch long before
_SELDOM_S = 0.0085  # [s] between samples, from which on a blow cannot be seen
_LANDED_S = (0.02, 0.055)  # [s] after the landing: where it came down
_SLID_S = 0.03  # [s] where it is at the end of its slide, or so long before the other foot begins to leave the ground
_SHORTEST_SLIDE_S = 0.12  # [s] after the landing, until then the other foot has to stand


@dataclass(frozen=True)
class Slide:
    """A landing after which the other foot stands for long enough that a slide would show."""

    tick: int  # before it
    foot: Foot  # that has landed
    first: slice  # of the grid: it has just come down
    last: slice  # ... and slid
    share: float  # of a slide that is gone by between the two


def usual_slides(recording: Recording, ticks: Integers, world: World) -> tuple[Slide, ...]:
    """Landings whose slides are much like most of the same foot: when a robot stumbles, it does so now and then."""
    slides = _slides(recording, ticks)
    whole = slide_lengths(world, recording.q, slides) / np.array([slide.share for slide in slides])
    usual = np.zeros(len(slides), dtype=bool)
    for foot in FEET:
        mine = np.array([slide.foot == foot for slide in slides], dtype=bool)
        if not mine.any():
            continue
        alike = _alike(whole[mine], world.limits["slide_apart"], world)
        if alike.mean() > 0.5:
            usual[np.flatnonzero(mine)[alike]] = True
    return tuple(slide for slide, kept in zip(slides, usual, strict=True) if kept)


def _slides(recording: Recording, ticks: Integers) -> tuple[Slide, ...]:
    """Landings at which a slide would show."""
    out = []
    for landed, tick, left, i, leaves in _landings(recording.phase, ticks):
        end = min(i + round(SLIPS_TO * RATE), leaves - round(CONTACT_S * RATE))
        chatters = i - left < SWING_S * RATE
        if chatters or end - i < _SHORTEST_SLIDE_S * RATE or not recording.valid[i:end].all():
            continue
        first = slice(i + round(_LANDED_S[0] * RATE), i + round(_LANDED_S[1] * RATE))
        last = slice(end - round(_SLID_S * RATE), end)
        gone = [np.mean([glide((k - i) / RATE)[0] for k in range(w.start, w.stop)]) for w in (first, last)]
        out.append(Slide(tick, landed, first, last, float(gone[1] - gone[0])))
    return tuple(out)


def slide_lengths(world: World, q: Array, slides: Sequence[Slide]) -> Array:
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


def blows(recording: Recording, ticks: Integers, world: World) -> Array:
    """(m,) [Ns] of the blows at landing, at the tick before; NaN elsewhere.

    Beyond what shakes the foot as long afterwards, when it stands.
    """
    out, shaken, n = np.full(len(ticks), np.nan), list[float](), round(_LANDING_S * RATE)
    of_foot: dict[Foot, list[int]] = {foot: [] for foot in FEET}
    if recording.period > _SELDOM_S:
        return out
    for landed, tick, left, i, leaves in _landings(recording.phase, ticks):
        end, force = min(i + n, leaves), recording.wrench[landed][:, 2]
        if i - left >= SWING_S * RATE and recording.valid[i - 1 : end].all():
            out[tick] = blow(force[i:end])
            of_foot[landed].append(tick)
            lifts = i + int(np.argmax(np.append(~np.isin(recording.phase[i:], (landed, Phase.DOUBLE)), True)))
            for k in range(i + n, lifts - n + 1, n):
                window = slice(k - _BESIDE, k + n)
                shaken += [_largest(force[window])] if recording.valid[window].all() else []
    if not shaken:
        return np.full(len(ticks), np.nan)
    least = world.limits["blow_apart"] * world.robot.mass
    # A blow that comes after the next foot has left is not seen: most landings decide, if they are alike.
    for landings in of_foot.values():
        seen = np.array([tick for tick in landings if np.isfinite(out[tick])], dtype=np.intp)
        if len(seen) and (alike := _alike(out[seen], least, world)).mean() > 0.5:
            out[seen[~alike]] = np.nan
    return np.asarray(out - np.mean(shaken))


def blow(force: Array) -> float:
    """The largest impulse [Ns] of a few samples beyond what the foot bears before and after, at RATE.

    A force (n,) [N] that only rises after the landing gives nothing; NaN if there is too little of it. The node
    (monitor/laws.py) judges a landing by its first touch; this also finds the blow of a foot whose edge came first.
    """
    if len(force) < _BLOW + _BESIDE:
        return float("nan")
    return _largest(np.concatenate([np.zeros(_BESIDE), force]))  # in the air before


def _largest(force: Array) -> float:
    """The same of a force (n,) [N] that begins with what is borne before."""
    around = sliding_window_view(force, _BLOW + 2 * _BESIDE)
    before, felt, after = np.split(around, [_BESIDE, _BESIDE + _BLOW], axis=1)
    borne = np.maximum(before.mean(axis=1), after.mean(axis=1)).clip(0.0)
    return max(0.0, float((felt - borne[:, None]).sum(axis=1).max()) / RATE)


def _landings(phase: Integers, ticks: Integers) -> Iterator[tuple[Foot, int, int, int, int]]:
    """Each foot that lands, the tick before it, and on the grid when it left the ground, lands, and what is next."""
    changes = np.concatenate([[0], np.flatnonzero(np.diff(phase)) + 1, [len(phase)]])
    for left, i, leaves in zip(changes[:-2], changes[1:-1], changes[2:], strict=True):
        tick = int(np.searchsorted(ticks, i)) - 1
        if tick >= 0 and phase[i] == Phase.DOUBLE and phase[i - 1] in (Phase.LEFT, Phase.RIGHT):
            yield Foot(phase[i - 1]).other, tick, left, i, leaves


def _alike(values: Array, least: float, world: World) -> Booleans:
    """(k,) those of values (k,) that are much like their median: within `least`, or a share of it."""
    middle = float(np.median(values))
    return np.asarray(np.abs(values - middle) < max(least, world.limits["share_apart"] * abs(middle)))
