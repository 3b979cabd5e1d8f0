# SPDX-License-Identifier: BSD-3-Clause
"""Whether what a diagnosis says of itself is right: its probabilities, its intervals, and what it could have seen.

Probabilities count by class, as verdicts do: those of all places and members of a class together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ..core.base.types import Array
from .families import class_of
from .folder import names_effects
from .hidden import NOMINAL, compared, in_all

BINS = 10
FALSE_ALARMS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # of clean robots, at which the others are counted
POWER = 0.9
OF_EACH_JOINT = ("cubic",)  # parameters that mean as much at one joint as another value does at the next one
Case = Mapping[str, Any]


def calibration(cases: Sequence[Case]) -> dict[str, Any]:
    """Figures of a run that need no verdict, only what stands beside it.

    Args:
        cases: `answer` and `verdict` of each; those without probabilities are left out.

    Returns:
        cases: how many. truth: mean probability of the true class, medium and strong single effects; group: the same
        with all that the recordings cannot distinguish from it. reliability: rows of the most likely statement by its
        probability: mean probability, share that was right, how many; error: expected calibration error. roc: share of
        robots with a medium or strong effect of the catalogue that are less likely to lack nothing than all but a share
        of the clean ones, by that share; area. outside: verdicts on strong effects outside the catalogue. intervals:
        parameters of right names within their 95 % intervals, of how many. power: see `power`.
    """
    judged = [case for case in cases if (case["verdict"] or {}).get("probabilities")]
    clear = [case for case in judged if _clear(case["answer"]) and case["answer"]["kind"] == "single"]
    known = [case for case in judged if _clear(case["answer"]) and case["answer"]["kind"] in ("single", "pair")]
    clean = [case for case in judged if case["answer"]["kind"] == "clean"]
    outside = [
        case for case in cases if case["answer"]["kind"] == "unknown" and case["answer"]["levels"][0] == "strong"
    ]
    rows, error = reliability([most_likely(case) for case in judged])
    inside = [hit for case in judged for hit in within(case)]
    return {
        "cases": len(judged),
        "truth": _mean([truth_of(case, alike=False) for case in clear]),
        "group": _mean([truth_of(case, alike=True) for case in clear]),
        "reliability": rows,
        "error": error,
        "roc": roc([1.0 - _none(case) for case in clean], [1.0 - _none(case) for case in known]),
        "outside": dict(Counter(_word(case["verdict"]) for case in outside)),
        "intervals": [sum(inside), len(inside)],
        "power": power([size for case in judged if (size := size_of(case)) is not None]),
    }


def stated(verdict: Mapping[str, Any]) -> dict[str, float]:
    """Probabilities of `none`, `unknown` and each class of effects."""
    found: dict[str, float] = {}
    for name, p in verdict["probabilities"].items():
        which = _class(name)
        found[which] = found.get(which, 0.0) + (p or 0.0)
    return found


def truth(answer: Mapping[str, Any]) -> set[str]:
    """What would be right to say."""
    other = {"clean": "none", "unknown": "unknown"}.get(answer["kind"])
    return {other} if other else {class_of(effect["name"], effect["where"]) for effect in answer["effects"]}


def truth_of(case: Case, alike: bool) -> float:
    """Probability of the true class; `alike`: and of what its recordings cannot distinguish from it."""
    verdict, true = case["verdict"], truth(case["answer"])
    right = set(true)
    if alike:
        for group in verdict.get("groups") or []:
            classes = {_class(name) for name in group}
            right |= classes if classes & true else set()
    return sum(p for name, p in stated(verdict).items() if name in right)


def most_likely(case: Case) -> tuple[float, bool]:
    """Probability of the most likely statement, and whether it is right."""
    found = stated(case["verdict"])
    best = max(found, key=lambda name: found[name])
    return found[best], best in truth(case["answer"])


def reliability(said: Sequence[tuple[float, bool]]) -> tuple[list[list[float]], float | None]:
    """Rows of mean probability, share that was right and number by tenths of the probability, and the expected error.

    The error is the mean difference of both, weighted by the number.
    """
    rows = []
    for k in range(BINS):
        mine = [(p, right) for p, right in said if min(int(BINS * p), BINS - 1) == k]
        if mine:
            p, right = np.mean(mine, axis=0)
            rows.append([float(p), float(right), len(mine)])
    error = sum(n * abs(p - right) for p, right, n in rows) / len(said) if said else None
    return rows, error


def roc(clean: Sequence[float], others: Sequence[float]) -> dict[str, Any]:
    """How well a number separates robots with an effect from clean ones: shares, and the area under the curve."""
    if not clean or not others:
        return {"false_alarms": [], "found": [], "area": None}
    limits = [float(np.quantile(clean, 1.0 - share)) for share in FALSE_ALARMS]
    a, b = np.array(clean), np.array(others)[:, None]
    return {
        "false_alarms": list(FALSE_ALARMS),
        "found": [float(np.mean(b > limit)) for limit in limits],
        "area": float(np.mean((b > a) + 0.5 * (b == a))),
    }


def within(case: Case) -> list[bool]:
    """Whether the parameters of right names, named or suspected, are within their intervals."""
    hidden = {(effect["name"], effect["where"]): compared(effect) for effect in in_all(case["answer"])}
    found = []
    for effect in [*case["verdict"]["effects"], *(case["verdict"].get("suspected") or [])]:
        real = hidden.get((effect["name"], effect.get("where", "")), {})
        for name, each in effect.get("parameters", {}).items():
            low, high = each.get("interval") or (None, None)
            if isinstance(real.get(name), float) and low is not None and high is not None:
                found.append(bool(low <= real[name] <= high))
    return found


def size_of(case: Case) -> tuple[float, bool] | None:
    """Of a single effect of the catalogue: its size over that which its diagnosis says is seen, and whether it was.

    `undetectable_below` is that of the most sensitive place: parameters whose size depends on the joint are left out.
    """
    answer, verdict = case["answer"], case["verdict"]
    if answer["kind"] != "single":
        return None
    effect = answer["effects"][0]
    seen_from = (verdict.get("undetectable_below") or {}).get(effect["name"], {})
    ratios = [
        abs(value - NOMINAL.get(name, 0.0)) / seen_from[name]
        for name, value in compared(effect).items()
        if isinstance(value, float) and name not in OF_EACH_JOINT and (seen_from.get(name) or 0.0) > 0.0
    ]
    seen = names_effects(verdict) or verdict["verdict"] == "unknown"
    return (max(ratios), seen) if ratios and max(ratios) > 0.0 else None


def power(sizes: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """The size that raises an alarm in 90 of 100 robots, over that which diagnoses say raises one.

    By a logistic curve over the logarithm of the size; none where it does not rise, where fewer than ten sizes are
    known, or where the largest of them is too small for that.
    """
    if len(sizes) < 10 or len({seen for _, seen in sizes}) < 2:
        return {"of": len(sizes), "factor": None}
    x = np.log([size for size, _ in sizes])
    seen: Array = np.array([hit for _, hit in sizes], dtype=float)

    def loss(ab: Array) -> float:
        z = ab[0] + ab[1] * x
        return float(np.sum(np.logaddexp(0.0, z) - seen * z) + 0.5 * 0.01 * ab[1] ** 2)

    a, b = minimize(loss, np.array([0.0, 1.0])).x
    wanted = (np.log(POWER / (1.0 - POWER)) - a) / b if b > 0.0 else np.inf
    return {"of": len(sizes), "factor": float(np.exp(wanted)) if wanted <= x.max() else None}


def _class(name: str) -> str:
    """Of an effect NAME@PLACE; `none` and `unknown` are their own."""
    effect, _, where = name.partition("@")
    return class_of(effect, where)


def _clear(answer: Mapping[str, Any]) -> bool:
    """Medium or strong; of a pair both."""
    return all(level != "weak" for level in answer["levels"])


def _word(verdict: Mapping[str, Any] | None) -> str:
    """The verdict, `effect` wherever it names one; `failed`: there is none."""
    if verdict is None:
        return "failed"
    return "effect" if names_effects(verdict) else str(verdict["verdict"])


def _none(case: Case) -> float:
    return float(case["verdict"]["probabilities"].get("none", 0.0))


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
