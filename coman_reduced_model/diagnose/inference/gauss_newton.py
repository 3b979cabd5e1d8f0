# SPDX-License-Identifier: BSD-3-Clause
"""Gauss-Newton: the values of the released parameters, found by repeated linearisation.

With the whitened residuals r and their derivatives J at x, and the prior variances V, each step goes towards

    argmin over y of |r + J (y - x)|^2 + y' V^-1 y

and is no longer than a reach of each parameter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.base.types import Array
from ...core.effects.unknown import Unknown
from .case import Case, evidence_of
from .case_cache import CaseCache
from .evidence import Fit
from .finding import Finding
from .reference import CLOCKS

# All derivatives are computed again where a parameter has moved by more than FAR_OFF of its reach since the last time,
# in ROUNDS rounds at most.
FAR_OFF, ROUNDS = 0.1, 4
CLEARLY = 10.0  # nats
STEPS = 12  # of one round at most
SETTLED = 0.05  # of the reach, or a standard deviation where that is less, and of the value: what counts as no change


def settle(
    finding: Finding, cache: CaseCache, released: Sequence[int], rounds: int = ROUNDS, held: Sequence[int] = ()
) -> tuple[Array, list[Case], Fit]:
    """Values (P,) at which the linearisation and the estimate of the released parameters agree; their cases and fit.

    A step is at most one reach long, and half as long after each change of sign: a spring of a quarter of its nominal
    stiffness is far from linear. After a long way, as with delays, all derivatives are computed again, in at most
    `rounds` linearisations, as long as the evidence grows: values that the next linearisation would leave again for
    worse ones are kept. So is where the finding is, if what is linear there explains clearly more (`CLEARLY`) than the
    effect itself does, by new derivatives too, and is possible: a spring that softens in steps is no cubic one. Shifts
    in time are too far from linear for that.

    Args:
        held: released parameters that stay where they are linearised; the fit moves them yet.
    """
    known, cases = finding.known, finding.train
    at = np.zeros(len(known))  # dropped effects start at zero
    at[list(released)] = finding.at[list(released)]
    near = finding.at
    best: tuple[Array, list[Case], Fit] | None = None
    fit = evidence_of(cases).fit(released)
    start = at, cases, fit
    possible = np.array_equal(at, near) and all(
        fit.x[i] >= known[i].low and known[i].effect not in CLOCKS for i in released
    )
    for left in reversed(range(rounds)):
        at, cases, fit = _gauss_newton(cache, released, at, cases, fit, held)
        if possible and best is None and start[2].log > fit.log + CLEARLY:
            cases = cache.at(at, "train")  # with the old derivatives it may look worse than it is
            fit = evidence_of(cases).fit(released)
            if start[2].log > fit.log + CLEARLY:
                return start
        if not left or all(abs(at[i] - near[i]) <= FAR_OFF * known[i].reach for i in released):
            break
        near, cases = at, cache.at(at, "train")
        fit = evidence_of(cases).fit(released)
        if best and fit.log <= best[2].log:
            return best
        best = at, cases, fit
    return best if best and fit.log < best[2].log else (at, cases, fit)


def _gauss_newton(
    cache: CaseCache, released: Sequence[int], at: Array, like: Sequence[Case], fit: Fit, held: Sequence[int] = ()
) -> tuple[Array, list[Case], Fit]:
    """Gauss-Newton from the values `at` (P,); the derivatives by all other parameters are those of the cases `like`.

    Args:
        fit: of these cases.
        held: see `settle`.
    """
    known, cases = cache.known, list(like)
    moving = [i for i in released if i not in held]
    key = at.tobytes(), like[0].evidence.at.tobytes(), *released, *held
    if key in cache.converged:  # rivals are compared again when the best of them was refused
        at = cache.converged[key]
        cases = cache.near(at, like, moving)
        return at, cases, evidence_of(cases).fit(released)
    reach = np.array([unknown.reach for unknown in known])
    longest = reach.copy()
    last = np.zeros(len(known))
    for _ in range(STEPS):
        step = _values(known, fit, moving, at) - at
        longest[step * last < 0.0] *= 0.5
        last = np.clip(step, -longest, longest)
        at = at + last
        cases = cache.near(at, like, moving)
        fit = evidence_of(cases).fit(released)
        tolerance = np.minimum(SETTLED * reach, np.sqrt(np.diag(fit.covariance))) + SETTLED * np.abs(at)
        if np.all(np.abs(_values(known, fit, moving, at) - at) <= tolerance):
            break
    cache.converged[key] = at
    return at, cases, fit


def settled(finding: Finding, cache: CaseCache, released: Sequence[int]) -> tuple[Array, list[Case], Fit]:
    """Like `settle`, with all derivatives computed at the end point."""
    at = settle(finding, cache, released)[0]
    cases = cache.at(at, "train")
    return at, cases, evidence_of(cases).fit(released)


def _values(known: Sequence[Unknown], fit: Fit, moving: Sequence[int], at: Array) -> Array:
    """Deviations (P,) to linearise around: `at`, with parameters that move, not below their lower bounds."""
    at = at.copy()
    for i in moving:
        at[i] = max(fit.x[i], known[i].low)
    return at
