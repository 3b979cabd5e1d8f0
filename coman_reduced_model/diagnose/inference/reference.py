# SPDX-License-Identifier: BSD-3-Clause
"""What hypotheses are computed along: a recording with its clocks put right, and a motion without its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.base.types import Array
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import Unknown, applied
from ..data.masks import Masks, with_taken_up
from ..data.recording import Recording
from ..data.signals import once_smooth, white, without_noise
from ..data.world import World
from ..physics.balance import State, balanced, evaluate

GAINS = ("wrench_scale", "sensor_rotation")  # of foot sensors: what they do grows with the wrench
CLOCKS = {name for name, effect in CATALOGUE.items() if effect.clock}  # shifts of streams in time


@dataclass(frozen=True)
class Reference:
    """A recording with its clocks put right: as it was measured, and along a motion without the sensors' noise.

    What a hypothesis changes is computed along the quiet motion: the same noise in a residual and in its derivative
    would bias every inertia and every gain. A delay only moves noise, and a long one is far from linear: it is taken
    off the measurement itself.

    Attributes:
        shifts: (P,) deviations of the parameters of clocks, which the reference has; of others 0.
        gains: (P,) the same of gains of the foot sensors, which the wrenches of the quiet motion have.
    """

    measured: State
    quiet: State
    shifts: Array
    gains: Array


def shifts_of(known: Sequence[Unknown], at: Array) -> Array:
    """Of deviations (P,), those of parameters that shift streams in time; 0 for the others."""
    return np.where([unknown.effect in CLOCKS for unknown in known], at, 0.0)


def gains_of(known: Sequence[Unknown], at: Array) -> Array:
    """Of deviations (P,), those of gains of the foot sensors; 0 for the others."""
    return np.where([unknown.effect in GAINS for unknown in known], at, 0.0)


def reference(
    recording: Recording,
    world: World,
    where: Masks,
    known: Sequence[Unknown],
    at: Array,
    like: Reference | None = None,
) -> Reference:
    """Of a recording with the nominal state of its robot, under a hypothesis (P,) about its clocks and gains.

    Args:
        like: of the same recording under another hypothesis: what is the same is taken over.
    """
    shifts, gains = shifts_of(known, at), gains_of(known, at)
    same_clocks = like is not None and np.array_equal(like.shifts, shifts)
    if like and same_clocks and np.array_equal(like.gains, gains):
        return like
    moved, world = applied(known, shifts, recording, world)
    where = with_taken_up(where, recording, moved, world)
    measured = like.measured if like and same_clocks else evaluate(moved, world, where)
    noise = np.inf if moved.tau is None else once_smooth(white(moved.tau[:: moved.stride]), moved.stride)
    true, _ = applied(known, gains, moved, world)
    quiet = balanced(evaluate(without_noise(true, world), world, where), where, noise)
    if gains.any():
        quiet = _as_read(quiet, where, known, gains)
    return Reference(measured, quiet, shifts, gains)


def _as_read(true: State, where: Masks, known: Sequence[Unknown], gains: Array) -> State:
    """The same state with wrenches as sensors read them that have these gains (P,).

    What taking back a gain changes is a share of what was read, not of the truth.
    """
    recording = true.recording
    units = dict.fromkeys(recording.wrench, np.vstack([np.zeros(6), np.eye(6)]))
    taken_back, _ = applied(known, gains, recording.changed(wrench=units), true.world)
    wrench = {}
    for foot, (zero, *each) in taken_back.wrench.items():
        wrench[foot] = (recording.wrench[foot] - zero) @ np.linalg.inv(np.array(each) - zero)
    return evaluate(recording.changed(wrench=wrench), true.world, where, true)
