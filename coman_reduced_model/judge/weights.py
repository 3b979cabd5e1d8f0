# SPDX-License-Identifier: BSD-3-Clause
"""Weights by which an effect is named, and what they are worth on kinds of worlds that they did not see.

The weights are those of a conditional logit with ridge; see diagnose/inference/decide.py.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import softmax

from ..core.base.nominal import Nominal
from ..core.base.types import Array, Booleans
from ..diagnose.inference.decide import ALL, EFFECT, NO_ALARM, probabilities, score
from ..diagnose.inference.explanation import UNKNOWN, features
from .cases import SHARES
from .families import class_of
from .score import rate

RIDGE = 0.01  # of the squared weights, on the mean log loss
FALSE_ALARMS = 0.01  # share of the clean cases that raise an alarm
PULLED = 0.002  # ... because all that varies is pulled too far together
AXES = ("engine", "contact", "sensors", "controller", "streams")  # of worlds, whose kinds are left out
SHOWN = ("right", "wrong", "false_alarms", "unknown")
ANSWERS = {"clean": "none", "unknown": "unknown"}  # else the classes of what is hidden


@dataclass(frozen=True)
class Example:
    """The first comparison of a case.

    Attributes:
        answer: of the case; nominal: what its robot was compared to.
        rows: nothing more, then each rival: name, where, gain, confirmed, ways, leftover (by law), pulled, together,
            parameters.
    """

    answer: Mapping[str, Any]
    nominal: Nominal
    rows: Sequence[Mapping[str, Any]]

    @property
    def truth(self) -> set[str]:
        """`none`, `unknown` or classes of effects, any of which is right."""
        kind = self.answer["kind"]
        return {ANSWERS[kind]} if kind in ANSWERS else {class_of(e["name"], e["where"]) for e in self.answer["effects"]}

    @cached_property
    def alone(self) -> Example:
        """The same without selecting recordings."""
        return replace(self, rows=[{**row, "confirmed": None} for row in self.rows])

    @cached_property
    def features(self) -> list[dict[str, float]]:
        """Of each row, as `Explanation.features`."""
        out = []
        for row in self.rows:
            confirmed = np.nan if row["confirmed"] is None else float(row["confirmed"])
            found = row["gain"], confirmed, row["ways"], row["leftover"], row["pulled"]
            out.append(features(*found, self.nominal))
        return out


def learn_decision(examples: Sequence[Example]) -> dict[str, dict[str, float]]:
    """Weights with selecting recordings that show an effect, and without (`alone`); with their alarms."""
    several = {"selected": examples, "alone": [each.alone for each in examples]}
    decision = {name: learn_weights(some) for name, some in several.items()}
    return {
        name: {**decision[name], "alarm": learn_alarm(some, decision), **learn_together(some)}
        for name, some in several.items()
    }


def learn_weights(examples: Sequence[Example]) -> dict[str, float]:
    """Weights of the features, by the mean log loss of the truth; each kind of case counts with its share."""
    names = [*EFFECT, *ALL, UNKNOWN]
    kinds = Counter(str(each.answer["kind"]) for each in examples)
    shares = np.array([SHARES[each.answer["kind"]] / kinds[each.answer["kind"]] for each in examples])
    shares /= shares.sum()
    each = [_linear(example, names) for example in examples]
    most = max(len(X) for X, _ in each)
    X, there, true = np.zeros((len(each), most, len(names))), *np.zeros((2, len(each), most), dtype=bool)
    for i, (rows, right) in enumerate(each):
        X[i, : len(rows)], there[i, : len(rows)], true[i, : len(rows)] = rows, True, right
    ridge = np.array([name not in ("one", UNKNOWN) for name in names]) * RIDGE

    def loss(values: Array) -> tuple[float, Array]:
        p = softmax(np.where(there, X @ values, -np.inf), axis=1)
        of_truth = np.maximum((p * true).sum(axis=1), 1e-6)
        slope = np.einsum("nk,nkw->nw", p * true / of_truth[:, None] - p, X)
        value = -float(shares @ np.log(of_truth)) + float(ridge @ values**2)
        return value, -shares @ slope + 2.0 * ridge * values

    start = np.array([{"one": -4.0, UNKNOWN: -3.0}.get(name, 1.0) for name in names])
    bounds = [(None, None) if name in ("one", UNKNOWN) else (0.0, None) for name in names]
    found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B")
    return dict(zip(names, map(float, found.x), strict=True))


def _linear(example: Example, names: Sequence[str]) -> tuple[Array, Booleans]:
    """What the weights `names` (w,) of each explanation's score are multiplied by (k, w), and which are right (k,)."""
    said = ["none", UNKNOWN, *_classes(example)]
    X = np.zeros((len(said), len(names)))
    for j, name in enumerate(names):
        unit = {**dict.fromkeys(EFFECT, 0.0), name: 1.0}
        X[0, j] = score(example.features[0], unit, False)
        for k, each in enumerate(example.features[1:], 2):
            X[k, j] = score(each, unit, True)
    X[1, names.index(UNKNOWN)] = 1.0
    truth = example.truth if example.truth & set(said) else {"none", UNKNOWN}
    return X, np.array([name in truth for name in said])


def _classes(example: Example) -> list[str]:
    """Of the rivals."""
    return [class_of(row["name"], row["where"]) for row in example.rows[1:]]


def _which(row: Mapping[str, Any]) -> str:
    """Of the weights: with selecting recordings that show the effect, or without."""
    return "selected" if row["confirmed"] is not None and np.isfinite(row["confirmed"]) else "alone"


def outcome(example: Example, decision: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Probability of `none`, `unknown` and of each class of effects, as `odds` of the diagnosis has them."""
    names = ["none", UNKNOWN, *_classes(example)]
    weights = [decision[_which(row)] for row in example.rows]
    scores = [score(example.features[0], weights[0], False), weights[0][UNKNOWN]]
    scores += [score(each, mine, True) for each, mine in zip(example.features[1:], weights[1:], strict=True)]
    out: dict[str, float] = {}
    for name, value in zip(names, probabilities(scores), strict=True):
        out[name] = out.get(name, 0.0) + value
    return out


def learn_alarm(examples: Sequence[Example], decision: Mapping[str, Mapping[str, float]]) -> float:
    """Probability of `none` up to which FALSE_ALARMS of the clean cases get, by these weights."""
    clean = [example for example in examples if example.answer["kind"] == "clean"]
    none = [outcome(example, decision)["none"] for example in clean]
    return float(np.quantile(none, FALSE_ALARMS)) if none else NO_ALARM


def learn_together(examples: Sequence[Example]) -> dict[str, float]:
    """How far all that varies is pulled together (`pulled_together`) on all clean cases but PULLED of them."""
    clean = [example.rows[0]["together"] for example in examples if example.answer["kind"] == "clean"]
    return {"together": float(np.quantile(clean, 1.0 - PULLED))} if clean else {}


def left_out(examples: Sequence[Example]) -> Iterable[tuple[str, str, Example, dict[str, float], str]]:
    """Of each example, the axis and kind of its world that is left out, what weights of the others say, and name."""
    for axis in AXES:
        for kind in sorted({example.answer["worlds"][axis] for example in examples}):
            inside = [example for example in examples if example.answer["worlds"][axis] == kind]
            others = [example for example in examples if example.answer["worlds"][axis] != kind]
            if len(others) < 10:
                continue
            decision = learn_decision(others)
            for example in inside:
                p, nothing = outcome(example, decision), example.rows[0]
                yield axis, kind, example, p, verdict_of(p, decision[_which(nothing)], nothing["together"])


def verdict_of(p: Mapping[str, float], weights: Mapping[str, float], together: float = 0.0) -> str:
    """The class of effects that is named, `none` or `unknown`: as inference/verdict.py, a class for a group.

    Args:
        p: by name, its probability.
        weights: that have `alarm` and `together`.
        together: how far all that varies is pulled.
    """
    improbable = p["none"] <= weights.get("alarm", NO_ALARM)
    if not (improbable or together > weights.get("together", np.inf)):
        return "none"
    best = max(p, key=lambda name: p[name] if name != "none" else 0.0)
    return best if p[best] >= 0.5 * (1.0 - p["none"] if improbable else 1.0) else UNKNOWN


def summary(found: Sequence[tuple[Example, Mapping[str, float], str]]) -> dict[str, Any]:
    """Shares over examples with their probabilities and what is named, and the mean log loss of the truth.

    right: of medium and strong single effects; wrong: of single effects and pairs; false_alarms: of clean robots;
    unknown: of effects outside the catalogue. redrawn: cases whose robot fell at first. lowered: those at a
    lower level than wanted.
    """
    rows: dict[str, list[bool]] = {name: [] for name in SHOWN}
    losses = []
    for example, p, best in found:
        kind, levels = example.answer["kind"], example.answer["levels"]
        if kind == "clean":
            rows["false_alarms"].append(best != "none")
        elif kind == "unknown":
            rows["unknown"].append(best == UNKNOWN)
        else:
            if kind == "single" and levels[0] != "weak":
                rows["right"].append(best in example.truth)
            rows["wrong"].append(best not in {*example.truth, "none", UNKNOWN})
        losses.append(-np.log(max(sum(p.get(t, 0.0) for t in example.truth), 1e-6)))
    shares = {name: rate(sum(values), len(values)) for name, values in rows.items()}
    answers = [example.answer for example, *_ in found]
    again = {
        "redrawn": sum(answer["attempt"] > 0 for answer in answers),
        "lowered": sum(answer["levels"] != answer["wanted"] for answer in answers),
    }
    return {"cases": len(found), **shares, **again, "log_loss": float(np.mean(losses))}


def by_left_out(examples: Sequence[Example]) -> dict[str, dict[str, Any]]:
    """By axis and kind of world, what weights are worth on it that were learnt on all other kinds; "" of all kinds."""
    found = list(left_out(examples))
    out: dict[str, dict[str, Any]] = {}
    for axis in dict.fromkeys(axis for axis, *_ in found):
        of_axis = [(kind, (example, p, named)) for one, kind, example, p, named in found if one == axis]
        for name in ("", *dict.fromkeys(kind for kind, _ in of_axis)):
            rows = [said for kind, said in of_axis if name in ("", kind)]
            out.setdefault(axis, {})[name] = summary(rows)
    return out
