# SPDX-License-Identifier: BSD-3-Clause
"""What recordings can distinguish: expected log Bayes factors between effects, before anything was found.

With the whitened derivatives of the residuals, G = A'A, and the prior variances V of a nominal robot, the posterior
mean of a robot that has x beside what varies on nominal robots is C G x + noise of covariance V - C, C = (G + V^-1)^-1.
The evidence of every effect is quadratic in it, so that its expectation is known without a recording of such a robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.sparse.csgraph import connected_components

from ...core.base.types import Array, Booleans
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
        sizes, units: by option, the value of each parameter, and what it is in.
        evidence: (n, n) expected evidence of an effect (column) against nothing if another is there (row) [nats].
    """

    options: tuple[Candidate, ...]
    sizes: tuple[dict[str, float], ...]
    units: tuple[dict[str, str], ...]
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
    def alike(self) -> Booleans:
        """(n, n) whether two effects both show, and cannot be distinguished either way."""
        visible = self.shown >= APART
        return np.asarray((self.factors < APART) & (self.factors.T < APART) & visible[:, None] & visible[None, :])

    @cached_property
    def groups(self) -> list[list[int]]:
        """Effects that show, and that these recordings cannot distinguish; the larger groups first."""
        visible = self.shown >= APART
        _, labels = connected_components(self.alike, directed=False)
        groups = [np.flatnonzero((labels == label) & visible).tolist() for label in np.unique(labels[visible])]
        return sorted((group for group in groups if len(group) > 1), key=len, reverse=True)

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Two effects each that these recordings cannot distinguish, in the order of the groups."""
        return [pair for group in self.groups for pair in combinations(group, 2) if self.alike[pair]]

    def apart(self, pair: tuple[int, int]) -> float:
        """Expected log Bayes factor between two effects [nats], whichever of them is there: the smaller of both."""
        i, j = pair
        return float(min(self.factors[i, j], self.factors[j, i]))


def isolability(
    evidence: Evidence, options: Sequence[Candidate], size: float = SIZE, more: Array | None = None
) -> Isolability:
    """Between all effects, each parameter as large as a share `size` of its reach, of either sign.

    Args:
        evidence, more: see `Expectation`.
        options: ways in which effects show themselves; those of one effect at one place are taken together.
    """
    known = evidence.unknowns
    ways: dict[tuple[str, str], list[Candidate]] = {}
    for option in options:
        ways.setdefault((option.effect, option.place), []).append(option)
    whole = [max(several, key=lambda each: len(each.unknowns)) for several in ways.values()]
    squares = np.zeros((len(whole), len(known)))
    sizes, units = [], []
    for i, option in enumerate(whole):
        mine = [k for k in option.unknowns if not known[k].shape]
        squares[i, mine] = [(size * known[k].reach) ** 2 for k in mine]
        sizes.append({known[k].key: known[k].value(known[k].usual + size * known[k].reach) for k in mine})
        units.append({known[k].key: known[k].unit for k in mine})
    expectation = Expectation(evidence, more)
    gains = np.array([expectation.of(several, squares) for several in ways.values()]).T
    return Isolability(tuple(whole), tuple(sizes), tuple(units), gains)


def taken_for(
    evidence: Evidence, options: Sequence[Candidate], true: Candidate, values: Array
) -> list[tuple[Candidate, float]]:
    """What an effect with given values could be taken for, see `rivals`."""
    found = rivals(Expectation(evidence), options, true, values)
    return [(option, factor) for option, factor in found if factor < APART]


def rivals(
    expectation: Expectation, options: Sequence[Candidate], true: Candidate, values: Array
) -> list[tuple[Candidate, float]]:
    """Expected log Bayes factor [nats] of an effect with given values against each other one, the most similar first.

    Args:
        options: see `isolability`; `true` is one of them.
        true: what is there; values: (P,) deviations of the parameters from nominal.
    """
    ways: dict[tuple[str, str], list[Candidate]] = {}
    for option in options:
        ways.setdefault((option.effect, option.place), []).append(option)
    along = _along(true, values)
    best = expectation.of(ways[true.effect, true.place], along)
    found = [
        (several[0], float(best - expectation.of(several, along)))
        for place, several in ways.items()
        if place != (true.effect, true.place)
    ]
    return sorted(found, key=lambda item: item[1])


def shows(expectation: Expectation, true: Candidate, values: Array) -> bool:
    """Whether an effect with given values, see `rivals`, shows at all: else anything could be taken for it."""
    return float(expectation.of([true], _along(true, values))) >= APART


def _along(true: Candidate, values: Array) -> Array:
    """(P,) of which only the parameters of an effect are not 0."""
    along = np.zeros(len(values))
    along[list(true.unknowns)] = values[list(true.unknowns)]
    return along


class Expectation:
    """Expected evidence for effects in recordings, and in further ones of the same robot.

    Args:
        evidence: of recordings, linear about nominal; what they measured says only which kind of robot it is.
        more: (P, P) information of further recordings.
    """

    def __init__(self, evidence: Evidence, more: Array | None = None) -> None:
        fit = evidence.fit()
        if more is not None:
            evidence = replace(evidence, gram=evidence.gram + more)
            fit = evidence.fit_of_kind(precise=fit.precise)
        self._known = evidence.unknowns
        self._before = prior_variance(self._known, precise=fit.precise)
        self._covariance = fit.covariance
        self._response = self._covariance @ evidence.gram

    def of(self, ways: Sequence[Candidate], true: Array) -> Array:
        """Expected evidence against nothing [nats] of the best of several ways in which one effect shows itself.

        Args:
            true: what is there: (P,) deviations from nominal, or (n, P) squares of such that are independent.
        """
        return np.asarray(np.max([self._of_way(list(way.unknowns), true) for way in ways], axis=0))

    def _of_way(self, k: list[int], true: Array) -> Array:
        before, covariance, response = self._before[k], self._covariance[np.ix_(k, k)], self._response[k]
        after = prior_variance(self._known, k)[k]
        change = 1.0 / after - 1.0 / before
        M = np.eye(len(k)) + covariance * change[None, :]
        A = change[:, None] * np.linalg.inv(M)
        log = 0.5 * float(np.log(before / after).sum()) - 0.5 * float(np.linalg.slogdet(M)[1])
        log -= 0.5 * float(np.sum(A * (np.diag(before) - covariance)))
        if true.ndim == 1:
            mean = response @ true
            return np.asarray(log - 0.5 * float(mean @ A @ mean))
        return np.asarray(log - 0.5 * true @ np.einsum("al,ab,bl->l", response, A, response))
