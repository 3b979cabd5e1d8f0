# SPDX-License-Identifier: BSD-3-Clause
"""`coman diagnose`: bags in; diagnosis.json, model.yaml and report.html out."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from ..core.base.types import Array, Phase
from ..core.config.schema import OPTIONS, Config, can_turn, nominal_effects
from ..core.effects.base import EffectConfig
from ..core.effects.catalogue import CATALOGUE
from ..core.evaluation.statistics import by_axis
from ..core.robot.robot import Robot
from ..errors import BagError, ConfigError
from ..progress import Progress, between
from ..topics import TopicNames
from .data.masks import taken_up_anew
from .data.recording import Recording, load, moving
from .inference.case import Case, Prepared, prepare
from .inference.evidence import ONE_A_STEP
from .inference.finding import Finding, size
from .inference.limits import limit_of, limits
from .inference.predicted_com import Errors, FreeRun, FreeRuns, admitted, change, errors, rms
from .inference.search import CLASSES, SUSPECTED, Looked, search, smallest, total
from .physics.hypotheses import PLAN, Candidate, candidates, figures
from .report.words import sentence
from .result import MODEL_FILE, Diagnosis

# Where an effect that was found amounts to so many times the noise floor, so many times the limits are no surprise, nor
# is this share of what it does: it is not exactly of the form it is given here ...
ACTS, TOLERANCE, INEXACT = 5.0, 3.0, 0.3
EXACT = {  # ... unless it is one of these
    "encoder_bias", "encoder_delay", "wrench_delay", "wrench_scale", "wrench_bias", "com_offset", "payload",
    "ground_slope", "external_force",
}  # fmt: skip
CONFIDENCE = 1.96  # standard deviations of an interval


def diagnose(
    train: Sequence[str | Path],
    hold: Sequence[str | Path],
    config: Config,
    *,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    assume: Sequence[str] = (),
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the missing effects.

    Args:
        train: bags that the values are fitted to; hold: bags that take part in the choice of effects only.
        config: nominal robot and model.
        assume: effects that are told (`NAME` or `NAME:where=PLACE`): only their figures are fitted.

    A held-out bag that hardly stands steadily is left out, which `not_checked` tells.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used.
    """
    began = time.perf_counter()
    config = with_structure(config)
    report = progress or (lambda fraction, what: None)
    told = [_told(text) for text in assume]
    paths = [*train, *hold]
    for i, path in enumerate(paths):
        if Path(path).resolve() in {Path(other).resolve() for other in paths[:i]}:
            raise BagError(f"{path}: given twice: a bag cannot confirm what was found in it")
    prepared: list[Prepared] = []
    left_out: dict[str | Path, str] = {}
    helper = ProcessPoolExecutor(1, get_context("spawn"))
    free_runs = FreeRuns(helper, urdf, names)
    free_runs.start(paths, config)
    try:
        for i, path in enumerate(paths):
            part = between(report, 0.15 * i / len(paths), 0.15 * (i + 1) / len(paths))
            recording, robot = load(path, config, urdf, names, part)
            if i:
                _same_robot(path, robot, paths[0], prepared[0][1].robot)
            try:
                prepared.append(prepare(recording, robot, config))
            except BagError as error:
                if i < len(train):
                    raise
                left_out[path] = f"{error}; left out"
        paths, hold = ([path for path in some if path not in left_out] for some in (paths, hold))
        recordings = [recording for recording, _, _ in prepared]  # with what was noticed, and all of their streams
        not_checked = [*left_out.values(), *_not_checked(prepared, bool(hold))]
        prepared = _alike(prepared)
        if told:
            _check_told(told, prepared[0])
    except BaseException:
        helper.shutdown(wait=False, cancel_futures=True)  # a refusal must not wait for predictions of the other bags
        raise
    report(0.15, "looking at the residuals")
    mine, held = prepared[: len(train)], prepared[len(train) :]
    looked = Looked(mine, held)
    finding = search(looked, told or None, lambda f, w: report(0.15 + 0.65 * f, w))
    excess = finding.leftover()
    if held and not told and too_much(finding, excess):
        # Something is missing for sure: less evidence will do for what explains all of it.
        other = search(looked, enough=SUSPECTED)
        if not too_much(other, left := other.leftover()):
            finding, excess = other, left
    verdict = _verdict(finding, excess, recordings[: len(train)], bool(told))
    report(0.8, "predicting the COM")
    effects = _effects(finding, config)
    every = with_effects(config, effects)
    free_runs.start(paths[: len(train)], every)  # while the held-out bags are predicted here
    judged = paths[len(train) :] or paths
    _leave_out_what_worsens(
        effects, lambda some: free_runs.of(judged, with_effects(config, some)), "held-out" if hold else "training"
    )
    model = with_effects(config, effects)
    com = [errors(*both) for both in zip(free_runs.of(paths, config), free_runs.of(paths, model), strict=True)]
    shown = errors(free_runs.of(judged, config)[0], free_runs.of(judged, every)[0])
    helper.shutdown()
    if verdict != "effect":
        for effect in effects:
            effect.update(in_model=False, left_out="not enough to explain what is missing")
    if any(effect["com"]["steps"] < 2 for effect in effects):
        not_checked.append("the COM was predicted over less than two steps: an effect may make it worse")
    result = {
        "verdict": verdict,
        "effects": effects if verdict == "effect" else [],
        "suspected": effects if verdict != "effect" else [],
        "ranking": _ranking(finding),
        "laws": laws(finding.before[0]),
        "localisation": localisation(finding),
        "too_much": too_much(finding, excess),
        "leftover": {key: round(value, 2) for key, value in sorted(excess.items(), key=lambda item: -item[1])},
        "gap": {
            "train": _gap(finding.before[0], finding.train, finding, com[: len(train)]),
            "holdout": _gap(finding.before[1], finding.hold, finding, com[len(train) :]) if hold else None,
        },
        "undetectable_below": undetectable(finding),
        "refused": [{"name": option.effect, "where": option.place, "why": why} for option, why in finding.refused],
        "not_checked": not_checked,
        "bags": {"train": [str(path) for path in train], "holdout": [str(path) for path in hold]},
        "model": MODEL_FILE,
        "seconds": time.perf_counter() - began,
    }
    result["sentence"] = sentence(result)
    return Diagnosis(result, model if verdict == "effect" else config, finding, recordings, shown)


def _told(text: str) -> tuple[str, str]:
    name, _, rest = text.partition(":")
    key, _, where = rest.partition("=")
    if name not in CATALOGUE or (rest and key != "where"):
        raise ConfigError(f"--assume {text}: wanted NAME or NAME:where=PLACE (names: {', '.join(CATALOGUE)})")
    return name, where


def _same_robot(path: str | Path, robot: Robot, first: str | Path, expected: Robot) -> None:
    if robot.joint_names != expected.joint_names:
        raise BagError(f"{path}: of another robot than {first}: its joints are {', '.join(robot.joint_names)}")
    if not np.isclose(robot.mass, expected.mass, rtol=1e-3):
        raise BagError(
            f"{path}: of another robot than {first}: {robot.mass:.4g} kg by its URDF, not {expected.mass:.4g}"
        )


def _check_told(told: Sequence[tuple[str, str]], prepared: Prepared) -> None:
    """Refuse what `search` could not fit, and would take for absent."""
    places: dict[str, list[str]] = {}
    for option in candidates(figures(prepared[0], prepared[1])):
        places.setdefault(option.effect, []).append(option.place)
    for name, where in told:
        if name not in places:
            raise ConfigError(f"--assume {name}: cannot be fitted to these bags (can be: {', '.join(places)})")
        if where not in places[name]:
            allowed = ", ".join(dict.fromkeys(f"where={each}" if each else "no place" for each in places[name]))
            raise ConfigError(f"--assume {name}: at {where or 'no place'}: allowed: {allowed}")


def _alike(prepared: list[Prepared]) -> list[Prepared]:
    """Streams that one of the bags lacks are not used of the others: all have the same figures then."""
    drop = {
        name: None
        for name in ("tau", "motor_q", "up", "plan", "moved")
        if any(getattr(recording, name) is None for recording, _, _ in prepared)
    }
    less = [recording.changed(**drop) for recording, _, _ in prepared]
    return [
        (recording, world, taken_up_anew(where, before, recording, world))
        for recording, (before, world, where) in zip(less, prepared, strict=True)
    ]


def _verdict(finding: Finding, excess: Mapping[str, float], train: Sequence[Recording], told: bool) -> str:
    if told:
        return "effect" if finding.chosen else "none"
    if too_much(finding, excess):
        return "unknown"
    if not any(moving(recording.phase) for recording in train):
        return "not_excited"
    if finding.chosen:
        return "effect"
    return "none" if all(moving(recording.phase) for recording in train) else "not_excited"


def too_much(finding: Finding, excess: Mapping[str, float]) -> list[str]:
    """Groups of residuals of which more is left than healthy robots leave, worst first."""
    out, most = [], limits(finding)
    for key, value in excess.items():
        limit = limit_of(key, most)
        if not key.endswith("|single") or limit is None:
            continue
        if (strength := acts(finding, key)) > ACTS:
            limit = max(TOLERANCE * limit, INEXACT * strength)
        if value > limit:
            out.append((value / limit, key))
    return [key for _, key in sorted(out, reverse=True)]


def acts(finding: Finding, key: str) -> float:
    """What the chosen effects that are not exact amount to in a group of residuals, in units of the noise floor."""
    most = 0.0
    loose = [i for effect in finding.chosen if effect.option.effect not in EXACT for i in effect.option.figures]
    for case in [*finding.train, *finding.hold]:
        if key in case.problem.columns and case.floor.get(key, 0.0) > 0.0:
            made = case.problem.columns[key][:, loose] @ finding.at[loose]
            most = max(most, size(made) / case.floor[key])
    return most


def _effects(finding: Finding, config: Config) -> list[dict[str, Any]]:
    """What was found, all of it in the model but what that has anyway."""
    if not finding.chosen:
        return []
    assert finding.fit is not None
    deviation = np.sqrt(np.diag(finding.fit.covariance))
    out = []
    for effect in finding.chosen:
        option = effect.option
        known = [finding.known[i] for i in option.figures]
        # What motors do against their plan, measured motor states show the model themselves.
        measured = option.where == PLAN and config.prediction.reference == "motor"
        parameters = {}
        for i, figure in zip(option.figures, known, strict=True):
            value, half = figure.nominal + finding.fit.x[i], CONFIDENCE * deviation[i]
            parameters[figure.key] = {"value": value, "unit": figure.unit, "interval": [value - half, value + half]}
        if option.effect == "payload" and "x" in parameters:
            mass = parameters["mass"]["value"] or np.nan
            for key in set("xyz") & set(parameters):
                moment = parameters[key]
                low, high = sorted((moment["interval"][0] / mass, moment["interval"][1] / mass))
                parameters[key] = {"value": moment["value"] / mass, "unit": "m", "interval": [low, high]}
        out.append(
            {
                "name": option.effect,
                "class": _class(finding, option),
                "where": option.place,
                "parameters": parameters,
                "evidence": effect.gain,
                "holdout_evidence": effect.confirmed,
                "in_model": not measured,
                "left_out": "the motor states show it, so the model needs no change for it" if measured else "",
            }
        )
    return out


def _leave_out_what_worsens(
    effects: Sequence[dict[str, Any]], judge: Callable[[Sequence[dict[str, Any]]], list[FreeRun]], which: str
) -> None:
    """Take effects out of the model that make the predicted COM worse; all get what they make of it as `com`.

    Args:
        judge: free runs of the model with some effects, over the bags that judge them.
        which: what these bags are called.
    """
    inside = [effect for effect in effects if effect["in_model"]]
    kept, changes = admitted(len(inside), lambda some: judge([inside[i] for i in some]))
    for i, effect in enumerate(inside):
        effect["com"] = changes[i].plain()
        if i not in kept:
            effect["in_model"] = False
            effect["left_out"] = f"it makes the predicted COM of {which} walks worse, {changes[i]}"
    for effect in effects:
        if "com" not in effect:  # the model has it anyway
            runs = judge([inside[i] for i in kept])
            effect["com"] = change([errors(run, run) for run in runs]).plain()


def _class(finding: Finding, option: Candidate) -> str | None:
    """The class if another member explains nearly as much: then only the class is sure."""
    name = CLASSES.get(option.effect)
    if name is None:
        return None
    totals = {score.option.effect: score.total for score in reversed(finding.first)}
    rivals = [t for effect, t in totals.items() if CLASSES.get(effect) == name and effect != option.effect]
    return name if rivals and max(rivals) > 0.5 * totals.get(option.effect, 0.0) else None


def with_structure(config: Config) -> Config:
    """The configuration with the model's options, without which the paper's point mass hides what is missing."""
    if not can_turn(config) or any(config.uses(option) for option in OPTIONS):
        return config
    return config.replaced({f"model.{option}": "with" for option in OPTIONS})


def with_effects(config: Config, effects: Sequence[Mapping[str, Any]]) -> Config:
    """The configuration with those of the effects that are for the model."""
    added = []
    for entry in effects:
        kind = CATALOGUE.get(entry["name"])
        if kind is None or not entry["in_model"]:
            continue
        values = dict(nominal_effects([entry["name"]])[0].values)
        bounds = {p.name: (p.low, p.high) for p in kind.parameters}
        for key, value in entry["parameters"].items():
            values[key] = float(np.clip(value["value"], *bounds[key]))
        added.append(EffectConfig(entry["name"], entry["where"], values))
    return dataclasses.replace(config, effects=(*config.effects, *added))


def _ranking(finding: Finding) -> list[dict[str, Any]]:
    held: dict[str, float] = {}
    if finding.before[1]:
        held = {s.option.name: s.gain for s in reversed(total(finding.before[1], [s.option for s in finding.first]))}
    best: dict[tuple[str, str], dict[str, Any]] = {}
    for score in finding.first:
        key = score.option.effect, score.option.place
        entry = {
            "name": score.option.effect, "where": score.option.place, "evidence": score.gain,
            "holdout_gain": held.get(score.option.name),
        }  # fmt: skip
        if key not in best or best[key]["evidence"] < score.gain:
            best[key] = entry
    return sorted(best.values(), key=lambda entry: -entry["evidence"])


def laws(cases: Sequence[Case]) -> dict[str, dict[str, float]]:
    """Mean and root mean square by channel of what the nominal robot leaves, nothing fitted at all, and noise floor."""
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
    """Where the measurement disagrees with the nominal robot beyond healthy scatter, largest first."""
    out = []
    for case, after in zip(finding.before[0], finding.train, strict=True):
        for key, left in finding.gaps(case, after)[0].items():
            level = case.floor.get(key, 0.0)
            if level <= 0.0:
                continue
            channel, part = key.split("|")
            times, pieces = case.problem.times[key], case.problem.pieces[key]
            landings = channel in ONE_A_STEP
            phases = np.full(len(times), Phase.DOUBLE) if landings else case.recording.phase[case.where.ticks[times]]
            for phase, name in ((1, "left"), (2, "right"), (3, "double")):
                mine = phases == phase
                if mine.sum() < ONE_A_STEP.get(channel, 10):
                    continue
                rms = float(np.sqrt(np.mean(left[mine] ** 2)))
                ends = np.append(pieces[1:], len(left))
                steady = np.concatenate([np.full(b - a, left[a:b].mean()) for a, b in zip(pieces, ends, strict=True)])
                slow = float(np.sqrt(np.mean(steady[mine] ** 2))) > 0.7 * rms
                out.append(
                    {"channel": channel, "phase": name, "band_hz": [0.0, 1.5] if slow else [1.5, 9.0],
                     "excess": rms / level, "rms": rms}
                )  # fmt: skip
    return sorted(out, key=lambda entry: -entry["excess"])


def undetectable(finding: Finding) -> dict[str, dict[str, float]]:
    """By effect (at its best place) and parameter, the deviation that would just be accepted."""
    assert finding.fit is not None
    out: dict[str, dict[str, float]] = {}
    for figure, value in smallest(finding):
        entry = out.setdefault(figure.effect, {})
        entry[figure.key] = min(entry.get(figure.key, np.inf), value)
    return out


def _gap(
    before: Sequence[Case], after: Sequence[Case], finding: Finding, com: Sequence[Errors]
) -> dict[str, dict[str, float]]:
    """Root mean square by channel: of the nominal robot, with the effects, and of the noise floor.

    COM channels are errors of the free run [m]; the others are structured residuals in their own units, free of the
    scatter of healthy robots.
    """
    sums: dict[str, dict[str, list[float]]] = {"before": {}, "after": {}, "floor": {}}
    for old, new in zip(before, after, strict=True):
        for which, left in zip(("before", "after"), finding.gaps(old, new), strict=True):
            for key, value in left.items():
                sums[which].setdefault(key.partition("|")[0], []).append(float(np.mean(value**2)))
        for key in new.problem.rows:
            sums["floor"].setdefault(key.partition("|")[0], []).append(new.floor.get(key, 0.0) ** 2)
    rows = {which: {key: float(np.sqrt(np.mean(v))) for key, v in entry.items()} for which, entry in sums.items()}
    if any(len(each.times) for each in com):
        rows["before"] |= _com_rows(rms([each.before for each in com]))
        rows["after"] |= _com_rows(rms([each.after for each in com]))
        rows["floor"] |= _com_rows(np.full(3, COM_FLOOR))
    return rows


def _com_rows(values: Array) -> dict[str, float]:
    return {f"com/{axis}": value for axis, value in by_axis(values).items()}


COM_FLOOR = 0.0002  # [m] of the measured COM with 12-bit encoders


def _not_checked(prepared: Sequence[Prepared], held: bool) -> list[str]:
    lines, recordings = [], [recording for recording, _, _ in prepared]
    if any(recording.tau is None for recording in recordings):
        lines.append("no joint torques: springs are judged by what the foot wrenches ask for")
    if any(recording.motor_q is None for recording in recordings):
        lines.append("no motor states: springs, motors and play cannot be judged")
    if any(recording.up is None for recording in recordings):
        lines.append("no IMU: a sloping floor and a pull look alike")
    if any(recording.plan is None for recording in recordings):
        lines.append("no com/reference with motor states: what the motors make of it cannot be judged")
    if any(moving(recording.phase) and not where.slides for recording, _, where in prepared):
        lines.append("in a bag, the other foot leaves soon after each landing: a foot that slides does not show there")
    if not held:
        lines.append("no held-out bag: every value and every choice comes from the same recordings")
    for recording in recordings:
        lines += [f"{recording.name}: {warning}" for warning in recording.warnings]
    return lines
