# SPDX-License-Identifier: BSD-3-Clause
"""Which effects are missing: one after the other, as long as one, with what looks alike, is likely (`Odds.names`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ...core.effects.base import Effect as BaseEffect
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import FEET, LINKS, PLAN, Unknown
from ...progress import Progress
from ..data.recording import lifts_a_foot
from ..physics.hypotheses import Candidate, candidates
from .case import Case, evidence_of
from .case_cache import CaseCache
from .compare import compare, places_of
from .decide import nats_for_alarm, odds
from .evidence import Score, scores
from .explanation import Explanation
from .finding import ChosenEffect, Finding
from .gauss_newton import settled
from .prior import prior_variance
from .reference import CLOCKS

MOST = 3  # effects at once
RIVALS, PLACES = 6, 2  # effects that are compared closely; places of each
WORTH_A_LOOK = 1.0  # nats, as linear about nominal, from which an effect is compared
# Effects that look alike in a walk: one of a class is enough.
CLASSES = {name: effect.ambiguity.name for name, effect in CATALOGUE.items() if effect.ambiguity}
# A payload with its place is both mass and COM: two loads of the trunk are one.
LOADS = {name for name, effect in CATALOGUE.items() if effect.load is not BaseEffect.load and effect.place == "robot"}


def search(
    cache: CaseCache, assumed: Sequence[tuple[str, str]] | None = None, progress: Progress | None = None
) -> Finding:
    """Choose effects one by one, as long as one is likely; whether they are worth an alarm is the verdict's.

    Of a robot that only stands, nothing is chosen: what moves so little is settling, not physics.

    Args:
        cache: the training recordings, and those that help to select.
        assumed: effects by name and place; only their parameters are fitted, and nothing else is chosen.
        progress: called after each choice.
    """
    known = cache.known
    finding = Finding(known, np.zeros(len(known)), nominal=cache.nominal)
    options = candidates(known)
    finding.before = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    finding.train, finding.hold = finding.before
    if assumed is not None:
        return fit_assumed(finding, cache, options, assumed)
    walks = any(lifts_a_foot(recording.phase) for recording, _, _ in cache.train)
    while True:
        evidence = evidence_of(finding.train)
        finding.fit = evidence.fit(finding.released)
        finding.first = finding.first or scores(evidence, options)
        if not walks or len(finding.chosen) >= MOST:
            return finding
        explanations = compare(finding, cache, rivals_of(finding, options))
        explanations = [each for each in explanations if each.option is None or possible(known, each)]
        found = odds(explanations, finding.nominal)
        finding.steps.append((explanations, found))
        if not found.names:
            return finding
        best = explanations[1 + found.group[0]]
        assert best.option is not None
        names = tuple(dict.fromkeys(explanations[1 + k].option.name for k in found.group))  # type: ignore[union-attr]
        finding.chosen.append(ChosenEffect(best.option, best.gain, best.confirmed, found.named, names))
        if best.option.effect in CLOCKS:  # far from nominal, it is found only from where it was found before
            assert best.at is not None
            finding.at = best.at
            finding.train = cache.at(finding.at, "train")
        finding.at, finding.train, finding.fit = settled(finding, cache, finding.released)
        finding.hold = cache.at(finding.at, "hold")
        if progress:
            progress(len(finding.chosen) / (MOST + 1), f"{best.option.name}: {best.gain:.0f} nats")


def rivals_of(finding: Finding, options: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that are worth to be compared closely beside the effects that were chosen."""
    evidence = evidence_of([*finding.train, *finding.hold])
    found = scores(evidence, list(_left(options, finding)), finding.released)
    return [score.option for score in _rivals(found)]


def _left(options: Sequence[Candidate], finding: Finding) -> Iterator[Candidate]:
    """Candidates beside the effects that were chosen."""
    chosen = [effect.option for effect in finding.chosen]
    taken = {i for option in chosen for i in option.unknowns}
    loaded = any(option.effect in LOADS for option in chosen)
    for option in options:
        again = any(option.effect == other.effect and option.place == other.place for other in chosen)
        if not (
            again
            or taken.intersection(option.unknowns)
            or any(_alike(option, other) for other in chosen)
            or (loaded and option.effect in LOADS)
        ):
            yield option


def _alike(option: Candidate, other: Candidate) -> bool:
    """Whether they are of one class and could be one effect: not at two joints."""
    same = option.effect in CLASSES and CLASSES[option.effect] == CLASSES.get(other.effect)
    return same and (option.place == other.place or option.place in FEET or other.place in FEET)


def _rivals(found: Sequence[Score]) -> list[Score]:
    """The best way of each of the best effects, at its best PLACES; with one clock, every way of all of them."""
    best: dict[tuple[str, str], Score] = {}
    clocks: dict[tuple[str, str], Score] = {}
    for score in found:
        effect, place = score.option.effect, score.option.place
        if score.physical and score.gain > WORTH_A_LOOK:
            best.setdefault((effect, place), score)
        if effect in CLOCKS and not place:
            clocks.setdefault((effect, score.option.where), score)
    rivals: list[Score] = []
    for score in best.values():
        if sum(each.option.effect == score.option.effect for each in rivals) < PLACES:
            rivals.append(score)
    del rivals[RIVALS:]
    if any(score.option.effect in CLOCKS for score in rivals):
        rivals += [score for score in clocks.values() if score not in rivals]
    return rivals


def possible(known: Sequence[Unknown], explanation: Explanation) -> bool:
    """Whether the parameters that fit best are within the bounds of physics."""
    assert explanation.option is not None
    x = explanation.fit.x
    return all(x[i] >= known[i].low for i in explanation.option.unknowns)


def fit_assumed(
    finding: Finding, cache: CaseCache, options: Sequence[Candidate], assumed: Sequence[tuple[str, str]]
) -> Finding:
    """Fit the parameters of the assumed effects, given by name and place."""
    finding.first = scores(evidence_of(finding.train), options)
    for name, where in dict.fromkeys(assumed):
        mine = [s for s in finding.first if s.option.effect == name and s.option.where in (where, PLAN, LINKS)]
        if mine:  # in the possible way in which it shows most: a parameter that they leave open is not fitted
            best = next((score for score in mine if score.physical), mine[0])
            finding.chosen.append(ChosenEffect(best.option, best.gain, np.nan))
    finding.at, finding.train, finding.fit = settled(finding, cache, finding.released)
    finding.hold = cache.at(finding.at, "hold")
    return finding


def total(cases: Sequence[Case], options: Sequence[Candidate]) -> list[Score]:
    """What each candidate adds on these recordings."""
    return scores(evidence_of(cases), options)


def smallest(finding: Finding) -> list[tuple[Unknown, float]]:
    """By parameter of an effect, the deviation from nominal that would raise an alarm: before anything was chosen."""
    fit = evidence_of(finding.before[0]).fit()
    before = prior_variance(finding.known, precise=fit.precise)
    variance, places = np.diag(fit.covariance), places_of(finding.known)
    compared = finding.steps[0][0] if finding.steps else ()
    selected = not np.isnan(compared[0].confirmed) if compared else bool(finding.hold)  # others helped to choose
    out = []
    for i, unknown in enumerate(finding.known):
        if not unknown.effect or not unknown.offered or unknown.shape:
            continue
        information = 1.0 / variance[i] - 1.0 / before[i]
        if information < 1e-6 / unknown.reach**2:  # the recordings do not depend on it
            continue
        noise = 1.0 / information  # variance by the data alone
        # A deviation d is worth d^2/2 (1/(noise + spread^2) - 1/(noise + reach^2)) less the price of the wider prior.
        worth = 1.0 / (noise + before[i]) - 1.0 / (noise + unknown.reach**2)
        price = 0.5 * np.log((noise + unknown.reach**2) / (noise + before[i]))
        enough = nats_for_alarm(finding.nominal, places[unknown.effect], selected)
        out.append((unknown, float(np.sqrt(2.0 * (enough + price) / max(worth, 1e-30)))))
    return out
