# SPDX-License-Identifier: BSD-3-Clause
"""The effects that were found, as diagnosis.json lists them and as the configuration of a model has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.config.schema import OPTIONS, Config, can_turn, nominal_effects
from ...core.effects.base import EffectConfig
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import PLAN
from ..physics.hypotheses import Candidate
from .evidence import Fit
from .finding import Finding
from .prior import prior_variance
from .search import CLASSES
from .verdict import FAR

CONFIDENCE = 1.96  # standard deviations of an interval
MEASURED = "the motor states show it, so the model needs no change for it"


def effect_entries(finding: Finding, config: Config) -> list[dict[str, Any]]:
    """The chosen effects with values, intervals and evidence [nats]; all are for the model but what it has anyway."""
    if not finding.chosen:
        return []
    assert finding.fit is not None
    out = []
    for effect in finding.chosen:
        option = effect.option
        # Measured motor states already contain what the motors do to their plan.
        measured = option.where == PLAN and config.prediction.reference == "motor"
        out.append(
            {
                "name": option.effect,
                "class": _class(finding, option),
                "where": option.place,
                "parameters": _parameters(finding, finding.fit, option),
                "evidence": effect.gain,
                "select_evidence": effect.confirmed,
                "confirm_evidence": finding.confirmed.get(option.name, np.nan),
                "probability": effect.probability,
                "group": list(effect.group),
                "in_model": not measured,
                "left_out": MEASURED if measured else "",
            }
        )
    return out


def _parameters(finding: Finding, fit: Fit, option: Candidate) -> dict[str, dict[str, Any]]:
    """Value, unit and interval by parameter; the place of a payload [m] is its fitted moment m r over its mass m."""
    parameters = {finding.known[i].key: _figure(finding, fit, i) for i in option.unknowns}
    if option.effect == "payload" and "x" in parameters:
        mass = parameters["mass"]["value"] or np.nan
        for key in set("xyz") & set(parameters):
            moment = parameters[key]
            low, high = sorted((moment["interval"][0] / mass, moment["interval"][1] / mass))
            parameters[key] = {"value": moment["value"] / mass, "unit": "m", "interval": [low, high]}
    return parameters


def _figure(finding: Finding, fit: Fit, i: int) -> dict[str, Any]:
    """Value, unit and interval of parameter i."""
    known = finding.known[i]
    half = CONFIDENCE * finding.nominal.factor_of(known.effect) * float(np.sqrt(fit.covariance[i, i]))
    least = min(known.low, known.usual + fit.x[i])  # nothing below is physical
    low, value, high = (known.value(max(known.usual + fit.x[i] + k * half, least)) for k in (-1.0, 0.0, 1.0))
    return {"value": value, "unit": known.unit, "interval": [low, high]}


def far_from_nominal(finding: Finding) -> list[dict[str, Any]]:
    """Parameters beside the chosen effects that the best explanation surely needs FAR from nominal, the furthest first.

    Their intervals do not hold nominal. What each recording has of its own (zeros of foot sensors) is left out, for it
    says nothing of the robot, and what nominal robots do not have at all, which is compared as an effect.
    """
    fit = finding.fit
    assert fit is not None
    prior = prior_variance(finding.known, finding.released, fit.precise)
    rows = []
    for i, known in enumerate(finding.known):
        deviations = abs(fit.x[i]) / float(np.sqrt(prior[i]))
        if i in finding.released or known.own or not known.spread or deviations <= FAR:
            continue
        shown = _figure(finding, fit, i)
        if not shown["interval"][0] <= known.value(known.usual) <= shown["interval"][1]:
            place = {"name": known.effect, "where": known.where, "parameter": known.key}
            rows.append({**place, **shown, "deviations": round(deviations, 2)})
    return sorted(rows, key=lambda row: -row["deviations"])


def _class(finding: Finding, option: Candidate) -> str | None:
    """The class if another member explains nearly as much at this place: then only the class is sure."""
    name = CLASSES.get(option.effect)
    if name is None:
        return None
    here = [score for score in reversed(finding.first) if score.option.place == option.place]
    totals = {score.option.effect: score.gain for score in here}
    rivals = [t for effect, t in totals.items() if CLASSES.get(effect) == name and effect != option.effect]
    return name if rivals and max(rivals) > 0.5 * totals.get(option.effect, 0.0) else None


def with_structure(config: Config) -> Config:
    """The configuration with the model's options, without which the paper's point mass hides what is missing."""
    if not can_turn(config) or any(config.uses(option) for option in OPTIONS):
        return config
    return config.replaced({f"model.{option}": "with" for option in OPTIONS})


def with_effects(config: Config, effects: Sequence[Mapping[str, Any]]) -> Config:
    """The configuration with those of the listed effects that are for the model, within their bounds."""
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
