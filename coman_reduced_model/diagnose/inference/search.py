# SPDX-License-Identifier: BSD-3-Clause
"""Which effects are missing: one after the other, as far as the evidence and held-out recordings say so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np

from ...core.base.types import Array
from ...core.effects.base import Effect as BaseEffect
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import LINKS, PLAN, Unknown
from ...progress import Progress
from ..data.recording import moving
from ..physics.hypotheses import Candidate, candidates
from .case import Case, evidence_of
from .case_cache import CaseCache
from .evidence import Fit, Score, prior_variance, quieter, scores, weighed
from .finding import ChosenEffect, Finding
from .gauss_newton import ROUNDS, settle, settled

ENOUGH = 4.5  # nats that an effect must add, as the mean of training bags and of held-out bags
FEW, FEWER = 4, 1.1  # an effect of at most FEW ways (places, axes) instead of twelve has better odds, by FEWER nats
SUSPECTED = 2.0  # the same where something is missing for sure, and this is all of it
# Nats that another effect must add beside one at most, and as a share of what that one adds: what an effect explains
# not quite looks like a second one.
FURTHER, INHERITED = 8.0, 0.05
ALONE = 9.0  # nats that it must add on the training bags where no held-out bag can contradict
WORTH_TRYING = 0.55  # of these, on the training bags, for a look at the held-out ones
AGREES = 2.0  # nats that it must add on the held-out bags
SURE = 2.0  # standard deviations by which the mass of a load must differ from zero
VISIBLE = 0.5  # of the noise floor, that an effect must amount to in some residual
MOST = 3  # effects at once
TOUCHED = 0.1  # of the noise floor, from which on an effect is seen in a residual at all
LARGEST = 6.0  # times its reach: what is larger is no such effect, whatever the fit says
RIVALS, CLOSE = 4, 0.03  # number that is compared closely, if they explain at least this share of the best's
# Effects that look alike in a walk: one of a class is enough.
CLASSES = {name: effect.ambiguity.name for name, effect in CATALOGUE.items() if effect.ambiguity}
CLOCKS = {name for name, effect in CATALOGUE.items() if effect.clock}  # of joints: alike until linearised there
# A payload with its place is both mass and COM: two loads are one.
LOADS = {name for name, effect in CATALOGUE.items() if effect.load is not BaseEffect.load}


def search(
    cache: CaseCache,
    assumed: Sequence[tuple[str, str]] | None = None,
    progress: Progress | None = None,
    enough: float | None = None,
) -> Finding:
    """Forward selection, with a new linearisation after each choice and a look at the held-out bags.

    Of a robot that does not walk, nothing is chosen: what moves so little is settling, not physics.

    Args:
        cache: the recordings.
        assumed: effects by name and place; only their parameters are fitted, and nothing else is chosen.
        progress: called after each choice.
        enough: evidence that an effect needs [nats]; default: ENOUGH, or ALONE without held-out recordings.
    """
    known, hold = cache.known, bool(cache.hold)
    walks = any(moving(recording.phase) for recording, _, _ in cache.train)
    finding = Finding(known, np.zeros(len(known)))
    enough = enough or (ENOUGH if hold else ALONE)
    options = candidates(known)
    needed, whole = _needed(enough, options), _whole_load(options)
    tried = WORTH_TRYING if hold else 1.0
    finding.before = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    finding.train, finding.hold = finding.before
    if assumed is not None:
        return fit_assumed(finding, cache, options, assumed)
    nominal = finding.at
    while True:
        cache.forget(nominal, finding.at)
        evidence = evidence_of(finding.train)
        finding.fit = evidence.fit(finding.released)
        refused = [option for option, _ in finding.refused]
        taken = {i for effect in finding.chosen for i in effect.option.unknowns}
        kin = {CLASSES[effect.option.effect] for effect in finding.chosen if effect.option.effect in CLASSES}
        loaded = any(effect.option == whole for effect in finding.chosen)
        # With play, a joint is at the one end or the other: what looks like its zero is where it mostly is.
        shown = {(e.option.effect, e.option.place): e.option.where for e in finding.chosen}  # not in two ways at once
        loose = {effect.option.where for effect in finding.chosen if effect.option.effect == "backlash"}
        rest = [
            option
            for option in options
            if option not in refused
            and not taken.intersection(option.unknowns)
            and CLASSES.get(option.effect) not in kin
            and shown.get((option.effect, option.place), option.where) == option.where
            and not (loaded and option.effect in LOADS)
            and not (option.effect == "encoder_bias" and option.where in loose)
        ]
        finding.last = scores(evidence, rest, finding.released)
        finding.first = finding.first or finding.last
        strong = _no_twins([
            score for score in finding.last
            if score.physical and score.gain > tried * needed[score.option.effect]
            and _visible(finding.train, score) > VISIBLE
        ])  # fmt: skip
        if len(finding.chosen) >= MOST or not strong or not walks:
            return finding
        rivals = [score for score in strong[:RIVALS] if score.total > CLOSE * strong[0].total]
        if any(score.option.effect in CLOCKS for score in rivals):
            rivals += [score for score in strong if score.option.effect in CLOCKS and score not in rivals]
        best = rivals[cache.memoize(_closest, finding, *(rival.option for rival in rivals))]
        at, fit, confirmed, why = cache.memoize(_tried, finding, best.option)
        if not why and not _enough(finding, cache.at(at, "hold"), fit, best, confirmed, enough, needed):
            why = f"too little evidence ({best.gain:.1f} nats, held-out bags {confirmed:.1f})"
        if why:
            finding.refused.append((best.option, why))
            continue
        finding.chosen.append(ChosenEffect(best.option, best.gain, confirmed))
        finding.at, finding.train, finding.hold = at, cache.at(at, "train"), cache.at(at, "hold")
        _drop_explained_by_last(finding, cache, enough, needed)
        _one_load(finding, cache, options)
        if progress:
            progress(len(finding.chosen) / (MOST + 1), f"{best.option.name}: {best.gain:.0f} nats")


def _tried(finding: Finding, cache: CaseCache, option: Candidate) -> tuple[Array, Fit, float, str]:
    """Values with an effect beside the chosen ones, their fit, held-out evidence [nats], and a reason to refuse it."""
    at, _, fit = settled(finding, cache, [*finding.released, *option.unknowns])
    if why := _impossible(finding.known, fit, option):
        return at, fit, np.nan, why
    if not cache.hold:
        return at, fit, np.nan, ""
    return at, fit, *_confirm(finding.known, fit, cache.at(at, "hold"), finding, option)


def _impossible(known: Sequence[Unknown], fit: Fit, option: Candidate) -> str:
    """Why an effect with the parameters that fit best is impossible; empty if it is possible."""
    if any(fit.x[i] < known[i].low for i in option.unknowns):
        return "of the wrong sign, seen closely"
    if any(abs(fit.x[i]) > LARGEST * known[i].reach for i in option.unknowns):
        return "it would have to be larger than any such effect is"
    if option.effect == "payload":
        mass = option.unknowns[0]
        if abs(fit.x[mass]) < SURE * np.sqrt(fit.covariance[mass, mass]):
            return "a load without a mass that is seen: if anything, the COM is shifted"
    return ""


def _drop_explained_by_last(finding: Finding, cache: CaseCache, enough: float, needed: dict[str, float]) -> None:
    """Backward elimination: an effect that was chosen first may have stood for one that was found later.

    It needs as much evidence beside the later one as if it had come after it.
    """
    for effect in finding.chosen[:-1]:
        option, train = effect.option, evidence_of(finding.train)
        shapes = [i for i in option.unknowns if finding.known[i].shape]  # without the others they are nothing
        bare = replace(option, unknowns=tuple(i for i in option.unknowns if i not in shapes))
        fit = train.fit(finding.released)
        rest = replace(finding, chosen=[other for other in finding.chosen if other is not effect], fit=fit)
        (alone,) = scores(train, [bare], [*rest.released, *shapes])
        tried = 1.0 if np.isnan(effect.confirmed) else WORTH_TRYING
        if alone.gain >= tried * enough and _enough(
            rest, finding.hold, fit, replace(alone, option=option), effect.confirmed, enough, needed
        ):
            continue
        finding.chosen.remove(effect)
        finding.refused.append((effect.option, f"explained by {finding.chosen[-1].option.name}, which was found later"))
        finding.at, finding.train, finding.fit = settled(finding, cache, finding.released)
        finding.hold = cache.at(finding.at, "hold")


def _needed(enough: float, options: Sequence[Candidate]) -> dict[str, float]:
    """By effect, the evidence that it needs where one of twelve and more places needs `enough`."""
    ways = Counter(option.effect for option in options)
    return {name: enough if count > FEW else max(enough - FEWER, SUSPECTED) for name, count in ways.items()}


def _wanted(finding: Finding, name: str, enough: float, needed: dict[str, float]) -> float:
    """The evidence that an effect needs beside those that were chosen: more beside one of another name."""
    others = [effect for effect in finding.chosen if effect.option.effect != name]
    if not others:
        return needed[name]
    most = max(float(np.nanmean([effect.gain, effect.confirmed])) for effect in others)
    return min(max(enough, FURTHER), max(needed[name], ENOUGH - FEWER) + INHERITED * most)


def _enough(
    finding: Finding,
    held: Sequence[Case],
    fit: Fit,
    score: Score,
    confirmed: float,
    enough: float,
    needed: dict[str, float],
) -> bool:
    """Whether an effect has the evidence that it needs beside those that were chosen.

    Args:
        finding: without it; held: held-out recordings, linear where the `fit` (training) has it.
        score, confirmed: what it adds on training and on held-out recordings.
    """
    sure = float(np.nanmean([score.gain, confirmed]))
    if sure >= _wanted(finding, score.option.effect, enough, needed):
        return True
    least = max(needed[score.option.effect], ENOUGH - FEWER)
    return sure >= least and _apart(finding, held, fit, score, least)


def _no_twins(found: Sequence[Score]) -> list[Score]:
    """Without those that explain the same as others of their effect and place with more parameters."""

    def twin(a: Score, b: Score) -> bool:
        same = (a.option.effect, a.option.where) == (b.option.effect, b.option.where)
        return (
            same and len(a.option.unknowns) < len(b.option.unknowns) and bool(np.isclose(a.total, b.total, atol=1e-6))
        )

    return [score for score in found if not any(twin(score, other) for other in found)]


def _apart(finding: Finding, held: Sequence[Case], fit: Fit, score: Score, least: float) -> bool:
    """Whether an effect has the `least` evidence [nats] where those that were chosen do nothing.

    There it cannot stand for what they explain not quite.
    """
    touched = set().union(*(_touched(case, finding) for case in [*finding.train, *held]))
    train, hold = ([_without(case, touched) for case in cases] for cases in (finding.train, held))
    (alone,) = scores(evidence_of(train), [score.option], finding.released)
    confirmed, why = _confirm(finding.known, fit, hold, finding, score.option) if hold else (np.nan, "")
    return alone.physical and not why and float(np.nanmean([alone.gain, confirmed])) >= least


def _touched(case: Case, finding: Finding) -> set[str]:
    """Groups of residuals in which the chosen effects are seen at all."""
    assert finding.fit is not None
    out = set()
    for effect in finding.chosen:
        which = list(effect.option.unknowns)
        for key, columns in case.problem.columns.items():
            made = columns[:, which] @ finding.fit.x[which]
            if float(np.sqrt(np.mean(made**2))) > TOUCHED * case.floor.get(key, 0.0):
                out.add(key)
    return out


def _without(case: Case, groups: set[str]) -> Case:
    """The same recording as if it had no such groups of residuals."""
    problem = replace(case.problem, rows={key: row for key, row in case.problem.rows.items() if key not in groups})
    return replace(case, problem=problem, evidence=weighed(problem, case.evidence.at, case.noise))


def _one_load(finding: Finding, cache: CaseCache, options: Sequence[Candidate]) -> None:
    """Replace a shifted COM and an added mass by one load with its place, if held-out bags confirm it."""
    loads = [effect for effect in finding.chosen if effect.option.effect in LOADS]
    whole = _whole_load(options)
    if len(loads) < 2 or whole is None:
        return
    others = [effect for effect in finding.chosen if effect not in loads]
    released = [i for effect in others for i in effect.option.unknowns]
    (score,) = scores(evidence_of(finding.train), [whole], released)
    alone = replace(finding, chosen=others)
    at, train, fit = settled(alone, cache, [*released, *whole.unknowns])
    held = cache.at(at, "hold")
    confirmed, why = _confirm(finding.known, fit, held, alone, whole) if held else (np.nan, "")
    if not (why or _impossible(finding.known, fit, whole)):
        finding.chosen = [*others, ChosenEffect(whole, score.gain, confirmed)]
        finding.at, finding.train, finding.hold, finding.fit = at, train, held, fit


def _whole_load(options: Sequence[Candidate]) -> Candidate | None:
    """A payload with all parameters of its place."""
    loads = [option for option in options if option.effect == "payload"]
    return max(loads, key=lambda option: len(option.unknowns), default=None)


def fit_assumed(
    finding: Finding, cache: CaseCache, options: Sequence[Candidate], assumed: Sequence[tuple[str, str]]
) -> Finding:
    """Fit the parameters of the assumed effects, given by name and place."""
    finding.first = finding.last = scores(evidence_of(finding.train), options)
    for name, where in assumed:
        mine = [s for s in finding.first if s.option.effect == name and s.option.where in (where, PLAN, LINKS)]
        if mine:  # the way in which it shows most
            finding.chosen.append(ChosenEffect(mine[0].option, mine[0].gain, np.nan))
    finding.at, finding.train, finding.fit = settled(finding, cache, finding.released)
    finding.hold = cache.at(finding.at, "hold")
    return finding


def total(cases: Sequence[Case], options: Sequence[Candidate]) -> list[Score]:
    """What each candidate adds on these recordings."""
    return scores(evidence_of(cases), options)


def smallest(finding: Finding) -> list[tuple[Unknown, float]]:
    """By parameter of an effect, the deviation from nominal with just enough evidence beside the chosen effects."""
    enough = ENOUGH if finding.hold else ALONE
    needed = _needed(enough, candidates(finding.known))
    fit, before = evidence_of(finding.train).fit(finding.released), prior_variance(finding.known, finding.released)
    variance = np.diag(fit.covariance)
    out = []
    for i, unknown in enumerate(finding.known):
        if not unknown.effect or not unknown.offered or unknown.shape or i in finding.released:
            continue
        narrow = max(unknown.spread, unknown.slack)
        information = 1.0 / variance[i] - 1.0 / before[i]
        if information < 1e-6 / unknown.reach**2:  # the recordings do not depend on it
            continue
        noise = 1.0 / information  # variance by the data alone
        # A deviation d is worth d^2/2 (1/(noise + narrow^2) - 1/(noise + reach^2)) less the price of the wider prior.
        worth = 1.0 / (noise + narrow**2) - 1.0 / (noise + unknown.reach**2)
        price = 0.5 * np.log((noise + unknown.reach**2) / (noise + narrow**2))
        wanted = _wanted(finding, unknown.effect, enough, needed)
        out.append((unknown, float(np.sqrt(2.0 * (wanted + price) / max(worth, 1e-30)))))
    return out


def _visible(cases: Sequence[Case], score: Score) -> float:
    """The most that a candidate amounts to in any residual, in units of its noise floor (root mean square).

    Or of an encoder's resolution: the error of a slow encoder is no noise, and comes again with every step.
    """
    most = 0.0
    for case in cases:
        for key, columns in case.problem.columns.items():
            made = columns[:, list(score.option.unknowns)] @ score.values
            count = case.problem.resolution.get(key.partition("|")[0], 0.0)
            level = max(case.floor.get(key, 0.0), count / np.sqrt(12.0), 1e-12)
            most = max(most, float(np.sqrt(np.mean(made**2))) / level)
    return most


def _closest(finding: Finding, cache: CaseCache, *rivals: Candidate) -> int:
    """Index of the best of similar rivals: each linear around its own values, all with the same noise."""
    if len(rivals) == 1:
        return 0
    trials = []
    for rival in rivals:
        released = [*finding.released, *rival.unknowns]
        rounds = ROUNDS if rival.effect in CLOCKS else 1
        trials.append((released, settle(finding, cache, released, rounds)[1]))
    count = len(trials[0][1])
    noises = [reduce(quieter, (cases[k].noise for _, cases in trials)) for k in range(count)]
    logs = []
    for released, cases in trials:
        evidence = reduce(
            add,
            (
                weighed(case.problem, case.evidence.at, noise).shared()
                for case, noise in zip(cases, noises, strict=True)
            ),
        )
        logs.append(evidence.fit(released).log)
    return int(np.argmax(logs))


def _confirm(
    known: list[Unknown], fit: Fit, held: Sequence[Case], finding: Finding, option: Candidate
) -> tuple[float, str]:
    """Log evidence on held-out recordings for the effect as trained against none of it; and why not, if not."""
    evidence = evidence_of(held)
    released = [*finding.released, *option.unknowns]
    covariance = fit.covariance
    nominal = prior_variance(known, finding.released)
    mean, variance = np.zeros(len(known)), nominal.copy()
    for i in released:
        mean[i], variance[i] = fit.x[i], covariance[i, i] + (0.1 * fit.x[i]) ** 2
    without_mean, without = mean.copy(), variance.copy()
    for i in option.unknowns:
        if known[i].shape:  # it is nothing without the others
            continue
        without_mean[i], without[i] = 0.0, max(known[i].slack, known[i].spread, 1e-9 * known[i].reach) ** 2
    gain = evidence.posterior(mean, variance).log - evidence.posterior(without_mean, without).log
    if gain < AGREES:
        return gain, f"held-out bags {'speak against it' if gain < 0.0 else 'show too little of it'} ({gain:.1f} nats)"
    again = evidence.fit(released)
    spread = np.sqrt(np.diag(again.covariance) + np.diag(covariance))
    for i in option.unknowns:
        if abs(again.x[i] - fit.x[i]) > 4.0 * spread[i] + 0.35 * abs(fit.x[i]) + known[i].spread:
            return gain, f"held-out bags find another {known[i].key} ({again.x[i]:.3g} for {fit.x[i]:.3g})"
    return gain, ""
