# SPDX-License-Identifier: BSD-3-Clause
"""What to record next: the manoeuvres that would split what these recordings cannot distinguish, and what more adds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ...core.base.nominal import Nominal
from ...core.base.types import Array
from ...core.effects.catalogue import CATALOGUE
from ..inference.another import LENGTH, like, shown_by
from ..inference.at_size import at_values
from ..inference.case import Case, evidence_of
from ..inference.explanation import Explanation, Odds
from ..inference.finding import Finding
from ..inference.isolability import Expectation, rivals, shows, taken_for
from ..inference.search import CLASSES
from ..physics.hypotheses import Candidate, candidates
from .words import LIKELY


def decides(
    finding: Finding, cases: Sequence[Case], entries: Sequence[Mapping[str, Any]], undecided: bool
) -> list[dict[str, Any]]:
    """As diagnosis.json has it: of each group of two or more effects, the manoeuvres and what more recordings add.

    Args:
        finding: result of the search; cases: of all recordings, as `at_share` returns them.
        entries: of the chosen effects, found or suspected, as diagnosis.json has them.
        undecided: something may be missing, also where nothing was chosen: what is likeliest then is a group.
    """
    options = candidates(finding.known)
    out = []
    for chosen, entry in zip(finding.chosen, entries, strict=True):
        assert finding.fit is not None
        same = [each for each in options if entry["class"] and CLASSES.get(each.effect) == entry["class"]]
        names = [*chosen.group, *(each.name for each in same if each.place == chosen.option.place)]
        out.append(_group(cases, options, chosen.option, finding.fit.x, names, finding.nominal))
    if undecided and not finding.chosen and finding.steps:
        explanations, found = finding.steps[0]
        if likely := _likely(explanations[1:], found):
            first = likely[0]
            assert first.option is not None
            names = [each.option.name for each in likely if each.option]
            out.append(_group(cases, options, first.option, first.fit.x, names, finding.nominal))
    return [each for each in out if len(each["group"]) > 1]


def _likely(effects: Sequence[Explanation], found: Odds) -> list[Explanation]:
    """What is likely to be missing, the most probable first, with what cannot be distinguished from that."""
    order = sorted(range(len(effects)), key=lambda k: -found.effects[k])
    likely = [k for k in order if found.effects[k] >= LIKELY]
    return [effects[k] for k in dict.fromkeys((*likely, *found.group))] if likely else []


def _group(
    cases: Sequence[Case],
    options: Sequence[Candidate],
    first: Candidate,
    values: Array,
    others: Iterable[str],
    nominal: Nominal,
) -> dict[str, Any]:
    """The effect `first`, its parameters off by `values` (P,), with other options and what it could be taken for."""
    cases = at_values(cases, first, values)
    evidence, names = evidence_of(cases), {option.name: _place_name(option) for option in options}
    alike = taken_for(evidence, options, first, values) if shows(Expectation(evidence), first, values) else []
    with_it = [names[name] for name in others if name in names]
    group = list(dict.fromkeys([_place_name(first), *with_it, *(_place_name(each) for each, _ in alike)]))
    if len(group) < 2:
        return {"group": group}
    members = [option for option in options if _place_name(option) in group]

    def least(more: Array | None = None, of: Sequence[Candidate] = members) -> float:
        return rivals(Expectation(evidence, more), of, first, values)[0][1]

    recordings: dict[int, list[Case]] = {}
    for case in cases:
        recordings.setdefault(id(case.recording), []).append(case)
    another = [(parts[0].recording.name, like(parts, evidence.unknowns)) for parts in recordings.values()]
    again = sorted(((name, least(more), more) for name, more in another), key=lambda each: -each[1])
    itself = [option for option in members if _place_name(option) == group[0]]
    experiments = manoeuvres(group)
    for each in experiments:
        mine = [option for option in members if _place_name(option) in each["effects"]]
        more = shown_by(mine, evidence.unknowns, again[0][2], nominal)
        # What measures others says something of these alone.
        each["factor"] = least(more, members if group[0] in each["effects"] else [*itself, *mine])
    return {
        "group": group,
        "manoeuvres": sorted(experiments, key=lambda each: -each["factor"]),
        "factor": least(),
        "seconds": LENGTH,
        "again": [{"bag": name, "factor": factor} for name, factor, _ in again],
    }


def manoeuvres(group: Iterable[str]) -> list[dict[str, Any]]:
    """Of effects `NAME@PLACE`, the experiments of the catalogue, each with those for which it decides."""
    found: dict[str, list[str]] = {}
    for name in group:
        found.setdefault(CATALOGUE[name.partition("@")[0]].experiment, []).append(name)
    return [{"effects": effects, "sentence": sentence} for sentence, effects in found.items()]


def _place_name(option: Candidate) -> str:
    """`NAME@PLACE`, the same for all ways in which an effect shows itself."""
    return f"{option.effect}@{option.place}" if option.place else option.effect
