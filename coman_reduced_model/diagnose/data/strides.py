# SPDX-License-Identifier: BSD-3-Clause
"""Where in its stride a walking robot is: what a model misses there, it misses again in the next stride."""

from __future__ import annotations

import numpy as np

from ...core.base.types import Array, Integers, Phase

SWING_S = 0.15  # [s] in the air, after which a foot lands: else it only chatters
FEWEST = 3  # landings of a foot that make strides
HARMONICS = 6  # of a stride; what is faster does not repeat


def in_stride(phase: Integers, rate: float) -> Array:
    """(n,) landings of the left foot so far, counted with their fractions; NaN of a robot that hardly walks.

    Args:
        phase: (n,) of Phase, on a grid with a rate [Hz].
    """
    stands = np.concatenate([[True], (phase == Phase.LEFT) | (phase == Phase.DOUBLE)])
    lifted, landed = np.flatnonzero(stands[:-1] & ~stands[1:]), np.flatnonzero(~stands[:-1] & stands[1:])
    last = np.searchsorted(lifted, landed, side="right") - 1  # each landing follows a lift-off
    landed = landed[landed - lifted[last] >= SWING_S * rate] if len(landed) else landed
    if len(landed) < FEWEST:
        return np.full(len(phase), np.nan)
    usual = float(np.median(np.diff(landed)))
    before, after = np.ceil(landed[0] / usual), np.ceil((len(phase) - landed[-1]) / usual)
    knots = np.concatenate(
        [landed[0] - usual * np.arange(before, 0, -1), landed, landed[-1] + usual * np.arange(1, after + 1)]
    )
    return np.asarray(np.interp(np.arange(len(phase)), knots, np.arange(len(knots)) - before))


def repeating(stride: Array) -> Array:
    """(n, 1 + 2 HARMONICS) functions that repeat with each stride (n,), of mean square 1."""
    angles = 2.0 * np.pi * stride[:, None] * np.arange(1, HARMONICS + 1)
    waves = np.sqrt(2.0) * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.column_stack([np.ones(len(stride)), waves])
