# SPDX-License-Identifier: BSD-3-Clause
"""How strongly the residuals speak for each effect, when everything else may vary as it does on nominal robots.

The residuals are linear in small unknowns: r = A x + noise. Every unknown x has a Gaussian prior, narrow (`spread`) on
a nominal robot and wide (`reach`) if its effect is present. The noise of each channel, in single and double support
apart, is an autoregressive process; whitened by it, A and r become A'A and A'r, and the evidence for an effect is the
log ratio of the marginal likelihoods with wide and with narrow prior. Spread that is correlated with an effect (a
knee's stiffness with both legs', a mass with a sensor's gain) thereby counts against it.

What varies little on a robot does so together: its foot sensors, and all else, are as on most robots or precise, and
each explanation is judged with the kind of robot that explains most with it. A late stream of 3 ms is usual for a robot
with as much play and friction as most have, and an effect where everything else is as it should be.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...core.base.types import Array, Integers
from ...core.effects.catalogue import CATALOGUE, Effect
from ...core.effects.unknown import Unknown, applied
from ..data.masks import Masks, parts, with_taken_up
from ..data.recording import Recording
from ..data.world import World
from ..physics.balance import State, evaluate
from ..physics.hypotheses import Candidate
from .floor import law_of
from .noise import (
    ORDER,
    Noise,
    first_guess,
    independent,
    mean_offset,
    no_less,
    repeated,
    white_noise,
    yule_walker,
)
from .prior import Kind, kinds_of, prior_variance
from .reference import CLOCKS, GAINS, Reference
from .usual import Usual

ROUNDS, ROUNDS_NEAR = 4, 2  # until the noise has settled, from a first guess and from that of a hypothesis near by
ONE_A_STEP = {"landing/z": 2 * ORDER, "slide/x": 4}  # channels with one value in each step; so many say something


@dataclass
class Problem:
    """A recording's residuals and what each unknown does to them.

    Attributes:
        groups: name of each group of rows: channel and whether both feet stand.
        rows: by group, residuals (n, ) in order of time, and pieces: where contiguous pieces begin.
        columns: by group (n, P) derivative of the residual by each unknown.
    """

    unknowns: list[Unknown]
    rows: dict[str, Array]
    columns: dict[str, Array]
    pieces: dict[str, Integers]
    times: dict[str, Integers]
    resolution: dict[str, float]  # by channel, what one count of an encoder is
    stride: dict[str, Array] = field(default_factory=dict)  # by group (n,), strides so far
    usual: Usual = field(default_factory=Usual)  # what nominal robots leave


def assemble(
    reference: Reference,
    where: Masks,
    known: list[Unknown],
    at: Array,
    like: Problem | None = None,
    fresh: Sequence[int] = (),
    usual: Usual | None = None,
) -> Problem:
    """Residuals under a hypothesis and, by difference quotients, what a unit of each unknown has put into them.

    Args:
        reference: the recording; where: the ticks at which its residuals mean something.
        known: all unknowns; at: (P,) their deviations from nominal. Of those without one, what is usual is taken off.
        like: a problem of the same recording under a hypothesis near by: derivatives are its, but for those `fresh`.
        usual: what nominal robots leave.
    """
    nominal = np.array([unknown.usual for unknown in known]) * (at == 0.0)
    rest = at - reference.shifts
    recording, world = applied(known, rest, reference.quiet.recording, reference.quiet.world)
    where = with_taken_up(where, reference.quiet.recording, recording, world)
    quiet = evaluate(recording, world, where, reference.quiet) if rest.any() else reference.quiet
    base = {
        name: value + quiet.residuals[name] - reference.quiet.residuals[name]
        for name, value in reference.measured.residuals.items()
    }
    fresh = range(len(known)) if like is None else fresh
    measured = applied(known, rest, reference.measured.recording, reference.measured.world)
    moved = [_differences(measured, reference.measured, quiet, where, known[i]) for i in fresh]
    gains = [known[i].effect in GAINS for i in fresh]
    rows: dict[str, Array] = {}
    columns: dict[str, Array] = {}
    pieces: dict[str, Integers] = {}
    times: dict[str, Integers] = {}
    for name, value in base.items():
        slope = np.reshape([each[name] for each in moved], (len(fresh), len(value)))
        if name.startswith("unloaded/"):
            # What a sensor reads in the air is its zero: a gain that explained it would be without bounds.
            slope[gains] = 0.0
        for part, chosen in parts(where, name):
            ticks = np.flatnonzero(np.isfinite(value) & chosen)
            if len(ticks) < ONE_A_STEP.get(name, 8 * ORDER):
                continue
            key = f"{name}|{part}"
            rows[key] = value[ticks]
            columns[key] = np.empty((len(ticks), len(known))) if like is None else like.columns[key].copy()
            columns[key][:, fresh] = slope[:, ticks].T
            rows[key] = rows[key] - columns[key] @ nominal
            times[key] = ticks
            pieces[key] = np.flatnonzero(np.diff(ticks, prepend=-9) > 1)
    names, counts = reference.measured.world.robot.joint_names, reference.measured.recording.count
    resolution = {f"spring/{name}": float(count) for name, count in zip(names, counts, strict=True)}
    stride = {key: where.stride[ticks] for key, ticks in times.items()}
    return Problem(known, rows, columns, pieces, times, resolution, stride, usual or Usual())


def _differences(
    measured: tuple[Recording, World], before: State, quiet: State, where: Masks, unknown: Unknown
) -> dict[str, Array]:
    """What a unit of an unknown has put into the residuals, by channel.

    A shift in time moves what is sudden most, which the quiet motion has not. Noise that is moved as far to both sides
    does not bias it; nor does that of a lag which is taken back, a slope over the neighbours.
    """
    if unknown.effect not in CLOCKS:
        moved = evaluate(*unknown.apply(quiet.recording, quiet.world, unknown.step), where, quiet)
        return {name: (value - moved.residuals[name]) / unknown.step for name, value in quiet.residuals.items()}
    first, last = (-unknown.step, unknown.step if CATALOGUE[unknown.effect].late is not Effect.late else 0.0)
    early, late = (evaluate(*unknown.apply(*measured, by), where, before).residuals for by in (first, last))
    return {name: (value - late[name]) / (last - first) for name, value in early.items()}


@dataclass
class Evidence:
    """Whitened sums over one or more recordings, with the unknowns at values `at` around which they are linear."""

    unknowns: list[Unknown]
    at: Array  # (P,) deviations from nominal
    gram: Array  # (P, P)
    moment: Array  # (P,)
    energy: float

    def __add__(self, other: Evidence) -> Evidence:
        return Evidence(
            self.unknowns, self.at, self.gram + other.gram, self.moment + other.moment,
            self.energy + other.energy,
        )  # fmt: skip

    def shared(self) -> Evidence:
        """The same with each recording's own unknowns integrated out, so that recordings can be added."""
        own = np.array([unknown.own for unknown in self.unknowns])
        if not own.any():
            return self
        s = np.sqrt(prior_variance(self.unknowns)[own])
        H = np.eye(int(own.sum())) + s[:, None] * self.gram[np.ix_(own, own)] * s[None, :]
        factor = cho_factor(H, lower=True)
        cross, b = s[:, None] * self.gram[own], s * self.moment[own]
        half = cho_solve(factor, np.column_stack([cross, b]))
        gram = self.gram - cross.T @ half[:, :-1]
        moment = self.moment - cross.T @ half[:, -1]
        gram[own], gram[:, own], moment[own] = 0.0, 0.0, 0.0
        energy = self.energy - float(b @ half[:, -1]) + 2.0 * float(np.log(np.diag(factor[0])).sum())
        return Evidence(self.unknowns, self.at, gram, moment, energy)

    def fit(self, released: Sequence[int] = ()) -> Fit:
        """Posterior of the unknowns' deviations from nominal when some are released to their reach.

        Of the kinds of robots, that with which they explain most.
        """
        return max((self.fit_of_kind(released, kind) for kind in kinds_of(self.unknowns)), key=lambda fit: fit.log)

    def fit_of_kind(self, released: Sequence[int] = (), precise: Kind = ()) -> Fit:
        """The same for one kind."""
        fit = self.posterior(np.zeros(len(self.unknowns)), prior_variance(self.unknowns, released, precise))
        return replace(fit, precise=precise)

    def posterior(self, mean: Array, variance: Array) -> Fit:
        """For any Gaussian prior (P,), (P,) of the deviations from nominal."""
        mu = mean - self.at
        moment = self.moment - self.gram @ mu
        energy = self.energy - 2.0 * float(mu @ self.moment) + float(mu @ self.gram @ mu)
        s = np.sqrt(variance)  # in units of the prior, so that absent unknowns do no harm to the conditioning
        H = s[:, None] * self.gram * s[None, :]
        factor = cho_factor(H + np.diag(1.0 + 1e-14 * np.diag(H).max() * np.ones(len(s))), lower=True)
        b = s * moment
        y = cho_solve(factor, b)
        log = 0.5 * (float(b @ y) - energy) - float(np.log(np.diag(factor[0])).sum())
        return Fit(mean + s * y, factor, s, log)


def pooled(evidences: Iterable[Evidence]) -> Evidence:
    """Sum over recordings, with each recording's own parameters integrated out."""
    return reduce(add, (each.shared() for each in evidences))


@dataclass(frozen=True)
class Fit:
    """A posterior: deviations from nominal (P,), the log evidence but for a constant, and the kind of robot."""

    x: Array
    factor: tuple[Array, bool]
    scale: Array
    log: float
    precise: Kind = ()

    @property
    def covariance(self) -> Array:
        return np.asarray(self.scale[:, None] * cho_solve(self.factor, np.diag(self.scale)))


def weigh(problem: Problem, at: Array, like: dict[str, Noise] | None = None) -> tuple[Evidence, dict[str, Noise]]:
    """Evidence when the noise is what the best explanation leaves, and that noise, by group.

    The noise is that of each law by itself, with full trust: what is trusted less is explained less, and what then
    remains of a large effect would be taken for noise.

    Args:
        problem: of one recording; at: (P,) deviations from nominal around which it is linear.
        like: noise under a hypothesis near by, to begin with.
    """
    resolution = {key: problem.resolution.get(key.partition("|")[0], 0.0) / np.sqrt(12.0) for key in problem.rows}
    floors = problem.usual.floor
    noise = like or {
        key: Noise(no_less(first_guess(row, problem.pieces[key]), key, floors), resolution[key])
        for key, row in problem.rows.items()
    }
    usual = {key: max(problem.usual.misfit.get(law_of(key), 0.0), resolution[key]) for key in problem.rows}
    noise = {key: replace(each, repeats=max(each.repeats, usual[key])) for key, each in noise.items()}
    for _ in range(ROUNDS_NEAR if like else ROUNDS):
        parts = list(parts_of(problem, noise))
        # Everything released: the noise must not hold what some unknown explains.
        best = summed(problem.unknowns, at, parts, {}).fit_of_kind(range(len(at))).x - at
        remainder = {key: row - problem.columns[key] @ best for key, row in problem.rows.items()}
        noise = {
            key: Noise(
                no_less(_of_remainder(left, problem.pieces[key], key), key, floors),
                max(resolution[key], mean_offset(left, problem.pieces[key])),
                max(repeated(left, problem.stride.get(key)), usual[key]),
            )
            for key, left in remainder.items()
        }
    return summed(problem.unknowns, at, parts, problem.usual.trust), noise


def _of_remainder(left: Array, pieces: Integers, key: str) -> Array:
    """Noise (1 + ORDER,) of what is left of a group."""
    return white_noise(left) if key.partition("|")[0] in ONE_A_STEP else yule_walker(left, pieces)


def weighed(problem: Problem, at: Array, noise: dict[str, Noise]) -> Evidence:
    """Evidence with a given noise."""
    return summed(problem.unknowns, at, parts_of(problem, noise), problem.usual.trust)


@dataclass(frozen=True)
class Part:
    """What one group of rows says of the unknowns `at`, their indices (k,): gram (k, k) and moment (k,)."""

    law: str
    at: Integers
    gram: Array
    moment: Array
    energy: float


def parts_of(problem: Problem, noise: dict[str, Noise]) -> Iterator[Part]:
    """What each group of rows says with a given noise, as it takes itself: with full trust."""
    for key, row in problem.rows.items():
        some = np.flatnonzero(problem.columns[key].any(axis=0))
        stacked = np.column_stack([row, problem.columns[key][:, some]])
        white, log = independent(stacked, problem.stride.get(key), problem.pieces[key], noise[key])
        A, r = white[:, 1:], white[:, 0]
        yield Part(law_of(key), some, A.T @ A, A.T @ r, float(r @ r) + log)


def summed(unknowns: list[Unknown], at: Array, parts: Iterable[Part], trust: Mapping[str, float]) -> Evidence:
    """Evidence of all parts, linear about `at` (P,), with a trust of each law (1 where none is given)."""
    P = len(unknowns)
    out = Evidence(unknowns, at, np.zeros((P, P)), np.zeros(P), 0.0)
    for part in parts:
        share = trust.get(part.law, 1.0)
        out.gram[np.ix_(part.at, part.at)] += share * part.gram
        out.moment[part.at] += share * part.moment
        out.energy += share * part.energy
    return out


@dataclass(frozen=True, eq=False)
class Score:
    """What a candidate adds to the log evidence."""

    option: Candidate
    gain: float  # beyond what nominal robots have of it, and what is released already
    values: Array  # of its unknowns, deviations from nominal
    physical: bool


def scores(evidence: Evidence, options: Sequence[Candidate], released: Sequence[int] = ()) -> list[Score]:
    """Of each candidate beside what is released already, the one that explains most first."""
    known, bases = evidence.unknowns, [evidence.fit_of_kind(released, kind) for kind in kinds_of(evidence.unknowns)]
    covariances = [base.covariance for base in bases]
    before = [prior_variance(known, released, base.precise) for base in bases]
    nothing = max(base.log for base in bases)
    out = []
    for option in options:
        k = list(option.unknowns)
        wide = prior_variance(known, [*released, *k])[k]
        each = [
            _reweighed(base.x[k], covariance[np.ix_(k, k)], variance[k], wide)
            for base, covariance, variance in zip(bases, covariances, before, strict=True)
        ]
        log, values = max(
            ((base.log + gain, x) for base, (gain, x) in zip(bases, each, strict=True)), key=lambda pair: pair[0]
        )
        gain = log - nothing
        # The sign only: by how much, linear extrapolation cannot say.
        physical = all(x > 0.0 or evidence.unknowns[i].low < 0.0 for x, i in zip(values, k, strict=True))
        out.append(Score(option, gain, values, physical))
    return sorted(out, key=lambda score: -score.gain)


def _reweighed(x: Array, C: Array, before: Array, after: Array) -> tuple[float, Array]:
    """What other prior variances (k,) of some unknowns add to the log evidence, and their new posterior mean.

    From the posterior x (k,), C (k, k) under the old prior: the evidence ratio is the posterior's mean of the ratio of
    the priors.
    """
    change = 1.0 / after - 1.0 / before
    M = np.eye(len(x)) + C * change[None, :]
    mean: Array = np.asarray(np.linalg.solve(M, x), dtype=float)
    log = 0.5 * float(np.log(before / after).sum()) - 0.5 * np.linalg.slogdet(M)[1] - 0.5 * float(x @ (change * mean))
    return float(log), mean
