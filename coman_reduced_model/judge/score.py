# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts against answers.

A verdict is *right* if it names exactly what is hidden, by name or class; *partly* if it names some of it and nothing
else; *wrong* if it names anything that is not there, whatever else it names; else it is *none*, *unknown*,
*not_excited* or *failed* (no readable verdict).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from .. import __version__
from .cases import ATTEMPTS
from .families import CLASSES, class_of
from .run import TUNING_SEEDS, Layout, seal

OTHER = ("none", "unknown", "not_excited")
NOMINAL = {"scale": 1.0}  # of every other parameter: 0


def outcome(answer: Mapping[str, Any], verdict: Mapping[str, Any] | None) -> dict[str, Any]:
    """What one verdict is worth.

    Args:
        answer: of `cases.answer`.
        verdict: of diagnosis.json; None: there is none.

    Returns:
        result (see above), named (what was named, or the verdict), place (right names that sit at the right place, of
        those that have one), error (relative error of the parameters of right names).
    """
    kind = (verdict or {}).get("verdict")
    if verdict is None or kind not in ("effect", *OTHER):
        return {"result": "failed", "named": ["failed"], "place": [], "error": {}}
    if kind in OTHER:
        return {"result": kind, "named": [kind], "place": [], "error": {}}
    named = [str(effect["name"]) for effect in verdict["effects"]]
    if not named:
        return {"result": "failed", "named": ["failed"], "place": [], "error": {}}
    true = {class_of(effect["name"]): effect for effect in answer["effects"] if answer["kind"] != "unknown"}
    classes = {class_of(name) for name in named}
    result = "wrong" if classes - set(true) else "right" if classes == set(true) else "partly"
    places: list[bool] = []
    errors: dict[str, Any] = {}
    for told in verdict["effects"]:
        real = true.get(class_of(told["name"]))
        if real is None:
            continue
        if real["where"] or told.get("where"):
            places.append(real["where"] == told.get("where", ""))
        if real["name"] == told["name"]:
            errors |= {f"{real['name']}.{p}": e for p, e in _errors(real, told).items()}
    return {"result": result, "named": named, "place": places, "error": errors}


def _errors(real: Mapping[str, Any], told: Mapping[str, Any]) -> dict[str, float]:
    """Error of each parameter over its true distance from nominal, where there is a distance."""
    found = {}
    for name, value in real["parameters"].items():
        estimate = told.get("parameters", {}).get(name, {}).get("value")
        distance = abs(value - NOMINAL.get(name, 0.0)) if isinstance(value, float) else 0.0
        if distance > 0.0 and estimate is not None:
            found[name] = abs(estimate - value) / distance
    return found


def gap_reduction(verdict: Mapping[str, Any] | None) -> float:
    """By how much the held-out gap shrank: sum over channels of (before^2 - after^2) / floor^2; nan: not told."""
    try:
        gap = verdict["gap"]["holdout"]  # type: ignore[index]
        before, after, floor = gap["before"], gap["after"], gap["floor"]
        rows = [(before[c], after[c], floor[c]) for c in before if after.get(c) is not None and floor.get(c)]
        return float(sum((b * b - a * a) / (f * f) for b, a, f in rows)) if rows else np.nan
    except (KeyError, TypeError, AttributeError):
        return np.nan


def rate(hits: int, of: int) -> dict[str, Any]:
    """A share with its 95 % interval (Wilson); null where nothing was counted."""
    if of == 0:
        return {"hits": 0, "of": 0, "share": None, "interval": None}
    low, high = binomtest(hits, of).proportion_ci(method="wilson")
    return {"hits": hits, "of": of, "share": hits / of, "interval": [float(low), float(high)]}


def score(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The figures of a run.

    Args:
        cases: one a case: name, answer, verdict (or None), oracle (or None), baselines, run.
    """
    rows = []
    for case in cases:
        found = outcome(case["answer"], case["verdict"])
        found |= {
            "case": case["name"],
            **{k: case["answer"][k] for k in ("seed", "kind", "families", "levels", "robot", "attempt")},
        }
        found["truth"] = [effect["name"] for effect in case["answer"]["effects"]]
        found["seconds"] = (case.get("run") or {}).get("seconds")
        found["cpu_seconds"] = (case.get("run") or {}).get("cpu_seconds")
        best = gap_reduction(case.get("oracle"))
        found["gap_share"] = gap_reduction(case["verdict"]) / best if best > 0.0 else None
        found["baselines"] = {
            method: outcome(case["answer"], verdict)["result"]
            for method, verdict in (case.get("baselines") or {}).items()
            if isinstance(verdict, Mapping)
        }
        rows.append(found)
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    shares = [row["gap_share"] for row in rows if row["gap_share"] is not None and np.isfinite(row["gap_share"])]
    methods = sorted({method for row in rows for method in row["baselines"]})
    return {
        "seeds": {
            "first": min(r["seed"] for r in rows),
            "last": max(r["seed"] for r in rows),
            "purpose": _purpose(rows),
        },
        "cases": dict(Counter(row["kind"] for row in rows)),
        "redrawn": {  # because the robot fell: on another robot or at another place, and, after that, one level lower
            "cases": sum(row["attempt"] > 0 for row in rows),
            "lowered": sum(row["attempt"] >= ATTEMPTS for row in rows),
        },
        "workflow": _figures(rows, lambda row: row["result"]),
        "baselines": {m: _figures(rows, partial(_by_baseline, m)) for m in methods},
        "by_level": {
            level: rate(*_count(rows, partial(_of_level, level), "right")) for level in ("weak", "medium", "strong")
        },
        "right_place": rate(sum(sum(row["place"]) for row in rows), sum(len(row["place"]) for row in rows)),
        "parameter_error": _medians(rows),
        "gap_reduction": {
            "median_share_of_oracle": float(np.median(shares)) if shares else None,
            "at_least_0.8": rate(sum(share >= 0.8 for share in shares), len(shares)),
        },
        "seconds": {
            "median": float(np.median(seconds)) if seconds else None,
            "largest": max(seconds, default=None),
        },
        "confusion": confusion(rows),
        "rows": rows,
    }


def _purpose(rows: Sequence[Mapping[str, Any]]) -> str:
    return "choosing thresholds" if all(row["seed"] in TUNING_SEEDS for row in rows) else "reporting"


def _by_baseline(method: str, row: Any) -> str:
    return str(row["baselines"].get(method, "failed"))


def _of_level(level: str, row: Any) -> bool:
    return bool(row["kind"] == "single" and row["levels"][0] == level)


def _count(rows: Sequence[Any], of: Callable[[Any], bool], result: str) -> tuple[int, int]:
    chosen = [row for row in rows if of(row)]
    return sum(row["result"] == result for row in chosen), len(chosen)


def _figures(rows: Sequence[Any], result: Callable[[Any], str]) -> dict[str, Any]:
    """The targets of the issue, for one method."""

    def share(of: Callable[[Any], bool], *hits: str) -> dict[str, Any]:
        chosen = [result(row) for row in rows if of(row)]
        return rate(sum(r in hits for r in chosen), len(chosen))

    def clear(row: Any) -> bool:
        return row["kind"] == "single" and row["levels"][0] != "weak"

    return {
        "right_on_medium_and_strong": share(clear, "right"),
        "wrong_name": share(lambda row: row["kind"] in ("single", "pair"), "wrong"),
        "false_alarms_on_clean": share(lambda row: row["kind"] == "clean", "wrong", "unknown", "partly", "right"),
        "unknown_recall_on_strong": share(lambda r: r["kind"] == "unknown" and r["levels"][0] == "strong", "unknown"),
        "named_outside_catalogue": share(lambda row: row["kind"] == "unknown", "wrong"),
        "both_of_a_pair": share(lambda row: row["kind"] == "pair", "right"),
        "one_of_a_pair": share(lambda row: row["kind"] == "pair", "partly"),
        "failed": share(lambda row: True, "failed"),
    }


def _medians(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    errors: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row["error"].items():
            errors.setdefault(name, []).append(value)
    return {name: float(np.median(values)) for name, values in sorted(errors.items())}


def confusion(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    """How often each truth (effects joined by +, or clean) got each verdict."""
    table: dict[str, Counter[str]] = {}
    for row in rows:
        truth = "pair" if row["kind"] == "pair" else "+".join(row["truth"]) or "clean"
        said = "+".join(sorted(row["named"])) if row["kind"] != "pair" else row["result"]
        if row["kind"] != "pair" and len(row["truth"]) == 1 and row["result"] == "right" and said != truth:
            said = CLASSES.get(truth, truth)  # or more than one instance of it
        table.setdefault(truth, Counter())[said] += 1
    return {truth: dict(counts.most_common()) for truth, counts in sorted(table.items())}


def score_run(out: str | Path, names: Sequence[str]) -> dict[str, Any]:
    """Opens the answers of a run whose verdicts are sealed, and writes OUT/score.json.

    Raises:
        OutputError: a verdict was changed after sealing.
    """
    layout = Layout(Path(out).absolute())
    digest = seal(layout, names)
    cases = []
    for name in names:
        cases.append(
            {
                "name": name,
                "answer": _json(layout.answer(name)),
                "verdict": _json(layout.verdict(name) / "diagnosis.json"),
                "run": _json(layout.verdict(name) / "run.json"),
                "baselines": _json(layout.verdict(name) / "baselines.json"),
                "oracle": _json(layout.oracle(name) / "diagnosis.json"),
            }
        )
    rounds = len(layout.rounds.read_text(encoding="utf-8").splitlines()) if layout.rounds.is_file() else 0
    result = {"version": __version__, "verdicts_sha256": digest, "round": rounds + 1, **score(cases)}
    (layout.out / "score.json").write_text(json.dumps(result, indent=1, default=float), encoding="utf-8")
    return result


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
