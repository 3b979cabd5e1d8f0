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

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from ...core.base.types import Array, Integers
from ...core.effects.unknown import Unknown
from .case import Case
from .evidence import Evidence, Part, parts_of, summed
from .prior import prior_variance
from .variability import with_widths

PRICE = 0.25  # nats by which a trust of 1/e must be better than full trust; without evidence trust is full
LEAST, FIRST = 3e-4, 0.1  # trust of a law, and where it begins to be looked for
WORST = -50.0  # nats, from which on disagreement counts by its logarithm: few robots with a fault must not rule
STEPS = 20  # of the optimiser


@dataclass(frozen=True)
class ByLaw:
    """Evidence of one recording, linear about nominal, by law, as each law takes itself: with full trust."""

    unknowns: list[Unknown]
    parts: Sequence[Part]

    @classmethod
    def of(cls, case: Case) -> ByLaw:
        """Of a case that is linear about nominal."""
        return cls(case.evidence.unknowns, list(parts_of(case.problem, case.noise)))

    def about(self, x: Array) -> ByLaw:
        """The same with deviations (P,) that count from x."""
        return replace(self, parts=[_about(part, x[part.at]) for part in self.parts])

    def evidence(self, trust: Mapping[str, float]) -> Evidence:
        """The sum, with a trust of each law (1 where none is given)."""
        return summed(self.unknowns, np.zeros(len(self.unknowns)), self.parts, trust)


def _about(part: Part, x: Array) -> Part:
    """A part whose unknowns count from x (k,)."""
    change = part.gram @ x
    energy = part.energy - float(x @ (2.0 * part.moment - change))
    return replace(part, moment=part.moment - change, energy=energy)


_Value = tuple[float, dict[str, float]]  # and its derivative by the logarithm of each trust


def agreement(recordings: Sequence[ByLaw], widths: Mapping[str, float], trust: Mapping[str, float]) -> _Value:
    """Log Bayes factor [nats] for one robot in all recordings, and its derivative by the logarithm of each trust."""
    known = with_widths(recordings[0].unknowns, widths)
    scale, own = np.sqrt(prior_variance(known)), np.array([unknown.own for unknown in known])
    shared, mine = int((~own).sum()), int(own.sum())
    place = np.where(own, shared + np.cumsum(own) - 1, np.cumsum(~own) - 1)
    together: list[Part] = []
    total, slopes = 0.0, dict.fromkeys(trust, 0.0)
    for i, recording in enumerate(recordings):
        alone = [_in_units(part, scale, place) for part in recording.parts]
        together += [replace(part, at=np.where(part.at < shared, part.at, part.at + i * mine)) for part in alone]
        value, slope = _log_evidence(len(known), alone, trust)
        total -= value
        slopes = {law: slopes[law] - slope.get(law, 0.0) for law in slopes}
    value, slope = _log_evidence(shared + len(recordings) * mine, together, trust)
    return total + value, {law: slopes[law] + slope.get(law, 0.0) for law in slopes}


def _in_units(part: Part, scale: Array, place: Integers) -> Part:
    """A part for unknowns in units of their scale (P,), at other places (P,)."""
    s = scale[part.at]
    return replace(part, at=place[part.at], gram=s[:, None] * part.gram * s, moment=s * part.moment)


def _log_evidence(size: int, parts: Sequence[Part], trust: Mapping[str, float]) -> _Value:
    """Log evidence but for the energy, of unknowns in units of their prior."""
    H, b = np.eye(size), np.zeros(size)
    for part in parts:
        H[np.ix_(part.at, part.at)] += trust.get(part.law, 1.0) * part.gram
        b[part.at] += trust.get(part.law, 1.0) * part.moment
    factor = cho_factor(H, lower=True)
    x, covariance = cho_solve(factor, b), cho_solve(factor, np.eye(size))
    slopes: dict[str, float] = {}
    for part in parts:
        at, gram = part.at, part.gram
        change = x[at] @ part.moment - 0.5 * x[at] @ gram @ x[at] - 0.5 * np.sum(covariance[np.ix_(at, at)] * gram)
        slopes[part.law] = slopes.get(part.law, 0.0) + trust.get(part.law, 1.0) * float(change)
    return 0.5 * float(b @ x) - float(np.log(np.diag(factor[0])).sum()), slopes


def learn_trust(laws: Sequence[str], agreements: Callable[[Mapping[str, float]], Iterable[_Value]]) -> dict[str, float]:
    """By law, the trust with which the recordings of each robot agree best.

    Args:
        laws: all that have a part in recordings of nominal robots, two or more of each.
        agreements: by a trust of each law, the `agreement` of every robot.
    """

    def loss(logs: Array) -> tuple[float, Array]:
        trust = dict(zip(laws, map(float, np.exp(logs)), strict=True))
        value, slope = PRICE * float(logs @ logs), 2.0 * PRICE * logs
        for nats, slopes in agreements(trust):
            beyond = max(WORST - nats, 0.0)
            value -= nats if nats > WORST else WORST - np.log1p(beyond)
            slope = slope - np.array([slopes[law] for law in laws]) / (1.0 + beyond)
        return value, slope

    first = np.full(len(laws), np.log(FIRST))
    bounds = [(np.log(LEAST), 0.0)] * len(laws)
    found = minimize(loss, first, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS})
    return dict(zip(laws, map(float, np.exp(found.x)), strict=True))
