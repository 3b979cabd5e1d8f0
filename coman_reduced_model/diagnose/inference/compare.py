# SPDX-License-Identifier: BSD-3-Clause
"""Explanations compared: nothing more than nominal variability, or one more effect, each at its own values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from ...core.base.types import Array
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import Unknown
from ..physics.hypotheses import Candidate, candidates
from .case import Case, evidence_of, examine
from .case_cache import CaseCache
from .evidence import Evidence, Fit, pooled, scores, weighed
from .explanation import Explanation
from .finding import Finding, leftover
from .gauss_newton import ROUNDS, settle
from .noise import Noise, quieter
from .prior import kinds_of, prior_variance
from .variability import MEMBERS, widths_of

CLOCKS = {name for name, effect in CATALOGUE.items() if effect.clock}  # alike until linearised there
LEAST_SHOWN = 1.0  # nats that a whole reach of a parameter must be worth in selecting recordings, that they count
FROM = (1.0, 0.25)  # of the reach of a shift in time, where it is looked for
STRETCH = 0.1  # of a value, by which it may differ from walk to walk


def compare(finding: Finding, cache: CaseCache, rivals: Sequence[Candidate]) -> list[Explanation]:
    """Nothing more, then each rival, linear around its own values, all judged with the same noise."""
    nothing = finding.train, finding.hold
    trials = [nothing, *(_settled(finding, cache, rival) for rival in rivals)]
    noises = _quietest([train for train, _ in trials]), _quietest([select for _, select in trials])
    options: list[Candidate | None] = [None, *rivals]
    fits, logs, without = [], [], []
    for option, (train, select) in zip(options, trials, strict=True):
        trial = _weighed(train, noises[0]), _weighed(select, noises[1]) if select else None
        fit, *log = _judged(finding, option, *trial)
        fits.append(fit)
        logs.append(log)
        # Streams that are shifted in time lie on lines between samples, which takes noise off them: nothing more than a
        # shift as nominal robots have is judged on the same streams too.
        without.append(_judged(finding, None, *trial)[1:] if option and option.effect in CLOCKS else logs[0])
    places = Counter(effect for effect, _ in {(each.effect, each.place) for each in candidates(finding.known)})
    out = []
    for option, (train, select), fit, log, other in zip(options, trials, fits, logs, without, strict=True):
        released = [*finding.released, *(option.unknowns if option else ())]
        left = leftover([*train, *select], fit, released)
        gains = np.array(log) - np.maximum(logs[0], other)
        ways, pulled = places[option.effect] if option else 1, pulls(finding.known, fit, released)
        out.append(Explanation(option, fit, float(gains[0]), float(gains[1]), ways, left, pulled))
    return out


def _judged(
    finding: Finding, option: Candidate | None, train: Evidence, select: Evidence | None
) -> tuple[Fit, float, float]:
    """A fit with one more effect, or none, its log evidence, and that of selecting recordings that show the effect."""
    released = [*finding.released, *(option.unknowns if option else ())]
    fit = train.fit(released)
    if select is None or (option and not shown(select, option)):
        return fit, fit.log, np.nan
    return fit, fit.log, select.posterior(*trained(finding.known, fit, released)).log


def _settled(finding: Finding, cache: CaseCache, rival: Candidate) -> tuple[list[Case], list[Case]]:
    """Cases of training and selecting bags around the values with a rival."""
    released = [*finding.released, *rival.unknowns]
    if rival.effect in CLOCKS:
        finding = _nearer(finding, cache, rival)
    at, train, _ = settle(finding, cache, released, ROUNDS if rival.effect in CLOCKS else 1)
    select = [
        examine(each, finding.known, at, case, released) for each, case in zip(cache.hold, finding.hold, strict=True)
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
        train = cache.near(at, finding.train, rival.unknowns)
        found.append((evidence_of(train).fit(released).log, at, train))
    _, at, train = max(found, key=lambda each: each[0])
    return replace(finding, at=at, train=train)


def shown(evidence: Evidence, option: Candidate) -> bool:
    """Whether recordings depend on any parameter of an effect."""
    return any(evidence.gram[i, i] * evidence.unknowns[i].reach ** 2 > LEAST_SHOWN for i in option.unknowns)


def _quietest(several: Sequence[Sequence[Case]]) -> list[dict[str, Noise]]:
    """By recording, the noise that the best of several explanations leaves."""
    return [reduce(quieter, (case.noise for case in cases)) for cases in zip(*several, strict=True)]


def _weighed(cases: Sequence[Case], noises: Sequence[dict[str, Noise]]) -> Evidence:
    """Of cases with a given noise each."""
    pairs = zip(cases, noises, strict=True)
    return pooled(weighed(case.problem, case.evidence.at, noise) for case, noise in pairs)


def trained(known: Sequence[Unknown], fit: Fit, released: Sequence[int]) -> tuple[Array, Array]:
    """Prior mean and variance (P,) on other recordings: released parameters stay about where training has them."""
    mean, variance = np.zeros(len(known)), prior_variance(known, precise=fit.precise)
    covariance = fit.covariance
    for i in released:
        mean[i], variance[i] = fit.x[i], covariance[i, i] + (STRETCH * fit.x[i]) ** 2
    return mean, variance


def confirmation(
    known: Sequence[Unknown], fit: Fit, held: Sequence[Case], option: Candidate, chosen: Sequence[int]
) -> float:
    """Log evidence [nats] of other recordings for an effect as trained against none of it, beside the chosen ones."""
    evidence = evidence_of(held)
    mean, variance = trained(known, fit, chosen)
    mine = [i for i in option.unknowns if not known[i].shape]  # a shape is nothing without the others
    others = [i for i in chosen if i not in mine]
    without_mean = mean.copy()
    without_mean[mine] = 0.0
    logs = []
    for kind in kinds_of(known):  # as in the search, the robot without it may be of another kind
        without = prior_variance(known, precise=kind)
        without[others] = variance[others]
        logs.append(evidence.posterior(without_mean, without).log)
    return evidence.posterior(mean, variance).log - max(logs)


def pulls(known: Sequence[Unknown], fit: Fit, released: Sequence[int]) -> dict[str, float]:
    """By width, how far its parameters are pulled from nominal [standard deviations, root mean square]."""
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
