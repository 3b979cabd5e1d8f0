# SPDX-License-Identifier: BSD-3-Clause
"""How soft the soles of a robot are, or its ground: most of what flat, rigid soles leave of a nominal robot's laws.

A foot turns against the moment of the ground, and the whole robot with it: its wrenches then hold what no motion with
rigid soles explains, and derivatives along such a motion would have the wrong sign. So this comes before anything else.
"""

from __future__ import annotations

import numpy as np

from ...core.base.types import Array
from ..data.masks import Masks, parts
from ..data.recording import Recording
from ..data.world import World
from .balance import State, evaluate

LAWS = tuple(f"{law}/{axis}" for law in ("force", "moment") for axis in "xy") + tuple(
    f"{law}/{axis}" for law in ("feet", "tilt") for axis in ("roll", "pitch")
)
STEP = 0.001  # [rad] by which a foot turns that bears the weight at its front edge, for the difference quotient
LEAST = 24  # ticks of a law in one kind of support
ROUNDS = 3


def softness(quiet: Recording, world: World, where: Masks, measured: State) -> float:
    """Of the soles, as `World` has it [rad/Nm]: what explains most of the laws that it bends; 0 where none shows it.

    Each law counts with what is left of it. Means on each foot are left out: zeros of sensors would be in them, and
    those of encoders differ from leg to leg.

    Args:
        quiet: the recording without most of its noise, along which derivatives are taken.
        where: what is flat with rigid soles, or with those of a first guess.
        measured: state of the recording with rigid soles.
    """
    state = evaluate(quiet, world, where)
    step = STEP / (world.robot.mass * world.gravity * 0.5 * world.robot.sole_length)
    moved = evaluate(quiet, world.changed(softness=step), where, state).residuals
    groups: list[tuple[Array, Array]] = []
    for name in LAWS:
        row = measured.residuals.get(name, np.full(len(where.ticks), np.nan))
        by = (state.residuals.get(name, row) - moved.get(name, row)) / step
        for _, chosen in parts(where, name):
            shown = np.flatnonzero(chosen & np.isfinite(row) & np.isfinite(by))
            if len(shown) >= LEAST:
                usual = np.column_stack([np.ones(len(shown)), where.share[shown]])
                both = np.column_stack([row, by])[shown]
                groups.append(tuple((both - usual @ np.linalg.lstsq(usual, both)[0]).T))
    found = 0.0
    for _ in range(ROUNDS if groups else 0):
        weights = [1.0 / max(float(np.mean((r - found * c) ** 2)), 1e-18) for r, c in groups]
        precision = sum(w * float(c @ c) for w, (_, c) in zip(weights, groups, strict=True))
        found = sum(w * float(c @ r) for w, (r, c) in zip(weights, groups, strict=True)) / max(precision, 1e-18)
    return max(found, 0.0)
