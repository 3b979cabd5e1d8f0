# SPDX-License-Identifier: BSD-3-Clause
"""What recordings can distinguish: expected log Bayes factors between effects, before anything was found.

With the whitened derivatives of the residuals, G = A'A, and the prior variances V of a nominal robot, the posterior
mean of a robot that has x beside what varies on nominal robots is C G x + noise of covariance V - C, C = (G + V^-1)^-1.
The evidence of every effect is quadratic in it, so that its expectation is known without a recording of such a robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components

from ...core.base.types import Array
from ..physics.hypotheses import Candidate
from .evidence import Evidence
from .prior import prior_variance

SIZE = 0.5  # of the reach of a parameter, that an effect has unless said
APART = 3.0  # nats from which on two effects can be distinguished


@dataclass(frozen=True)
class Isolability:
    """What could be taken for what.

    Attributes:
        options: effects at their places, n of them, each with all its parameters.
        sizes: by option, the value of each parameter.
        evidence: (n, n) expected evidence of an effect (column) against nothing if another is there (row) [nats].
    """

    options: tuple[Candidate, ...]
    sizes: tuple[dict[str, float], ...]
    evidence: Array

    @property
    def shown(self) -> Array:
        """(n,) expected evidence of each effect against nothing, if it is there."""
        return np.diag(self.evidence).copy()

    @cached_property
    def factors(self) -> Array:
        """(n, n) expected log Bayes factor of what is there (row) against what it could be taken for (column)."""
        return np.asarray(self.shown[:, None] - self.evidence)

    @property
    def hidden(self) -> list[int]:
        """Effects that these recordings would not show at that size."""
        return [int(i) for i in np.flatnonzero(self.shown < APART)]

    @cached_property
    def groups(self) -> list[list[int]]:
        """Effects that show, and that these recordings cannot distinguish; the larger groups first."""
        alike = (self.factors < APART) & (self.factors.T < APART)
        visible = self.shown >= APART
        _, labels = connected_components(alike & visible[:, None] & visible[None, :], directed=False)
        groups = [np.flatnonzero((labels == label) & visible).tolist() for label in np.unique(labels[visible])]
        return sorted((group for group in groups if len(group) > 1), key=len, reverse=True)


def isolability(evidence: Evidence, options: Sequence[Candidate], size: float = SIZE) -> Isolability:
    """Between all effects, each parameter as large as a share `size` of its reach, of either sign.

    Args:
        evidence: of recordings, linear about nominal; what they measured does not matter, only how.
        options: ways in which effects show themselves; those of one effect at one place are taken together.
    """
    known = evidence.unknowns
    ways: dict[tuple[str, str], list[Candidate]] = {}
    for option in options:
        ways.setdefault((option.effect, option.where), []).append(option)
    whole = [max(several, key=lambda each: len(each.unknowns)) for several in ways.values()]
    squares = np.zeros((len(whole), len(known)))
    sizes = []
    for i, option in enumerate(whole):
        mine = [k for k in option.unknowns if not known[k].shape]
        squares[i, mine] = [(size * known[k].reach) ** 2 for k in mine]
        sizes.append({known[k].key: known[k].value(size * known[k].reach) for k in mine})
    gains = np.array([expected(evidence, several, squares) for several in ways.values()]).T
    return Isolability(tuple(whole), tuple(sizes), gains)


def taken_for(
    evidence: Evidence, options: Sequence[Candidate], true: Candidate, values: Array
) -> list[tuple[Candidate, float]]:
    """What an effect with given values could be taken for, and the expected log Bayes factor against it [nats].

    Args:
        evidence, options: see `isolability`.
        true: what is there; values: (P,) deviations of the parameters from nominal.
    """
    mine = list(true.unknowns)
    ways: dict[tuple[str, str], list[Candidate]] = {}
    for option in options:
        ways.setdefault((option.effect, option.place), []).append(option)
    along = np.zeros(len(evidence.unknowns))
    along[mine] = values[mine]
    best = expected(evidence, ways[true.effect, true.place], along)
    rivals = [
        (several[0], float(best - expected(evidence, several, along)))
        for place, several in ways.items()
        if place != (true.effect, true.place)
    ]
    return sorted(((each, factor) for each, factor in rivals if factor < APART), key=lambda item: item[1])


def expected(evidence: Evidence, ways: Sequence[Candidate], true: Array) -> Array:
    """Expected evidence against nothing [nats] of the best of several ways in which one effect shows itself.

    Args:
        true: what is there: (P,) deviations from nominal, or (n, P) squares of such that are independent.
    """
    known = evidence.unknowns
    fit = evidence.fit()
    before, covariance = prior_variance(known, precise=fit.precise), fit.covariance
    response = covariance @ evidence.gram
    out = []
    for way in ways:
        k = list(way.unknowns)
        after = prior_variance(known, k)[k]
        change = 1.0 / after - 1.0 / before[k]
        M = np.eye(len(k)) + covariance[np.ix_(k, k)] * change[None, :]
        A = change[:, None] * np.linalg.inv(M)
        log = 0.5 * float(np.log(before[k] / after).sum()) - 0.5 * float(np.linalg.slogdet(M)[1])
        scatter = np.diag(before[k]) - covariance[np.ix_(k, k)]
        log -= 0.5 * float(np.sum(A * scatter))
        if true.ndim == 1:
            mean = response[k] @ true
            out.append(log - 0.5 * float(mean @ A @ mean))
        else:
            out.append(log - 0.5 * true @ np.einsum("al,ab,bl->l", response[k], A, response[k]))
    return np.asarray(np.max(out, axis=0))
