# SPDX-License-Identifier: BSD-3-Clause
"""The result of the search: the effects that were found, and the residuals that these leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...core.base.nominal import Nominal, load_nominal
from ...core.base.types import Array
from ...core.effects.unknown import Unknown
from ..data.masks import TICKS
from ..physics.hypotheses import Candidate
from .case import Case
from .evidence import Fit, Score
from .explanation import Explanation, Odds

ON_SOLES = {"force", "moment", "torque", "tilt"}  # laws that take the stance sole to be still and flat on the ground
BEST, NORMAL = 0.8, 0.6616  # share of the values that the size is computed from; the RMS of that share of normal ones
JUDGED_S = 2.0  # [s] of a law from which its size is known; less is hardly more than one error of an encoder


@dataclass
class ChosenEffect:
    """A candidate that the search has accepted."""

    option: Candidate
    gain: float  # nats on the training bags
    confirmed: float  # nats on the selecting bags; NaN without
    probability: float = np.nan  # of the group; NaN: it was assumed
    group: tuple[str, ...] = ()  # itself and those that these recordings cannot distinguish from it: `Candidate.name`


@dataclass
class Finding:
    """The result of the search.

    Attributes:
        known: all parameters; at: (P,) deviations from nominal around which the cases below are linear.
        fit: posterior on the training bags, with the chosen effects released.
        first: every candidate before anything was chosen.
        train, hold: the recordings with the chosen effects; before: the same without any.
        steps: by choice, the explanations that were compared and their probabilities; the last one chose nothing.
        nominal: how nominal robots vary.
        confirmed: by chosen effect, evidence on the confirming recordings [nats].
    """

    known: list[Unknown]
    at: Array
    chosen: list[ChosenEffect] = field(default_factory=list)
    fit: Fit | None = None
    first: list[Score] = field(default_factory=list)
    train: list[Case] = field(default_factory=list)
    hold: list[Case] = field(default_factory=list)
    before: tuple[list[Case], list[Case]] = field(default_factory=lambda: ([], []))
    steps: list[tuple[list[Explanation], Odds]] = field(default_factory=list)
    nominal: Nominal = field(default_factory=load_nominal)
    confirmed: dict[str, float] = field(default_factory=dict)

    @property
    def cases(self) -> list[Case]:
        """Of all recordings."""
        return [*self.train, *self.hold]

    def leftover(self) -> dict[str, float]:
        """See `leftover`."""
        assert self.fit is not None
        return leftover(self.cases, self.fit, self.released)

    def gaps(self, before: Case, after: Case) -> tuple[dict[str, Array], dict[str, Array]]:
        """By group, the residuals of a recording without and with the chosen effects, which are all the difference.

        Both have the nominal variability that fits best with the effects. Fitted without them, it would replace them
        as far as it can, and hide the difference.
        """
        assert self.fit is not None
        x = after.own(self.fit, self.released)
        nominal = x.copy()
        nominal[self.released] = 0.0
        return before.left(nominal), after.left(x)

    @property
    def released(self) -> list[int]:
        return [i for effect in self.chosen for i in effect.option.unknowns]


def leftover(cases: Sequence[Case], fit: Fit, released: Sequence[int]) -> dict[str, float]:
    """By group, what the middle recording has left (of two, the worse), in units of the noise floor (see `size`).

    A robot that staggers through one of three walks, or in some steps of each, is not of another kind for that.
    Laws that take the stance sole as flat are not judged where it nearly always stands on an edge, and a recording does
    not count where it shows little of a law (JUDGED_S) and others more than twice as much.
    """
    found: dict[str, list[tuple[int, float]]] = {}
    for case in cases:
        for key, value in case.left(case.own(fit, released)).items():
            if case.floor.get(key, 0.0) > 0.0 and judged(cases, case, key):
                found.setdefault(key, []).append((len(value), size(value) / case.floor[key]))
    out = {}
    for key, each in found.items():
        enough = min(JUDGED_S * TICKS, 0.5 * max(each)[0])
        ratios = sorted(ratio for ticks, ratio in each if ticks >= enough)
        out[key] = ratios[len(ratios) // 2]
    return out


def judged(cases: Sequence[Case], case: Case, key: str) -> bool:
    """Whether a group or channel of a recording counts: of a robot that staggers, only if all recordings do."""
    law = key.partition("/")[0]
    on_soles = law in ON_SOLES or (law == "spring" and case.recording.tau is None)
    return not (on_soles and case.where.staggers) or all(each.where.staggers for each in cases)


def size(values: Array) -> float:
    """Standard deviation about zero by the four fifths of the values that are nearest to it: stumbles do not count."""
    squares = np.sort(values**2)[: max(1, round(BEST * len(values)))]
    return float(np.sqrt(np.mean(squares))) / NORMAL
