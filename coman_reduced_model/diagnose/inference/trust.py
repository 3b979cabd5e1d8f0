# SPDX-License-Identifier: BSD-3-Clause
"""How far each law is to be trusted: what it says of a robot in one recording must hold in its next one.

The noise of a law is that of its own residuals (`noise.py`). What the model itself misses is no noise: it is fitted by
the robot's parameters, differently in each gait. So a law may be sure of what the next recording denies. Its `trust` is
the share of its information with which recordings of the same robot agree best:

    sum over robots of  log p(all recordings | one robot) - sum over its recordings of log p(recording | a robot)

is largest (the log Bayes factor for one robot). Nothing but recordings of nominal robots is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from ...core.base.types import Array, Integers
from ...core.effects.unknown import Unknown
from .case import Case
from .evidence import Evidence, prior_variance, weighed
from .floor import law_of
from .variability import with_widths

PRICE = 0.25  # nats by which a trust of 1/e must be better than full trust; without evidence trust is full
LEAST, FIRST = 3e-4, 0.1  # trust of a law, and where it begins to be looked for
WORST = -50.0  # nats, from which on disagreement counts by its logarithm: few robots with a fault must not rule
STEPS = 20  # of the optimiser


@dataclass(frozen=True)
class Part:
    """What one law says in a recording of the unknowns `at`, their indices (k,): gram (k, k) and moment (k,)."""

    at: Integers
    gram: Array
    moment: Array
    energy: float
    count: int


@dataclass(frozen=True)
class ByLaw:
    """Evidence of one recording, linear about nominal, by law, as each law takes itself: with full trust."""

    unknowns: list[Unknown]
    parts: Mapping[str, Part]

    def evidence(self, trust: Mapping[str, float]) -> Evidence:
        """The sum, with a trust of each law (1 where none is given)."""
        size = len(self.unknowns)
        gram, moment, energy, count = np.zeros((size, size)), np.zeros(size), 0.0, 0
        for law, part in self.parts.items():
            share = trust.get(law, 1.0)
            gram[np.ix_(part.at, part.at)] += share * part.gram
            moment[part.at] += share * part.moment
            energy += share * part.energy
            count += part.count
        return Evidence(self.unknowns, np.zeros(size), gram, moment, energy, count)


def by_law(case: Case) -> ByLaw:
    """Of a case that is linear about nominal."""
    parts: dict[str, Part] = {}
    for law in sorted({law_of(key) for key in case.problem.rows}):
        rows = {key: row for key, row in case.problem.rows.items() if law_of(key) == law}
        each = weighed(replace(case.problem, rows=rows, trust={}), case.evidence.at, case.noise)
        at = np.flatnonzero(each.gram.any(axis=0))
        parts[law] = Part(at, each.gram[np.ix_(at, at)], each.moment[at], each.energy, each.count)
    return ByLaw(case.evidence.unknowns, parts)


def agreement(recordings: Sequence[ByLaw], widths: Mapping[str, float], trust: Mapping[str, float]) -> _Value:
    """Log Bayes factor [nats] for one robot in all recordings, and its derivative by the logarithm of each trust."""
    known = with_widths(recordings[0].unknowns, widths)
    scale, own = np.sqrt(prior_variance(known)), np.array([unknown.own for unknown in known])
    shared, mine = int((~own).sum()), int(own.sum())
    place = np.where(own, shared + np.cumsum(own) - 1, np.cumsum(~own) - 1)
    together: list[_Term] = []
    total, slopes = 0.0, dict.fromkeys(trust, 0.0)
    for i, recording in enumerate(recordings):
        terms = []
        for law, part in recording.parts.items():
            s = scale[part.at]
            terms.append((law, place[part.at], s[:, None] * part.gram * s, s * part.moment))
            at = place[part.at] + np.where(own[part.at], i * mine, 0)
            together.append((law, at, *terms[-1][2:]))
        value, slope = _log_evidence(len(known), terms, trust)
        total -= value
        slopes = {law: slopes[law] - slope.get(law, 0.0) for law in slopes}
    value, slope = _log_evidence(shared + len(recordings) * mine, together, trust)
    return total + value, {law: slopes[law] + slope.get(law, 0.0) for law in slopes}


_Term = tuple[str, Integers, Array, Array]  # law, which unknowns; gram and moment by unknowns in units of their prior
_Value = tuple[float, dict[str, float]]


def _log_evidence(size: int, terms: Sequence[_Term], trust: Mapping[str, float]) -> _Value:
    """Log evidence but for the energy, and its derivative by the logarithm of each trust."""
    H, b = np.eye(size), np.zeros(size)
    for law, at, gram, moment in terms:
        H[np.ix_(at, at)] += trust.get(law, 1.0) * gram
        b[at] += trust.get(law, 1.0) * moment
    factor = cho_factor(H, lower=True)
    x, covariance = cho_solve(factor, b), cho_solve(factor, np.eye(size))
    slopes: dict[str, float] = {}
    for law, at, gram, moment in terms:
        change = x[at] @ moment - 0.5 * x[at] @ gram @ x[at] - 0.5 * np.sum(covariance[np.ix_(at, at)] * gram)
        slopes[law] = slopes.get(law, 0.0) + trust.get(law, 1.0) * float(change)
    return 0.5 * float(b @ x) - float(np.log(np.diag(factor[0])).sum()), slopes


def learn_trust(
    robots: Sequence[Sequence[ByLaw]],
    widths: Mapping[str, float],
    each: Callable[..., Iterable[_Value]] = map,
) -> dict[str, float]:
    """By law, the trust with which the recordings of each robot agree best.

    Args:
        robots: recordings of nominal robots, two or more of each.
        widths: how much these robots vary.
        each: calls a function for every robot, as `map` does.
    """
    laws = sorted({law for robot in robots for recording in robot for law in recording.parts})

    def loss(logs: Array) -> tuple[float, Array]:
        trust = dict(zip(laws, map(float, np.exp(logs)), strict=True))
        value, slope = PRICE * float(logs @ logs), 2.0 * PRICE * logs
        for nats, slopes in each(partial(agreement, widths=widths, trust=trust), robots):
            beyond = max(WORST - nats, 0.0)
            value -= nats if nats > WORST else WORST - np.log1p(beyond)
            slope = slope - np.array([slopes[law] for law in laws]) / (1.0 + beyond)
        return value, slope

    first = np.full(len(laws), np.log(FIRST))
    bounds = [(np.log(LEAST), 0.0)] * len(laws)
    found = minimize(loss, first, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS})
    return dict(zip(laws, map(float, np.exp(found.x)), strict=True))
