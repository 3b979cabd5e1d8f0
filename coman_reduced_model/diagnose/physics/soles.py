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
from ..data.signals import without_noise
from ..data.world import World
from .balance import State, evaluate

LAWS = tuple(f"{law}/{axis}" for law in ("force", "moment") for axis in "xy") + tuple(
    f"{law}/{axis}" for law in ("feet", "tilt") for axis in ("roll", "pitch")
)
STEP = 0.001  # [rad] by which a foot turns that bears the weight at its front edge, for the difference quotient
LEAST = 24  # ticks of a law in one kind of support
ROUNDS = 3


def softness(recording: Recording, world: World, where: Masks, measured: State) -> float:
    """Of the soles, as `World` has it [rad/Nm]: what explains most of the laws that it bends; 0 where none shows it.

    Each law counts with what is left of it. Means are left out: zeros of sensors would be in them.

    Args:
        measured: state of the recording with rigid soles.
    """
    quiet = evaluate(without_noise(recording, world), world, where)
    step = STEP / (world.robot.mass * world.gravity * 0.5 * world.robot.config.foot_length)
    moved = evaluate(quiet.recording, world.changed(softness=step), where, quiet).residuals
    groups: list[tuple[Array, Array]] = []
    for name in LAWS:
        row = measured.residuals.get(name, np.full(len(where.ticks), np.nan))
        by = (quiet.residuals.get(name, row) - moved.get(name, row)) / step
        for _, chosen in parts(where, name):
            shown = np.flatnonzero(chosen & np.isfinite(row) & np.isfinite(by))
            if len(shown) >= LEAST:
                groups.append((row[shown] - row[shown].mean(), by[shown] - by[shown].mean()))
    found = 0.0
    for _ in range(ROUNDS if groups else 0):
        weights = [1.0 / max(float(np.mean((r - found * c) ** 2)), 1e-18) for r, c in groups]
        precision = sum(w * float(c @ c) for w, (_, c) in zip(weights, groups, strict=True))
        found = sum(w * float(c @ r) for w, (r, c) in zip(weights, groups, strict=True)) / max(precision, 1e-18)
    return max(found, 0.0)
