# SPDX-License-Identifier: BSD-3-Clause
"""Tells that a steady gait was upset: the pressure under the stance foot leaves its place from one step to the next.

The centre of pressure of a single support obeys no law that a reduced model knows: it is where the robot happens to
put it. But the same motion brings the same pressure, step for step, to a millimetre or two, and a push or pull of one
per cent of the weight moves it by ten. So steps are held against the steps of the same foot before them. A gait that
loses its balance by itself does so over several strides, and a stumble is over after two steps: told is what follows
upon `_CALM` calm steps at once and lasts for `_LASTS` steps of `_WITHIN`, while the motors go as they went.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .types import Array, Foot

_SPREAD, _LEAST = 0.005, 0.0036  # of the COM's height: usual scatter of a step's pressure, and the least believed
_CALM, _QUIET = 4, 1.5  # steps in a row that are calm, and standard deviations which they keep within
_EDGE = 0.3  # share of a step at the edge of its sole, beyond which it is not calm
_OFF = 3.0  # standard deviations beyond which a step is off
_LASTS, _WITHIN = 3, 5  # steps that are off, of so many
_GAIN, _FOLLOW = 0.4, 0.15  # by which place and variance follow a step
_SAME, _PACE = 0.02, 0.03  # [rad] of reach and [1] of speed, by which motors differ that go the same way


@dataclass
class _Place:
    """Where the pressure of a foot is [m], and the variance along an axis by which it scatters [m^2]."""

    at: Array
    variance: float
    steps: int = 0


@dataclass(frozen=True)
class Step:
    """A single support.

    Attributes:
        foot: that bears.
        began: when [s].
        pressure: (2,) mean centre of pressure in the sole [m].
        at_edge: share of the single support in which that is at the sole's edge.
        walked: (3, nl) lowest and highest position of the motors (of the joints, where only these are known) since the
            single support before it, and how far they went [rad].
        seconds: since then [s].
    """

    foot: Foot
    began: float
    pressure: Array
    at_edge: float
    walked: Array
    seconds: float


@dataclass(frozen=True)
class Told:
    """An upset.

    Attributes:
        off: (2,) the pressure in the worst of the steps that tell of it, against its place before [m].
        foot: that bore in it.
        sigma: standard deviations by which all of them are off at least.
        since: when the first of them began [s].
    """

    off: Array
    foot: Foot
    sigma: float
    since: float


class Upset:
    """Watches the steps of one robot, whose COM is so high [m].

    Attributes:
        told: what there is to tell.
    """

    def __init__(self, height: float) -> None:
        self._spread, self._least = (_SPREAD * height) ** 2, (_LEAST * height) ** 2
        self.reset()

    def reset(self) -> None:
        """The robot stands, or goes another way: steps before tell nothing of those to come."""
        self._last: Step | None = None
        self._halved = False  # the foot in the air touched the ground in the course of the last step
        self._places: dict[Foot, _Place] = {}
        self._before: list[tuple[Step, float]] = []  # and by how many standard deviations they were off
        self._calm: list[Step] = []  # before the first of `_after`
        self._after: list[tuple[Step, float]] = []  # since the first that was off
        self.told: Told | None = None

    @property
    def seen(self) -> float:
        """When the last step began that was off, while one is told of [s]."""
        return max(step.began for step, sigma in self._after if sigma > _OFF)

    def take(self, step: Step) -> None:
        """A single support has ended; it counts when that of the other foot has: halves of a step are like no step."""
        if not np.isfinite(step.pressure).all():
            return
        last, self._last = self._last, step
        again = last is not None and last.foot == step.foot
        if last is not None and not again and not self._halved:
            self._count(last)
        self._halved = again

    def _count(self, step: Step) -> None:
        place = self._places.setdefault(step.foot, _Place(step.pressure, self._spread))
        off = step.pressure - place.at
        square = float(off @ off)
        sigma = float(np.sqrt(square / (place.variance * (1.0 + 1.0 / max(1, place.steps)))))
        known = place.steps > 1
        if self._after:
            self._judge(step, sigma)
        elif known and sigma > _OFF and (calm := self._calm_before()):
            self._calm, self._after = calm, [(step, sigma)]
        if self._after:
            return
        self._before = [*self._before[-_CALM:], (step, sigma if known and step.at_edge < _EDGE else np.inf)]
        if sigma < _OFF or not known:
            place.variance = max(place.variance + _FOLLOW * (0.5 * square - place.variance), self._least)
        place.steps += 1
        place.at = place.at + off * max(_GAIN, 1.0 / place.steps)

    def _calm_before(self) -> list[Step]:
        """The calm steps before the next one; the last one may be the one in whose course it began."""
        for last in (len(self._before), len(self._before) - 1):
            calm = self._before[max(0, last - _CALM) : last]
            if len(calm) == _CALM and all(sigma < _QUIET for _, sigma in calm):
                return [step for step, _ in calm]
        return []

    def _judge(self, step: Step, sigma: float) -> None:
        """One more step after the first that was off."""
        self._after = [*self._after[1 - _WITHIN :], (step, sigma)]
        off = [each for each in self._after if each[1] > _OFF]
        if len(off) >= _LASTS and not _go_the_same_way(self._calm, [each for each, _ in self._after]):
            self.reset()
            return
        if len(off) >= _LASTS and self.told is None:
            worst = max(off, key=lambda each: each[1])[0]
            away = worst.pressure - self._places[worst.foot].at
            self.told = Told(away, worst.foot, min(each for _, each in off), off[0][0].began)
        if len(self._after) == _WITHIN and (not off if self.told else len(off) < _LASTS):  # a stumble, or it is over
            self.told, self._before, self._after = None, [], []


def _go_the_same_way(some: list[Step], others: list[Step]) -> bool:
    """Whether motors do in some steps what they do in others, as fast; three or more show how far they go."""
    (low, high, speed), (low_2, high_2, speed_2) = _gait(some), _gait(others)
    reach = max(np.abs(low - low_2).max(), np.abs(high - high_2).max())
    return bool(reach < _SAME and abs(speed_2 / speed - 1.0) < _PACE)


def _gait(steps: list[Step]) -> tuple[Array, Array, float]:
    """(nl,) lowest and highest position of the motors [rad], and how fast all of them go together [rad/s]."""
    walked, seconds = np.array([step.walked for step in steps]), sum(step.seconds for step in steps)
    return walked[:, 0].min(axis=0), walked[:, 1].max(axis=0), float(walked[:, 2].sum() / seconds)
