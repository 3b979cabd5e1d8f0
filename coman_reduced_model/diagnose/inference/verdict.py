# SPDX-License-Identifier: BSD-3-Clause
"""The verdict: what the search found, and whether a recording that took no part in it agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...core.base.nominal import Nominal
from ...progress import Progress
from ..data.recording import Recording, lifts_a_foot
from ..physics.hypotheses import Candidate
from .case import Case, evidence_of, examine
from .case_cache import CaseCache
from .check import Checked
from .compare import confirmation
from .evidence import scores
from .explanation import APART, standing_out, worst_leftover
from .finding import Finding
from .floor import law_of
from .gauss_newton import settled
from .reference import CLOCKS
from .search import search
from .weight import LOADS, Weight, weight

Verdict = Literal["effect", "none", "unknown", "not_excited"]
FAR = 3.0  # standard deviations of nominal robots, from which on the report lists a law
NEEDED = 0.0  # nats of training and selecting recordings, beside the other effects, up to which an effect is needless
AGAINST = 0.0  # nats of the confirming recording, below which it speaks against an effect


@dataclass(frozen=True)
class Found:
    """Result of the search.

    Attributes:
        finding: the chosen effects and the evidence.
        leftover: by group of residuals, what the chosen effects leave, in units of the noise floor.
        verdict: in one word.
        probabilities: of `none`, `unknown`, and by effect and place, at the first choice.
        contradicted: effects that the confirming recording speaks against.
        weight: of the robot, beside the chosen effects.
    """

    finding: Finding
    leftover: dict[str, float]
    verdict: Verdict
    probabilities: dict[str, float]
    contradicted: tuple[str, ...]
    weight: Weight


def find_effects(checked: Checked, assumed: Sequence[tuple[str, str]], nominal: Nominal, progress: Progress) -> Found:
    """Search the effects, or fit the assumed ones; then open the confirming recording, which can only take away."""
    progress(0.0, "looking at the residuals")
    cache = CaseCache(checked.train, checked.select, nominal)
    finding = search(cache, assumed or None, progress)
    if not assumed:
        drop_needless(finding, cache)
    assert finding.fit is not None
    train, selecting = finding.before
    nominal_cases = [
        examine(each, cache.known, train[0].evidence.at, nominal=cache.nominal) for each in checked.confirm
    ]
    finding.before = train, [*selecting, *nominal_cases]
    against = _confirm(finding, cache, checked, nominal_cases, bool(assumed))
    leftover = finding.leftover()
    weighs = weight(finding.cases, finding.released)
    word = verdict(finding, checked.recordings[: len(checked.train)], bool(assumed), against, weighs.off)
    return Found(finding, leftover, word, probabilities(finding), against, weighs)


def drop_needless(finding: Finding, cache: CaseCache) -> None:
    """Drop effects that the others, found later, explain as well, the most needless first; the rest is fitted again.

    By training and selecting recordings together.
    """
    while len(finding.chosen) > 1:
        evidence = evidence_of([*finding.train, *finding.hold])
        gains = []
        for effect in finding.chosen:
            others = [i for i in finding.released if i not in effect.option.unknowns]
            gains.append(scores(evidence, [effect.option], others)[0].gain)
        if min(gains) > NEEDED:
            return
        _drop(finding, cache, finding.chosen[int(np.argmin(gains))].option.name)


def _drop(finding: Finding, cache: CaseCache, name: str) -> None:
    """Take an effect away, and fit the others again."""
    finding.chosen = [effect for effect in finding.chosen if effect.option.name != name]
    finding.at, finding.train, finding.fit = settled(finding, cache, finding.released)
    finding.hold = cache.at(finding.at, "hold")


def _confirm(
    finding: Finding, cache: CaseCache, checked: Checked, nominal_cases: Sequence[Case], assumed: bool
) -> tuple[str, ...]:
    """Open the confirming recording; names of the effects that it speaks against.

    One that was chosen beside others is dropped, that which is denied most first, and the others are fitted again. The
    one that was found first stays, and so do assumed ones.
    """
    against: list[str] = []
    while True:
        pairs = zip(checked.confirm, nominal_cases, strict=True)
        confirming = [examine(each, cache.known, finding.at, case) for each, case in pairs]
        assert finding.fit is not None
        finding.confirmed = {
            effect.option.name: confirmation(
                cache.known,
                finding.fit,
                confirming,
                effect.option,
                finding.released,
                finding.nominal,
                _unshifted(finding, cache, checked, nominal_cases, effect.option),
            )
            for effect in (finding.chosen if confirming else ())
        }
        denied = [name for name, nats in finding.confirmed.items() if nats < AGAINST]
        if not denied or assumed or finding.chosen[0].option.name in denied:
            finding.hold = [*finding.hold, *confirming]
            return (*against, *denied)
        worst = min(denied, key=lambda name: finding.confirmed[name])
        against.append(worst)
        _drop(finding, cache, worst)


def _unshifted(
    finding: Finding, cache: CaseCache, checked: Checked, nominal_cases: Sequence[Case], option: Candidate
) -> list[Case]:
    """Of an effect that shifts streams in time, the cases of the confirming recordings without its shift."""
    if option.effect not in CLOCKS:
        return []
    at = finding.at.copy()
    at[list(option.unknowns)] = 0.0
    return [examine(each, cache.known, at, case) for each, case in zip(checked.confirm, nominal_cases, strict=True)]


def verdict(
    finding: Finding, train: Sequence[Recording], assumed: bool, against: Sequence[str] = (), off_weight: bool = False
) -> Verdict:
    """The result in one word; with assumed effects, only whether any of them could be fitted.

    Args:
        against: effects that the confirming recording speaks against.
        off_weight: the robot surely does not weigh what its description says: then something is missing.

    Returns:
        `effect`, `none`, `unknown` (an alarm, and no effect of the catalogue is as likely as all else that may be
        missing) or `not_excited` (all recordings only stand).
    """
    if assumed:
        return "effect" if finding.chosen else "none"
    if not any(lifts_a_foot(recording.phase) for recording in train):
        return "not_excited"
    first = finding.chosen[0].option if finding.chosen and finding.chosen[0].option.name not in against else None
    if finding.steps and finding.steps[0][1].alarms:
        return "effect" if first else "unknown"
    if off_weight:  # which no spring explains
        return "effect" if first and first.effect in LOADS else "unknown"
    return "none"


def probabilities(finding: Finding) -> dict[str, float]:
    """Of `none`, `unknown` and each effect that was compared: at the first choice; {} where nothing was compared."""
    if not finding.steps:
        return {}
    explanations, found = finding.steps[0]
    out = {"none": found.none, "unknown": found.unknown}
    for explanation, p in zip(explanations[1:], found.effects, strict=True):
        assert explanation.option is not None
        out[explanation.option.name] = p
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def too_much(finding: Finding, leftover: dict[str, float]) -> list[str]:
    """Groups of residuals that are larger than on nominal robots by more than FAR standard deviations, worst first."""
    found = [(worst_leftover({key: value}, finding.nominal), key) for key, value in leftover.items()]
    return [key for z, key in sorted(found, reverse=True) if z > FAR]


def apart(finding: Finding, leftover: dict[str, float]) -> dict[str, float]:
    """Joints that stand out of those of their robot by more than FAR standard deviations: group, and how many times."""
    found = standing_out(leftover)
    far = {key: worst_leftover({f"{law_of(key)}{APART}": times}, finding.nominal) for key, times in found.items()}
    return {key: found[key] for key in sorted(far, key=lambda key: -far[key]) if far[key] > FAR}
