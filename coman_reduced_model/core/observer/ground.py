# SPDX-License-Identifier: BSD-3-Clause
"""Velocity of the COM against the ground, where the support sole tilts: the filter of the COM, with the sole's motion.

In the frame of a sole that rolls over its edge or on soft ground the COM moves otherwise than forces say. The IMU and
the encoders together say how the sole tilts; it turns about the centre of pressure. What that moves the COM by is added
to the measured COM, so that a second filter of `memory.py` follows a motion that Newton's law holds for.
"""

from __future__ import annotations

import numpy as np

from ..base.compiled import compiled
from ..base.types import Array
from .memory import GOES_ON, Noise, memory_of, take

LOADED = 0.1  # of the weight: load from which on a centre of pressure counts; below, the sole turns about its origin


@compiled
def follow_ground(
    block: Array, state: Array, other_block: Array, noise: Noise, step: tuple[int, float, int],
    wrenches: tuple[Array, Array], posture: tuple[Array, Array, Array], turned: Array, measured: tuple[Array, Array],
    out: Array,
) -> None:  # fmt: skip
    """Bring the filter to a sample.

    Args:
        block: of its `Memory`.
        state: (2, 3) tilt of the sole at the last sample [rad], what it has moved the COM by [m]; changed in place.
        other_block: of the `Memory` of the filter that takes the sole as fixed, at this sample.
        noise, step, out: as in `take`.
        wrenches: own, other there.
        posture: orientations (3, 3) of support sole, other sole and trunk in the base frame.
        turned: (3, 3) of the trunk in the level frame, estimated.
        measured: COM and its velocity there.
    """
    (own, other), (R, R_other, R_trunk), (com, com_vel) = wrenches, posture, measured
    memory, fixed, tilt, moved = memory_of(block), memory_of(other_block), np.zeros(3), np.empty(3)
    memory.rounding[:], memory.constants[:] = fixed.rounding, fixed.constants
    for k in range(3):  # against gravity in the axes of the sole: (-pitch, roll, 1)
        for m in range(3):
            tilt[0] += turned[2, k] * R_trunk[m, k] * R[m, 1]
            tilt[1] -= turned[2, k] * R_trunk[m, k] * R[m, 0]
    if step[0] != GOES_ON:
        state[0], state[1] = tilt, 0.0
    x, y, z = com[0], com[1], com[2]
    if own[2] > LOADED * noise.mass * noise.gravity:
        x += own[4] / own[2]
        y -= own[3] / own[2]
    roll, pitch = tilt[0] - state[0, 0], tilt[1] - state[0, 1]
    state[0] = tilt
    state[1, 0] += pitch * z
    state[1, 1] -= roll * z
    state[1, 2] += roll * y - pitch * x
    for i in range(3):
        moved[i] = com[i] + state[1, i]
    take(block, noise, step, own, other, R, R_other, moved, com_vel, out)
