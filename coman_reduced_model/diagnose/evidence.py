# SPDX-License-Identifier: BSD-3-Clause
"""How strongly the residuals speak for each effect, when everything else may vary as it does on healthy robots.

The residuals are linear in small figures: r = A x + noise. Every figure x has a Gaussian prior, narrow (`spread`) on a
healthy robot and wide (`reach`) if its effect is present. The noise of each channel, in single and double support apart, is
an autoregressive process; whitened by it, A and r become A'A and A'r, and the evidence for an effect is the log ratio of the
marginal likelihoods with wide and with narrow prior. Spread that is correlated with an effect (a knee's stiffness with
both legs', a mass with a sensor's gain) thereby counts against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, toeplitz

from ..core.types import Array
from .balance import Masks, State, evaluate, without_noise
from .hypotheses import Candidate, Figure

ORDER = 4  # of the autoregressive noise
ABSENT = 1e-9  # spread, as a share of reach, of a figure that healthy robots do not have


@dataclass
class Problem:
    """A recording's residuals and what each figure does to them.

    Attributes:
        groups: name of each group of rows: channel and whether both feet stand.
        rows: by group, residuals (n, ) in order of time, and pieces: where contiguous pieces begin.
        columns: by group (n, P) derivative of the residual by each figure.
    """

    figures: list[Figure]
    rows: dict[str, Array]
    columns: dict[str, Array]
    pieces: dict[str, Array]
    times: dict[str, Array]


def assemble(state: State, where: Masks, known: list[Figure]) -> Problem:
    """Residuals and, by difference quotients, what a unit of each figure has put into them."""
    base = state.residuals
    # The same noise in a residual and in its derivative would bias every inertia: the derivative is taken along a motion
    # that does not hold the encoders' noise.
    quiet = evaluate(without_noise(state.recording, state.world), state.world, where)
    slopes = []
    for figure in known:
        moved = evaluate(*figure.apply(quiet.recording, quiet.world, figure.step), where, quiet).residuals
        slopes.append({name: (value - moved[name]) / figure.step for name, value in quiet.residuals.items()})
    rows, columns, pieces, times = {}, {}, {}, {}
    for name, value in base.items():
        for part, chosen in (("double", where.double), ("single", ~where.double)):
            at = np.flatnonzero(np.isfinite(value) & chosen)
            if len(at) < 8 * ORDER:
                continue
            key = f"{name}|{part}"
            rows[key] = value[at]
            columns[key] = np.column_stack([slope[name][at] for slope in slopes])
            times[key] = at
            pieces[key] = np.flatnonzero(np.diff(at, prepend=-9) > 1)
    return Problem(known, rows, columns, pieces, times)


@dataclass
class Evidence:
    """Whitened sums, and what follows from them."""

    problem: Problem
    gram: Array  # (P, P)
    moment: Array  # (P,)
    energy: dict[str, float]
    count: dict[str, int]
    noise: dict[str, Array]  # by group: innovations' standard deviation, then AR coefficients

    def fit(self, released: Sequence[int] = ()) -> tuple[Array, Array, float]:
        """Posterior mean (P,), covariance (P, P) of the figures, and the log evidence but for a constant."""
        prior = prior_variance(self.problem.figures, released)
        # In units of the prior, so that absent figures do no harm to the conditioning.
        s = np.sqrt(prior)
        H = np.eye(len(s)) + s[:, None] * self.gram * s[None, :]
        factor = cho_factor(H, lower=True)
        b = s * self.moment
        x = cho_solve(factor, b)
        log = 0.5 * float(b @ x) - float(np.log(np.diag(factor[0])).sum())
        covariance = s[:, None] * cho_solve(factor, np.eye(len(s))) * s[None, :]
        return s * x, covariance, log


def prior_variance(known: Sequence[Figure], released: Sequence[int]) -> Array:
    """(P,) with the figures `released` at their reach."""
    spread = np.array([max(figure.spread, ABSENT * figure.reach) for figure in known])
    for i in released:
        spread[i] = max(known[i].reach, known[i].spread)
    return spread**2


def weigh(problem: Problem, noise: dict[str, Array] | None = None, floor: dict[str, float] | None = None) -> Evidence:
    """Whiten by the noise, estimated (twice) from what the best explanation so far leaves."""
    P = len(problem.figures)
    explained = {key: np.zeros(len(row)) for key, row in problem.rows.items()}
    evidence = None
    for _ in range(3):
        noise = {key: _autoregression(row - explained[key], problem.pieces[key]) for key, row in problem.rows.items()}
        gram, moment = np.zeros((P, P)), np.zeros(P)
        energy, count = {}, {}
        for key, row in problem.rows.items():
            white = whiten(np.column_stack([row, problem.columns[key]]), problem.pieces[key], noise[key])
            A, r = white[:, 1:], white[:, 0]
            gram += A.T @ A
            moment += A.T @ r
            energy[key], count[key] = float(r @ r), len(r)
        evidence = Evidence(problem, gram, moment, energy, count, noise)
        best = evidence.fit(range(P))[0]  # everything released: noise must not hold what a figure explains
        explained = {key: problem.columns[key] @ best for key in problem.rows}
    assert evidence is not None
    return evidence


def _autoregression(values: Array, pieces: Array) -> Array:
    """Innovations' standard deviation and AR coefficients (1 + ORDER,), by Yule-Walker over contiguous pieces."""
    ends = np.append(pieces[1:], len(values))
    covariance = np.zeros(ORDER + 1)
    for lag in range(ORDER + 1):
        total = sum(float(values[a : b - lag] @ values[a + lag : b]) for a, b in zip(pieces, ends, strict=True) if b - a > lag)
        covariance[lag] = total / len(values)
    covariance[0] = covariance[0] * (1.0 + 1e-6) + 1e-30
    phi = np.linalg.solve(toeplitz(covariance[:ORDER]), covariance[1:])
    innovation = covariance[0] - phi @ covariance[1:]
    return np.concatenate([[np.sqrt(max(innovation, 1e-6 * covariance[0]))], phi])


def whiten(values: Array, pieces: Array, noise: Array) -> Array:
    """Innovations (n, k) of columns (n, k) in units of their standard deviation; a piece begins in its steady state."""
    sigma, phi = noise[0], noise[1:]
    out = values.copy()
    for lag, coefficient in enumerate(phi, start=1):
        out[lag:] -= coefficient * values[:-lag]
    # The first values of a piece have no predecessors: weighed as what they are, of the marginal variance.
    marginal = sigma / np.sqrt(max(1.0 - float(phi @ _correlations(phi)), 1e-6))
    ends = np.append(pieces[1:], len(values))
    for a, b in zip(pieces, ends, strict=True):
        head = min(a + ORDER, b)
        out[a:head] = values[a:head] * (sigma / marginal) / np.sqrt(ORDER)
    return out / sigma


def _correlations(phi: Array) -> Array:
    """Autocorrelation (ORDER,) at lags 1.. of an AR process."""
    p = len(phi)
    A, b = np.eye(p), np.zeros(p)
    for k in range(1, p + 1):
        for i in range(1, p + 1):
            lag = abs(k - i)
            if lag == 0:
                b[k - 1] += phi[i - 1]
            else:
                A[k - 1, lag - 1] -= phi[i - 1]
    return np.linalg.solve(A, b)


def gains(evidence: Evidence, options: Sequence[Candidate], released: Sequence[int] = ()) -> list[tuple[float, Candidate]]:
    """Log evidence that each candidate adds to what is released already, best first."""
    base = evidence.fit(released)[2]
    scored = [(evidence.fit([*released, *option.figures])[2] - base, option) for option in options]
    return sorted(scored, key=lambda pair: -pair[0])
