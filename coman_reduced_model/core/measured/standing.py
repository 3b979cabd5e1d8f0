# SPDX-License-Identifier: BSD-3-Clause
"""How both soles lie to each other by the encoders while the robot stands on them.

Soles that are flat on one floor are parallel, but by the encoders they are not: zeros of a few milliradians in each of
twelve joints add up to a degree. A model that makes them parallel bends its springs by that much. What the soles are
when both stand, by the encoders, is what they return to at each landing.
"""

from __future__ import annotations

from math import expm1
from typing import TYPE_CHECKING

import numpy as np

from ..base.types import Array, Foot, Phase, SupportState

if TYPE_CHECKING:
    from ..robot.robot import Posture

LOADED = 0.25  # share of the load that each foot must bear
SETTLED = 0.3  # [s] of double support after which both soles are flat: a step takes less
MEMORY = 2.0  # [s] of standing that count
STEP = 0.015  # [m] by which the height of a landing sole is off where the ground has a step
LONGEST = 0.1  # [s] that one sample counts for at most
_PLANE = [3, 0, 1]  # of the third row of a pose: height of the origin, and what x and y add to it


class StandingSoles:
    """Mean pose of each sole against the other, over the time that the robot has stood.

    Attributes:
        seconds: of standing so far.
        aslant: whether the last landing was aslant: how the ground lies under that sole is not known.
        aslant_landings: how many were, since the beginning.
    """

    def __init__(self) -> None:
        self._planes = {Foot.LEFT: np.zeros(3), Foot.RIGHT: np.zeros(3)}
        self.aslant_landings = 0
        self.reset()

    def reset(self) -> None:
        """Forget the past: soles are parallel again."""
        self.seconds, self.aslant, self._stepped = 0.0, False, False
        self._forget()

    def _forget(self) -> None:
        self._step: dict[Foot, float] = {}  # heights where the last landing met a step
        for plane in self._planes.values():
            plane[:] = 0.0

    def update(self, link: Posture, support: SupportState, dt: float) -> None:
        """Take one sample: link side, support phase, and time since the last sample [s].

        Where the first sample shows both feet loaded, its pose counts until the robot has stood or lifts a foot.
        """
        if support.phase != Phase.DOUBLE:
            self._stepped = True
            if self.seconds == 0.0:
                self._forget()
            return
        settled, known = support.phase_time >= SETTLED, self.seconds > 0.0
        first = support.phase_time == 0.0 and not known
        if not LOADED <= support.left_share <= 1.0 - LOADED or not (settled or first):
            return
        share = 1.0
        if settled:
            dt = min(max(dt, 0.0), LONGEST)
            self.seconds += dt
            share = -expm1(-dt / min(self.seconds, MEMORY)) if known else 1.0
            for foot, height in self._step.items():
                self._planes[foot][0] = height
            self._step = {}
        for foot, plane in self._planes.items():
            plane += share * (link.sole_pose(foot, foot.other)[2, _PLANE] - plane)

    def land(self, link: Posture, foot: Foot) -> None:
        """Take a landing, link side, beside the support foot: where it shows a step, the ground is as high as that.

        On a step one sole sees the other as far up as it is seen down. A foot that only brushes the ground is aslant.
        The lowest corner of the landing sole is on the ground. A second look at the same landing does not count as
        another one.
        """
        T = link.sole_pose(foot, foot.other)
        self.aslant = bool(abs(T[2, 3] + link.sole_pose(foot.other, foot)[2, 3]) > STEP)
        self.aslant_landings += self.aslant and self._stepped
        self._stepped = False
        if self.aslant:
            return
        edges = link.robot.soles[foot.other]
        height = float(T[2, 3] + min(T[2, 0] * edges[:2]) + min(T[2, 1] * edges[2:]))
        met = abs(height - self._planes[foot][0]) > STEP
        self._step = {foot: height, foot.other: -height} if met else {}

    def planes(self) -> dict[Foot, Array]:
        """By support foot, the ground under the other sole (3,): height at its origin [m], by its x and y [1]."""
        out = {foot: plane.copy() for foot, plane in self._planes.items()}
        for foot, height in self._step.items():
            out[foot][0] = height
        return out
