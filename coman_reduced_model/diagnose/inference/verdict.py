# SPDX-License-Identifier: BSD-3-Clause
"""The verdict: which effects were found, and whether they leave more residuals than nominal robots leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from ...core.effects.catalogue import CATALOGUE
from ...progress import Progress
from ..data.recording import Recording, moving
from .case_cache import CaseCache
from .check import Checked
from .finding import Finding, size
from .search import SUSPECTED, search

Verdict = Literal["effect", "none", "unknown", "not_excited"]

# Largest residuals that nominal robots leave in single support, in units of the noise floor: the floor is the noise of
# the sensors, the rest is what rigid bodies on flat soles do not explain. Chosen on seeds 1280 to 1479 of the judge,
# with the torques and floors of that version: 60 nominal robots left 2.7 in force/y (they rock from edge to edge of
# their soles), 4.3 in the air, 2.1 elsewhere.
LIMITS = {
    "force": 2.7, "force/y": 4.2, "moment": 2.6, "moment/x": 3.0, "torque": 3.2, "spring": 2.9, "unloaded": 6.8,
}  # fmt: skip
ROCKING = 2.0  # factor on a limit without an IMU, which would show when the robot stands on the edge of a foot

# Where a chosen effect amounts to more than ACTS times the noise floor, the limit is TOLERANCE times as high, and at
# least the share INEXACT of the effect: the form of an effect in the model is an approximation ...
ACTS, TOLERANCE, INEXACT = 5.0, 3.0, 0.3
EXACT = {name for name, effect in CATALOGUE.items() if effect.exact}  # ... but for these


@dataclass(frozen=True)
class Found:
    """Result of the search.

    Attributes:
        finding: the chosen effects and the evidence.
        leftover: by group of residuals, what the chosen effects leave, in units of the noise floor.
        verdict: see `verdict`.
    """

    finding: Finding
    leftover: dict[str, float]
    verdict: Verdict


def find_effects(checked: Checked, assumed: Sequence[tuple[str, str]], progress: Progress) -> Found:
    """Search the effects, or fit the assumed ones, and judge what they leave.

    Where the held-out bags show that something is missing and the effects that were found do not explain it, a second
    search accepts less evidence; its result counts if it explains all residuals.
    """
    progress(0.0, "looking at the residuals")
    cache = CaseCache(checked.train, checked.hold)
    found = judge(search(cache, assumed or None, progress), checked, bool(assumed))
    if checked.hold and not assumed and too_much(found.finding, found.leftover):
        second = judge(search(cache, enough=SUSPECTED), checked)
        if not too_much(second.finding, second.leftover):
            return second
    return found


def judge(finding: Finding, checked: Checked, assumed: bool = False) -> Found:
    """A finding with its leftover and its verdict."""
    leftover = finding.leftover()
    train = checked.recordings[: len(checked.train)]
    return Found(finding, leftover, verdict(finding, leftover, train, assumed))


def verdict(finding: Finding, leftover: Mapping[str, float], train: Sequence[Recording], assumed: bool) -> Verdict:
    """The result in one word; with assumed effects, only whether any of them could be fitted.

    Returns:
        `effect`, `none`, `unknown` (residuals that no effect explains) or `not_excited` (a recording does not walk).
    """
    if assumed:
        return "effect" if finding.chosen else "none"
    if too_much(finding, leftover):
        return "unknown"
    if not any(moving(recording.phase) for recording in train):
        return "not_excited"
    if finding.chosen:
        return "effect"
    return "none" if all(moving(recording.phase) for recording in train) else "not_excited"


def too_much(finding: Finding, leftover: Mapping[str, float]) -> list[str]:
    """Groups of residuals that are larger than nominal robots leave, the worst first."""
    out, most = [], limits(finding)
    for key, value in leftover.items():
        limit = limit_of(key, most)
        if not key.endswith("|single") or limit is None:
            continue
        if (strength := acts(finding, key)) > ACTS:
            limit = max(TOLERANCE * limit, INEXACT * strength)
        if value > limit:
            out.append((value / limit, key))
    return [key for _, key in sorted(out, reverse=True)]


def acts(finding: Finding, key: str) -> float:
    """Size of the chosen effects that are not EXACT in a group of residuals, in units of the noise floor."""
    most = 0.0
    loose = [i for effect in finding.chosen if effect.option.effect not in EXACT for i in effect.option.unknowns]
    for case in [*finding.train, *finding.hold]:
        if key in case.problem.columns and case.floor.get(key, 0.0) > 0.0:
            made = case.problem.columns[key][:, loose] @ finding.at[loose]
            most = max(most, size(made) / case.floor[key])
    return most


def limits(finding: Finding) -> dict[str, float]:
    """By law or channel, the largest residual that nominal robots leave with these sensors [noise floors]."""
    seen = all(case.recording.up is not None for case in finding.train)
    return {
        kind: limit * (1.0 if seen or kind in ("spring", "unloaded") else ROCKING) for kind, limit in LIMITS.items()
    }


def limit_of(key: str, most: Mapping[str, float]) -> float | None:
    """The limit of a group of residuals: that of its channel, or else of its law."""
    name = key.split("|")[0]
    return most.get(name, most.get(name.split("/")[0]))
