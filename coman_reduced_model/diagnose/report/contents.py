# SPDX-License-Identifier: BSD-3-Clause
"""Step 5, result: the contents of diagnosis.json."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ...core.base.types import Array, Integers, Phase
from ...core.config.schema import Config
from ...core.effects.catalogue import CATALOGUE
from ...core.evaluation.statistics import by_axis
from ...schemas import VERSION as SCHEMA_VERSION
from ..inference.at_size import at_share, at_values
from ..inference.case import Case, evidence_of
from ..inference.check import Checked
from ..inference.compare import pulls, still_pulled
from ..inference.effects import MEASURED, far_from_nominal
from ..inference.evidence import ONE_A_STEP, Evidence
from ..inference.finding import ChosenEffect, Finding
from ..inference.isolability import Expectation, isolability, shows, taken_for
from ..inference.predicted_com import Errors, rms
from ..inference.prediction import Predicted
from ..inference.search import smallest, total
from ..inference.variability import widths_of, with_own
from ..inference.verdict import Found, apart, too_much
from ..physics.hypotheses import Candidate, candidates
from ..result import MODEL_FILE, Diagnosis
from .decides import decides
from .words import doubtful, sentence, spaced

STEADY_SHARE = 0.7  # of a residual: where its means over whole phases make up more, it is steady
STEADY_BAND, MOVING_BAND = [0.0, 1.5], [1.5, 9.0]  # [Hz]
LEAST_TICKS = 10  # of a phase, from which on a residual is localised there
MATERIAL = 0.05  # share of what is missing that an effect explains: one that explains less is minor


def build_diagnosis(checked: Checked, found: Found, predicted: Predicted, config: Config, began: float) -> Diagnosis:
    """The result of the steps before.

    Args:
        config: nominal model, which the diagnosis keeps where nothing is named.
        began: time.perf_counter() at the start [s].
    """
    finding, effects, named = found.finding, predicted.effects, found.verdict == "effect"
    cases, options = at_share([*finding.before[0], *finding.before[1]]), candidates(finding.known)
    held = len(checked.hold_paths)  # the last: a part of a training recording may come before the only one held out
    for effect, chosen in zip(effects, finding.chosen, strict=True):
        effect["taken_for"] = could_be(finding, cases, options, chosen)
        effect["explains"] = explained(finding, chosen, effect)
        effect["minor"] = effect["explains"]["share"] < MATERIAL
    if not named:
        for effect, chosen in zip(effects, finding.chosen, strict=True):
            effect.update(in_model=False, left_out=_why_suspected(found, chosen.option.name))
    pulled_too_far = bool(finding.steps and finding.steps[0][1].pulled)
    # What was assumed was not asked for; a weight that is off, and what is still pulled too far, are never nothing.
    minor = named and only_minor(effects) and bool(found.probabilities)
    minor = minor and not (found.weight.off or still_pulled(finding))
    undecided = found.verdict == "unknown" or doubtful({"probabilities": found.probabilities})
    not_checked = list(checked.not_checked)
    if not held:
        last = f"what is found is confirmed on the last third of {confirmed_on(checked)}"
        not_checked.append(f"no held-out bag: {last if checked.confirm else 'nothing confirms what is found'}")
    if any(effect["com"]["steps"] < 2 for effect in effects):
        not_checked.append("the COM was predicted over less than two steps: an effect may make it worse")
    result = {
        "schema_version": SCHEMA_VERSION,
        "verdict": "none" if minor else found.verdict,
        "effects": effects if named else [],
        "suspected": [] if named else effects,
        "only_minor": minor,
        "ranking": ranking(finding),
        "laws": laws(finding.before[0]),
        "localisation": localisation(finding),
        "too_much": too_much(finding, found.leftover),
        "apart": {key: round(times, 2) for key, times in apart(finding, found.leftover).items()},
        "leftover": {key: round(value, 2) for key, value in sorted(found.leftover.items(), key=lambda item: -item[1])},
        "gap": {
            "train": gap(finding.before[0], finding.train, finding, predicted.train),
            "holdout": gap(finding.before[1][-held:], finding.hold[-held:], finding, predicted.hold) if held else None,
        },
        "undetectable_below": undetectable(finding),
        "groups": groups(evidence_of(cases), options),
        "decides": decides(finding, cases, effects, undecided),
        "probabilities": found.probabilities,
        "precise": list(finding.fit.precise if finding.fit else ()),
        "pulled": pulled(finding),
        "pulled_too_far": pulled_too_far,
        # Of a robot that only stands, what fits best is settling rather than its parameters.
        "far_from_nominal": [] if found.verdict == "not_excited" else far_from_nominal(finding),
        "weight": asdict(found.weight),
        "contradicted": list(found.contradicted),
        "confirmed_on": confirmed_on(checked),
        "clocks_apart": checked.clocks_apart,
        "not_checked": not_checked,
        "bags": {
            "train": [str(path) for path in checked.train_paths],
            "holdout": [str(path) for path in checked.hold_paths],
        },
        "model": MODEL_FILE,
        "seconds": time.perf_counter() - began,
    }
    result["sentence"] = sentence(result)
    return Diagnosis(result, predicted.model if named else config, finding, checked.recordings, predicted.shown)


def _why_suspected(found: Found, name: str) -> str:
    """Why an effect that was chosen is not named."""
    if name in found.contradicted:
        return "the confirming recording speaks against it"
    if found.verdict == "none":
        return "no alarm"
    first = found.finding.chosen[0].option.name
    return (
        f"{spaced(first)} is denied" if first in found.contradicted else "the weight is off, which it does not explain"
    )


def explained(finding: Finding, chosen: ChosenEffect, entry: Mapping[str, Any]) -> dict[str, Any]:
    """The share of what is missing that a chosen effect explains, and of what: both as squares.

    Physics explains the error of the predicted COM in the bags that judge it; what sensors or motors report, and what
    the model has anyway, explains the residuals that depend on it, in units of their noise floors, in held-out walks.
    """
    if CATALOGUE[chosen.option.effect].moves_com() and entry["left_out"] != MEASURED:
        before, after = (sum(value**2 for value in entry["com"][which].values()) for which in ("before", "after"))
        return {"of": "com", "share": float(1.0 - after / before) if before > 0.0 else float("nan")}
    assert finding.fit is not None
    without = with_it = 0.0
    mine = list(chosen.option.unknowns)
    for case in finding.hold or finding.train:
        x = case.own(finding.fit, finding.released)
        nominal = x.copy()
        nominal[mine] = 0.0
        left, more = case.left(x), case.left(nominal)
        for key, floor in case.floor.items():
            if floor > 0.0 and key in left and case.problem.columns[key][:, mine].any():
                with_it += float(left[key] @ left[key]) / floor**2
                without += float(more[key] @ more[key]) / floor**2
    return {"of": "residuals", "share": 1.0 - with_it / without if without > 0.0 else float("nan")}


def only_minor(effects: Sequence[Mapping[str, Any]]) -> bool:
    """Whether no effect matters to the prediction; one that the model would have but for its errors may well do."""
    return bool(effects) and all(each["minor"] and each["left_out"] in ("", MEASURED) for each in effects)


def could_be(
    finding: Finding, cases: Sequence[Case], options: Sequence[Candidate], chosen: ChosenEffect
) -> list[dict[str, Any]]:
    """What an effect of this size could be taken for in recordings like these, by expected log Bayes factor [nats]."""
    assert finding.fit is not None
    evidence = evidence_of(at_values(cases, chosen.option, finding.fit.x))
    if not shows(Expectation(evidence), chosen.option, finding.fit.x):
        return []
    rivals = taken_for(evidence, options, chosen.option, finding.fit.x)
    return [{"name": each.effect, "where": each.place, "factor": factor} for each, factor in rivals]


def groups(evidence: Evidence, options: Sequence[Candidate]) -> list[list[str]]:
    """Effects and places that recordings like these show, and cannot distinguish."""
    found = isolability(evidence, options)
    return [[found.options[i].name for i in group] for group in found.groups]


def pulled(finding: Finding) -> dict[str, float]:
    """By kind of parameter, how far what varies on nominal robots is from nominal [standard deviations].

    Of what each recording has of its own (zeros of foot sensors), that of the recording which is furthest off.
    """
    assert finding.fit is not None
    known = finding.known
    found = pulls(known, finding.fit, finding.released)
    of_each = with_own([case.evidence for case in finding.cases], finding.fit)
    each_pulls = [pulls(known, fit, finding.released) for fit in of_each]
    for name, members in widths_of(known).items():
        if name in found and all(known[i].own for i in members):
            found[name] = max(pulls_of[name] for pulls_of in each_pulls)
    rows = {name.removesuffix(".spread"): round(value, 2) for name, value in found.items() if value > 1.0}
    return dict(sorted(rows.items(), key=lambda item: -item[1]))


def confirmed_on(checked: Checked) -> str:
    """The recording that confirms."""
    if checked.hold_paths:
        return str(checked.hold_paths[-1])
    if not checked.confirm:
        return ""
    return "the same recording" if len(checked.train_paths) == 1 else str(checked.train_paths[-1])


def ranking(finding: Finding) -> list[dict[str, Any]]:
    """What each candidate alone adds to the nominal robot [nats], by effect and place, the best first."""
    held: dict[tuple[int, ...], float] = {}
    if finding.before[1]:
        held = {s.option.unknowns: s.gain for s in total(finding.before[1], [s.option for s in finding.first])}
    best: dict[tuple[str, str], dict[str, Any]] = {}
    for score in finding.first:
        key = score.option.effect, score.option.place
        entry = {
            "name": score.option.effect, "where": score.option.place, "evidence": score.gain,
            "holdout_gain": held.get(score.option.unknowns),
        }  # fmt: skip
        if key not in best or best[key]["evidence"] < score.gain:
            best[key] = entry
    return sorted(best.values(), key=lambda entry: -entry["evidence"])


def laws(cases: Sequence[Case]) -> dict[str, dict[str, float]]:
    """By channel, mean and root mean square of the residuals of the nominal robot, nothing fitted, and noise floor."""
    values: dict[str, list[Array]] = {}
    floors: dict[str, list[float]] = {}
    for case in cases:
        for key, row in case.problem.rows.items():
            values.setdefault(key.partition("|")[0], []).append(row)
            floors.setdefault(key.partition("|")[0], []).append(case.floor.get(key, 0.0))
    out = {}
    for channel, rows in values.items():
        row, level = np.concatenate(rows), float(np.sqrt(np.mean(np.square(floors[channel]))))
        out[channel] = {"mean": float(row.mean()), "rms": float(np.sqrt(np.mean(row**2))), "floor": level}
    return out


def localisation(finding: Finding) -> list[dict[str, Any]]:
    """Where the measurement disagrees with the nominal robot beyond nominal variability, largest first."""
    out = []
    for case, after in zip(finding.before[0], finding.train, strict=True):
        for key, left in finding.gaps(case, after)[0].items():
            if case.floor.get(key, 0.0) > 0.0:
                out += _localised(case, key, left)
    return sorted(out, key=lambda entry: -entry["excess"])


def _localised(case: Case, key: str, left: Array) -> list[dict[str, Any]]:
    """By support phase, the residuals `left` (n,) of a group, in SI units and in units of its noise floor."""
    channel = key.split("|")[0]
    times = case.problem.times[key]
    landings = channel in ONE_A_STEP
    phases = np.full(len(times), Phase.DOUBLE) if landings else case.recording.phase[case.where.ticks[times]]
    steady = _means_of_pieces(left, case.problem.pieces[key])
    out = []
    for phase, name in ((Phase.LEFT, "left"), (Phase.RIGHT, "right"), (Phase.DOUBLE, "double")):
        mine = phases == phase
        if mine.sum() < ONE_A_STEP.get(channel, LEAST_TICKS):
            continue
        size = float(np.sqrt(np.mean(left[mine] ** 2)))
        slow = float(np.sqrt(np.mean(steady[mine] ** 2))) > STEADY_SHARE * size
        out.append(
            {"channel": channel, "phase": name, "band_hz": list(STEADY_BAND if slow else MOVING_BAND),
             "excess": size / case.floor[key], "rms": size}
        )  # fmt: skip
    return out


def _means_of_pieces(values: Array, pieces: Integers) -> Array:
    """(n,) Mean of the contiguous piece that each of the values (n,) belongs to; pieces: their first indices."""
    ends = np.append(pieces[1:], len(values))
    return np.concatenate([np.full(b - a, values[a:b].mean()) for a, b in zip(pieces, ends, strict=True)])


def undetectable(finding: Finding) -> dict[str, dict[str, float]]:
    """By effect (at its best place) and parameter, the deviation from nominal that would just raise an alarm.

    In the units of the configuration: what is fitted in others (the place of a load, by its moment) is left out. So is
    what no parameter can be off by.
    """
    assert finding.fit is not None
    out: dict[str, dict[str, float]] = {}
    for unknown, x in smallest(finding):
        parameter = next(each for each in CATALOGUE[unknown.effect].parameters if each.name == unknown.key)
        value = abs(unknown.value(unknown.usual + x) - unknown.value(unknown.usual))
        assert isinstance(parameter.nominal, float)
        most = max(parameter.high - parameter.nominal, parameter.nominal - parameter.low)
        if unknown.unit == parameter.unit and value <= most:
            entry = out.setdefault(unknown.effect, {})
            entry[unknown.key] = min(entry.get(unknown.key, np.inf), value)
    return out


def gap(
    before: Sequence[Case], after: Sequence[Case], finding: Finding, com: Sequence[Errors]
) -> dict[str, dict[str, float]]:
    """Root mean square by channel: of the nominal robot, with the effects, and of the noise floor.

    COM channels are errors of the free run [m]; the others are structured residuals in their own units, less nominal
    variability.
    """
    squares: dict[str, dict[str, list[float]]] = {"before": {}, "after": {}, "floor": {}}
    for old, new in zip(before, after, strict=True):
        for which, left in zip(("before", "after"), finding.gaps(old, new), strict=True):
            for key, value in left.items():
                squares[which].setdefault(key.partition("|")[0], []).append(float(np.mean(value**2)))
        for key in new.problem.rows:
            squares["floor"].setdefault(key.partition("|")[0], []).append(new.floor.get(key, 0.0) ** 2)
    rows = {which: {key: float(np.sqrt(np.mean(v))) for key, v in entry.items()} for which, entry in squares.items()}
    if any(len(each.times) for each in com):
        rows["before"] |= _com_rows(rms([each.before for each in com]))
        rows["after"] |= _com_rows(rms([each.after for each in com]))
        rows["floor"] |= _com_rows(np.full(3, finding.nominal.sensors["com"]))
    return rows


def _com_rows(values: Array) -> dict[str, float]:
    return {f"com/{axis}": value for axis, value in by_axis(values).items()}
