# SPDX-License-Identifier: BSD-3-Clause
"""Explanations compared: nothing more than nominal variability, or one more effect, each at its own values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.base.nominal import Nominal
from ...core.base.types import Array
from ...core.effects.unknown import Unknown
from ..physics.hypotheses import Candidate, candidates
from .case import Case, evidence_of, examine
from .case_cache import CaseCache
from .evidence import Evidence, Fit, pooled, scores, weighed
from .explanation import Explanation
from .finding import Finding, leftover
from .gauss_newton import settle
from .noise import Noise
from .prior import kinds_of, prior_variance
from .reference import CLOCKS
from .variability import MEMBERS, widths_of

LEAST_SHOWN = 1.0  # nats that a whole reach of a parameter must be worth in selecting recordings, that they count
FROM = (1.0, 0.25)  # of the reach of a shift in time, where it is looked for
SHOWN = 0.1  # share of a prior variance that a recording takes away, from which on it shows a direction


def compare(finding: Finding, cache: CaseCache, rivals: Sequence[Candidate]) -> list[Explanation]:
    """Nothing more, then each rival, linear around its own values.

    A rival and nothing more are both judged with the noise that either leaves, whichever makes them more likely, and
    nothing more along the rival's derivatives as well: what fits better only because other parameters act otherwise
    there is no evidence for the rival. A delay as nominal robots have it is far from linear, and shows along the
    streams that it shifts: so for a rival that shifts a stream, nothing more is judged along those that any of them
    shifts. One clock is not taken for another.
    """
    nothing = _Trial(finding, None, finding.train, finding.hold)
    alone = nothing.with_noise_of(nothing)
    first = nothing.judged([alone])
    found, shifted = [], [(first.train, first.select)]
    for option in rivals:
        trial = _Trial(finding, option, *_settled(finding, cache, option))
        mine = [trial.with_noise_of(nothing), trial.with_noise_of(trial)]
        other = nothing.judged([alone, nothing.with_noise_of(trial), *mine])
        found.append((trial, trial.judged(mine), (other.train, other.select)))
        if option.effect in CLOCKS:
            same = nothing.judged(mine)
            shifted += [(same.train, same.select), (other.train, other.select)]
    most = np.max(shifted, axis=0)
    places = places_of(finding.known)
    together = pulled_together([*finding.train, *finding.hold], first.fit, finding.released)
    out = [replace(_explanation(nothing, first, (0.0, 0.0 if finding.hold else np.nan), 1), together=together)]
    for option, (trial, judged, beside) in zip(rivals, found, strict=True):
        without = most if option.effect in CLOCKS else beside
        gains = judged.train - without[0], judged.select - without[1]
        out.append(_explanation(trial, judged, gains, places[option.effect]))
    return out


def places_of(known: list[Unknown]) -> Counter[str]:
    """By effect, at how many places it could be."""
    return Counter(effect for effect, _ in {(each.effect, each.place) for each in candidates(known)})


@dataclass(frozen=True)
class _Judged:
    """A fit on the training bags, its log evidence, and that of selecting bags; NaN: they do not show the effect."""

    fit: Fit
    train: float
    select: float


@dataclass(frozen=True)
class _Trial:
    """Recordings around the values of one more effect, or of none."""

    finding: Finding
    option: Candidate | None
    train: list[Case]
    hold: list[Case]

    @property
    def released(self) -> list[int]:
        return [*self.finding.released, *(self.option.unknowns if self.option else ())]

    def with_noise_of(self, other: _Trial) -> tuple[Evidence, Evidence | None]:
        """Evidence of the training bags, and of the selecting ones if there are any, with the noise of a trial."""
        train = _weighed(self.train, [case.noise for case in other.train])
        return train, _weighed(self.hold, [case.noise for case in other.hold]) if self.hold else None

    def judged(self, evidences: Sequence[tuple[Evidence, Evidence | None]]) -> _Judged:
        """By evidence with several noises, of which that counts with which the recordings are most likely."""
        fit = max((train.fit(self.released) for train, _ in evidences), key=lambda one: one.log)
        held = [select for _, select in evidences if select is not None]
        if not held or (self.option and not shown(held[0], self.option)):
            return _Judged(fit, fit.log, np.nan)
        prior = trained(self.finding.known, fit, self.released, self.finding.nominal)
        return _Judged(fit, fit.log, max(each.posterior(*prior).log for each in held))


def _explanation(trial: _Trial, judged: _Judged, gains: tuple[float, float], ways: int) -> Explanation:
    left = leftover([*trial.train, *trial.hold], judged.fit, trial.released)
    pulled = pulls(trial.finding.known, judged.fit, trial.released)
    at = trial.train[0].evidence.at
    return Explanation(trial.option, judged.fit, float(gains[0]), float(gains[1]), ways, left, pulled, at=at)


def _settled(finding: Finding, cache: CaseCache, rival: Candidate) -> tuple[list[Case], list[Case]]:
    """Cases of training and selecting bags around the values with a rival.

    Where a rival shifts streams in time, all derivatives are those of the shifted streams: by unshifted ones, other
    parameters would take up what the shift does not explain. A shift that was found before stays where it was found,
    unless the rival is one too: by derivatives along other streams a rival would find another one.
    """
    released = [*finding.released, *rival.unknowns]
    if rival.effect in CLOCKS:
        at, _, _ = settle(_nearer(finding, cache, rival), cache, released)
        return cache.at(at, "train"), cache.at(at, "hold")
    shifts = [i for i in finding.released if finding.known[i].effect in CLOCKS]
    at, train, _ = settle(finding, cache, released, 1, shifts)
    if np.array_equal(at, finding.at):
        return train, finding.hold
    if cache.has(at):
        return cache.at(at, "train"), cache.at(at, "hold")
    moved = [i for i in released if i not in shifts]
    select = [
        examine(each, finding.known, at, case, moved) for each, case in zip(cache.hold, finding.hold, strict=True)
    ]
    return train, select


def _nearer(finding: Finding, cache: CaseCache, rival: Candidate) -> Finding:
    """Where a shift in time begins to be looked for: some way off, if it does not show from where the others are."""
    (linear,) = scores(evidence_of(finding.train), [rival], finding.released)
    if linear.physical and linear.gain > LEAST_SHOWN:
        return finding
    released = [*finding.released, *rival.unknowns]
    found = []
    for share in FROM:
        at = finding.at.copy()
        for i, value in zip(rival.unknowns, linear.values, strict=True):
            unknown = finding.known[i]
            at[i] = share * (unknown.reach if unknown.low == 0.0 else np.copysign(unknown.reach, value))
        found.append((evidence_of(cache.near(at, finding.train, rival.unknowns)).fit(released).log, at))
    _, at = max(found, key=lambda each: each[0])
    return replace(finding, at=at, train=cache.at(at, "train"))


def shown(evidence: Evidence, option: Candidate) -> bool:
    """Whether recordings depend on any parameter of an effect."""
    return any(evidence.gram[i, i] * evidence.unknowns[i].reach ** 2 > LEAST_SHOWN for i in option.unknowns)


def _weighed(cases: Sequence[Case], noises: Sequence[dict[str, Noise]]) -> Evidence:
    """Of cases with a given noise each."""
    pairs = zip(cases, noises, strict=True)
    return pooled(weighed(case.problem, case.evidence.at, noise) for case, noise in pairs)


def trained(known: Sequence[Unknown], fit: Fit, released: Sequence[int], nominal: Nominal) -> tuple[Array, Array]:
    """Prior mean and variance (P,) on other recordings: released parameters stay about where training has them."""
    mean, variance = np.zeros(len(known)), prior_variance(known, precise=fit.precise)
    covariance = fit.covariance
    for i in released:
        mean[i], variance[i] = fit.x[i], covariance[i, i] + (nominal.limits["walk_to_walk"] * fit.x[i]) ** 2
    return mean, variance


def confirmation(
    known: Sequence[Unknown],
    fit: Fit,
    held: Sequence[Case],
    option: Candidate,
    chosen: Sequence[int],
    nominal: Nominal,
    without_it: Sequence[Case] = (),
) -> float:
    """Log evidence [nats] of other recordings for an effect as trained against none of it, beside the chosen ones.

    With it as without it, the robot may be of any kind. NaN where the recordings do not show the effect.

    Args:
        held: their cases around the values that were found.
        without_it: the same with this effect at nominal, if it shifts streams in time.
    """
    evidence = evidence_of(held)
    if not shown(evidence, option):
        return float("nan")
    mean, variance = trained(known, fit, chosen, nominal)
    mine = [i for i in option.unknowns if not known[i].shape]  # a shape is nothing without the others
    others = [i for i in chosen if i not in mine]
    without_mean = mean.copy()
    without_mean[mine] = 0.0
    with_logs, logs = [], []
    for kind in kinds_of(known):
        having, without = prior_variance(known, precise=kind), prior_variance(known, precise=kind)
        having[list(chosen)], without[others] = variance[list(chosen)], variance[others]
        with_logs.append(evidence.posterior(mean, having).log)
        for each in (evidence, evidence_of(without_it)) if without_it else (evidence,):
            logs.append(each.posterior(without_mean, without).log)
    return max(with_logs) - max(logs)


def pulled_together(cases: Sequence[Case], fit: Fit, released: Sequence[int]) -> float:
    """How far all that varies on nominal robots is pulled together, in the mean over recordings.

    The posterior mean x of what the prior has with covariance V, known after the recording to C, scatters by V - C on
    nominal robots: x' (V - C)^-1 x is chi squared with as many degrees of freedom as there are directions that the
    recording shows.

    Returns:
        standard deviations beyond the mean of chi squared; 0 where nothing shows.
    """
    out = []
    for case in cases:
        known = case.evidence.unknowns
        mine = case.evidence.fit_of_kind(released, fit.precise)
        rest = [i for i in range(len(known)) if i not in released]
        scale = np.sqrt(prior_variance(known, precise=fit.precise)[rest])
        shown, axes = np.linalg.eigh(np.eye(len(rest)) - mine.covariance[np.ix_(rest, rest)] / np.outer(scale, scale))
        axes, shown = axes[:, shown > SHOWN], shown[shown > SHOWN]
        if len(shown):
            square = float(np.sum((axes.T @ (mine.x[rest] / scale)) ** 2 / shown))
            out.append((square - len(shown)) / np.sqrt(2.0 * len(shown)))
    return float(np.mean(out)) if out else 0.0


def still_pulled(finding: Finding) -> bool:
    """Whether all that varies is pulled too far beside the effects that were chosen in the end."""
    assert finding.fit is not None
    weights = finding.nominal.decision["selected" if len(finding.before[1]) > 1 else "alone"]
    return pulled_together(finding.cases, finding.fit, finding.released) > weights.get("together", np.inf)


def pulls(known: Sequence[Unknown], fit: Fit, released: Sequence[int]) -> dict[str, float]:
    """By width, how far its parameters are pulled from nominal [standard deviations, root mean square].

    Of those that all recordings share: what each recording has for itself does not count.
    """
    prior = prior_variance(known, precise=fit.precise)
    out = {}
    for name, members in widths_of(known).items():
        rest = [i for i in members if i not in released]
        if rest:
            # The largest counts as well: of thirteen masses one may be far off, all together a little.
            ratios = np.abs(fit.x[rest]) / np.sqrt(prior[rest])
            rms = float(np.sqrt(np.mean(ratios**2)))
            out[name] = max(rms, float(ratios.max()) / 2.0) if len(rest) >= MEMBERS else float(ratios.max()) / 2.0
    return out
