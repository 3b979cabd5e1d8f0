# SPDX-License-Identifier: BSD-3-Clause
"""Springs that are not linear: torque that they transmit beside k deflection + d rate, compiled.

It is computed at every physics step. A disturbance says which law its springs follow, with which values; the laws are
here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ..core.base.compiled import compiled
from ..core.base.types import Array, Integers


class Law(IntEnum):
    """Laws, and the values of a joint that they take; angles in rad, torques in Nm."""

    PLAY = 0  # half width, stiffness, damping of what lies behind the play
    DRIFT = 1  # change of the stiffness in the end, its time constant [s]
    HYSTERESIS = 2  # half width, deflection at which it slips, stiffness, how far it has slipped
    CUBIC = 3  # change of the stiffness [Nm/rad^3], deflection from which it goes on straight
    TANH = 4  # stiffness, bend [1/rad]
    SINH = 5  # stiffness, bend [1/rad]
    TWO_SLOPES = 6  # change of the stiffness beyond the step, deflection of the step
    LINEAR = 7  # change of the stiffness, of the damping
    RAMP = 8  # change of the stiffness in the end, time in which half of it is reached [s]


VALUES = 4  # of the law that takes the most


@dataclass(frozen=True)
class SpringLaw:
    """A law of springs with the values of each joint (n, nj), n as many as it takes; all zero: a linear spring."""

    law: Law
    values: Array
    since: float = -np.inf  # [s] time from which it holds


@dataclass(frozen=True)
class SpringLaws:
    """The laws of all springs, as compiled code takes them; what they remember is in `values`."""

    law: Integers  # (m,)
    since: Array  # (m,) [s]
    values: Array  # (m, nj, VALUES)

    @classmethod
    def of(cls, laws: Sequence[SpringLaw], joints: int) -> SpringLaws:
        """Laws of that many joints."""
        values = np.zeros((len(laws), joints, VALUES))
        for one, law in zip(values, laws, strict=True):
            one[: law.values.shape[1], : len(law.values)] = law.values.T
        since = np.array([law.since for law in laws], dtype=float)
        return cls(np.array([law.law for law in laws], dtype=np.int64), since, values)

    def torque(self, t: float, deflection: Array, rate: Array) -> Array:
        """Torque (nj,) [Nm] at a time [s], deflection motor minus link (nj,) [rad], and its derivative [rad/s]."""
        torque = np.zeros(len(deflection))
        add_torques(torque, self.law, self.since, self.values, t, deflection, rate)
        return torque


@compiled
def add_torques(
    torque: Array, law: Integers, since: Array, values: Array, t: float, deflection: Array, rate: Array
) -> None:
    """Add the torques of all laws that hold at t; see SpringLaws. Drift counts from when its law begins.

    Slips that friction holds, play and the spring are in series: the spring's laws act on what the others leave. Of
    several slips the one that gives way first is listed first.
    """
    for j in range(len(torque)):
        stretch, speed = deflection[j], rate[j]
        free, stiffness, damping = 0.0, 0.0, 0.0
        for m in range(len(law)):
            if law[m] == Law.PLAY and t >= since[m] and values[m, j, 0] > 0.0:
                free += values[m, j, 0]
                stiffness, damping = values[m, j, 1], values[m, j, 2]
        for m in range(len(law)):
            if law[m] == Law.HYSTERESIS and t >= since[m]:
                stretch -= values[m, j, 3]
        for m in range(len(law)):
            if law[m] == Law.HYSTERESIS and t >= since[m]:
                stretch -= _slip(values[m, j], stretch, free)
                torque[j] -= values[m, j, 2] * values[m, j, 3]
        if free > 0.0:
            torque[j] -= stiffness * _within(stretch, free)
            if abs(stretch) < free:
                torque[j] -= damping * speed
                speed = 0.0
            stretch -= _within(stretch, free)
        for m in range(len(law)):
            if law[m] != Law.HYSTERESIS and law[m] != Law.PLAY and t >= since[m]:
                torque[j] += _torque(law[m], values[m, j], t - max(since[m], 0.0), stretch, speed)


@compiled
def _slip(v: Array, stretch: float, free: float) -> float:
    """How far a lost motion slips now; its values v remember how far in all.

    Args:
        v: of the law.
        stretch: what all slips before have left.
        free: half width of the play behind it.
    """
    before, reach = v[3], v[1] + free
    v[3] = _within(before + stretch - _within(stretch, reach), v[0])
    return v[3] - before


@compiled
def _torque(law: int, v: Array, t: float, deflection: float, rate: float) -> float:
    if law == Law.DRIFT:
        return v[0] * (1.0 - math.exp(-max(t, 0.0) / v[1])) * deflection if v[0] != 0.0 else 0.0
    if law == Law.RAMP:
        return v[0] * _within(0.5 * max(t, 0.0) / v[1], 1.0) * deflection if v[0] != 0.0 else 0.0
    if law == Law.CUBIC:
        bent = _within(deflection, v[1])
        return v[0] * (bent**3 + 3.0 * bent**2 * (deflection - bent))
    if law == Law.TANH:
        return v[0] * (math.tanh(v[1] * deflection) / v[1] - deflection) if v[1] != 0.0 else 0.0
    if law == Law.SINH:
        return v[0] * (math.sinh(v[1] * deflection) / v[1] - deflection) if v[1] != 0.0 else 0.0
    if law == Law.LINEAR:
        return v[0] * deflection + v[1] * rate
    beyond = max(abs(deflection) - v[1], 0.0)  # TWO_SLOPES
    return v[0] * math.copysign(beyond, deflection)


@compiled
def _within(x: float, limit: float) -> float:
    return min(max(x, -limit), limit)
