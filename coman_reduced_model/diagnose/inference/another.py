# SPDX-License-Identifier: BSD-3-Clause
"""What another recording would add: one that is like those at hand, of a common length, or an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from ...core.base.nominal import Nominal
from ...core.base.types import Array
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import Unknown
from ..data.masks import TICKS
from ..physics.hypotheses import Candidate, unknowns
from .case import Case, Prepared, examine
from .check import with_common_streams
from .evidence import Problem, weighed
from .isolability import APART, Isolability
from .noise import Noise

LENGTH = 20.0  # [s] of a recording, that another one is compared at


@dataclass(frozen=True)
class Another:
    """What another recording would add to those at hand.

    Attributes:
        name: of its bag; again: it is one of those at hand, recorded once more.
        lasts: how long it is, without gaps [s].
        found: what those at hand can distinguish together with LENGTH of it.
    """

    name: str
    again: bool
    lasts: float
    found: Isolability

    def distinguished(self, pairs: Sequence[tuple[int, int]]) -> int:
        """How many pairs of effects it distinguishes."""
        return sum(self.found.apart(pair) >= APART for pair in pairs)


def best_first(found: Sequence[Another], pairs: Sequence[tuple[int, int]]) -> list[Another]:
    """By how many pairs each distinguishes, then by how many effects show."""
    return sorted(found, key=lambda each: (-each.distinguished(pairs), len(each.found.hidden)))


def length_of(cases: Sequence[Case]) -> float:
    """Of recordings or parts of one, without gaps [s]."""
    return float(sum(case.where.complete.sum() for case in cases)) / TICKS


def like(cases: Sequence[Case], known: Sequence[Unknown], seconds: float = LENGTH) -> Array:
    """Information (P, P) on the parameters `known` of another recording like some cases.

    One that is n times as long says n times as much, less what its laws miss in each stride alike, or all the time.

    Args:
        cases: a recording, or its parts; their parameters are some of those known.
        seconds: how long the other one is.
    """
    n = seconds / length_of(cases)
    each = (weighed(case.problem, case.evidence.at, _of_more(case.problem, case.noise, n)) for case in cases)
    whole = reduce(add, each)
    place = {unknown.name: i for i, unknown in enumerate(known)}
    at = [place[unknown.name] for unknown in whole.unknowns]
    out = np.zeros((len(known), len(known)))
    out[np.ix_(at, at)] = replace(whole, gram=n * whole.gram).shared().gram
    return out


def _of_more(problem: Problem, noise: Mapping[str, Noise], n: float) -> dict[str, Noise]:
    """The noise with which a recording says an n-th of what one does that is n times as long.

    Its errors at random average out over n times as many values. What repeats does not, nor the offset of a phase that
    lasts as long as the recording.
    """
    more, out = float(np.sqrt(n)), {}
    for key, each in noise.items():
        offset = each.offset * (more if len(problem.pieces[key]) == 1 else 1.0)
        out[key] = Noise(each.autoregression, offset, more * each.repeats)
    return out


def shown_by(effects: Sequence[Candidate], known: Sequence[Unknown], again: Array, nominal: Nominal) -> Array:
    """Information (P, P) of an experiment, which measures parameters, or is another walk without the effects.

    Args:
        effects: whose experiment it is, each at its place.
        known: all parameters; again: information of another recording like one of those at hand.
    """
    mine = [i for option in effects for i in option.unknowns]
    if CATALOGUE[effects[0].effect].absent:
        there = np.ones(len(known))
        there[mine] = 0.0
        return np.asarray(again * np.outer(there, there))
    out = np.zeros_like(again)
    for i in mine:
        out[i, i] = (nominal.limits["experiment"] * known[i].reach) ** -2
    return out


def examined(prepared: Prepared, at_hand: Prepared, known: Sequence[Unknown], nominal: Nominal) -> Case:
    """A further recording, linear about nominal, with those parameters of the ones at hand that it depends on.

    What they did not measure it does not show either; what it did not measure it says nothing of.

    Args:
        prepared: the further recording; at_hand: one of the others, with the streams that all of them have.
        known: parameters of those.
    """
    _, (recording, world, where) = with_common_streams([at_hand, prepared])
    its = {unknown.name for unknown in unknowns(recording, world, nominal)}
    shown = [unknown for unknown in known if unknown.name in its]
    return examine((recording, world, where), shown, np.zeros(len(shown)), nominal=nominal)
