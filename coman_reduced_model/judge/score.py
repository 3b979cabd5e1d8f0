# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts against answers.

A verdict is *right* if it names exactly what is hidden, by name or class; *partly* if it names some of it and nothing
else; *wrong* if it names anything that is not there, whatever else it names; else it is *none*, *unknown*,
*not_excited* or *failed* (no readable verdict). Effects that a verdict lists as minor alone are named as any other.
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

from ..core.base.nominal import load_nominal
from ..core.effects.unknown import LINKS, PLAN
from ..output import write_file
from ..resources import version
from .by_kind import by_kind, by_what_was_learnt
from .calibration import calibration
from .families import CLASSES, class_of, of_this_catalogue
from .folder import RunFolder, names_effects, read_verdict, stored
from .hidden import NOMINAL, compared, in_all
from .run import seal
from .seeds import commit, summary
from .sizes import shown

OTHER = ("none", "unknown", "not_excited")
SHOWN = 5.0  # standard deviations that its own recordings leave, from which a hidden effect shows


def outcome(answer: Mapping[str, Any], verdict: Mapping[str, Any] | None) -> dict[str, Any]:
    """Compare one verdict with the answer.

    Args:
        answer: of `cases.answer`.
        verdict: of diagnosis.json; None: there is none.

    Returns:
        result (see above), named (the names, or the verdict), place (for each right name that has a place: whether
        it is right), error (relative error of the parameters of right names).
    """
    kind = (verdict or {}).get("verdict")
    if verdict is None or kind not in ("effect", *OTHER):
        return {"result": "failed", "named": ["failed"], "place": [], "error": {}}
    if not names_effects(verdict):
        return {"result": kind, "named": [kind], "place": [], "error": {}}
    named = [str(effect["name"]) for effect in verdict["effects"]]
    if not named:
        return {"result": "failed", "named": ["failed"], "place": [], "error": {}}
    true = {_class(effect): effect for effect in in_all(answer) if answer["kind"] != "unknown"}
    classes = {_class(effect) for effect in verdict["effects"]}
    result = "wrong" if classes - set(true) else "right" if classes == set(true) else "partly"
    places: list[bool] = []
    errors: dict[str, Any] = {}
    for effect in verdict["effects"]:
        real = true.get(_class(effect))
        if real is None:
            continue
        if real["where"] or effect.get("where"):
            places.append(real["where"] == effect.get("where", ""))
        if real["name"] == effect["name"]:
            errors |= {f"{real['name']}.{p}": e for p, e in _errors(real, effect).items()}
    return {"result": result, "named": named, "place": places, "error": errors}


def in_group(answer: Mapping[str, Any], verdict: Mapping[str, Any] | None) -> str:
    """The result of `outcome`, if a group of two that holds what is hidden counts as it."""
    true = {_class(effect) for effect in answer["effects"]}
    effects = []
    for effect in (verdict or {}).get("effects") or ():
        names = (name.partition("@") for name in effect.get("group") or ())
        places = dict.fromkeys((name, "" if where in (PLAN, LINKS) else where) for name, _, where in names)
        members = [{"name": name, "where": where} for name, where in places]
        effects.append(next((m for m in members if len(members) == 2 and _class(m) in true), effect))
    return str(outcome(answer, verdict and {**verdict, "effects": effects})["result"])


def _class(effect: Mapping[str, Any]) -> str:
    return class_of(str(effect["name"]), effect.get("where"))


def _errors(real: Mapping[str, Any], named: Mapping[str, Any]) -> dict[str, float]:
    """Error of each parameter over its true distance from nominal; without a distance it is left out."""
    found = {}
    for name, value in compared(real).items():
        estimate = named.get("parameters", {}).get(name, {}).get("value")
        distance = abs(value - NOMINAL.get(name, 0.0)) if isinstance(value, float) else 0.0
        if distance > 0.0 and estimate is not None:
            found[name] = abs(estimate - value) / distance
    return found


def gap_reduction(verdict: Mapping[str, Any] | None) -> float:
    """By how much the held-out gap shrank: sum over channels of (before^2 - after^2) / floor^2; nan: not given."""
    try:
        gap = verdict["gap"]["holdout"]  # type: ignore[index]
        before, after, floor = gap["before"], gap["after"], gap["floor"]
        rows = [(before[c], after[c], floor[c]) for c in before if after.get(c) is not None and floor.get(c)]
        return float(sum((b * b - a * a) / (f * f) for b, a, f in rows)) if rows else np.nan
    except (KeyError, TypeError, AttributeError):
        return np.nan


def rank_of_truth(answer: Mapping[str, Any], ranking: Any) -> int | None:
    """At which place (from 1 on) of the oracle's ranking, each class counted once, a class stands that is hidden.

    None: there is no ranking, or the diagnosis does not know the effect.
    """
    if not isinstance(ranking, list):
        return None
    true = {_class(effect) for effect in answer["effects"]}
    classes = list(dict.fromkeys(_class(row) for row in ranking))
    return next((place for place, name in enumerate(classes, 1) if name in true), None)


def first_evidence(ranking: Any) -> float | None:
    """[nats] that the oracle's ranking gives its first candidate; None: there is no ranking."""
    return float(ranking[0]["evidence"]) if isinstance(ranking, list) and ranking else None


def rate(hits: int, of: int) -> dict[str, Any]:
    """A share with its 95 % interval (Wilson); null where nothing was counted."""
    if of == 0:
        return {"hits": 0, "of": 0, "share": None, "interval": None}
    low, high = binomtest(hits, of).proportion_ci(method="wilson")
    return {"hits": hits, "of": of, "share": hits / of, "interval": [float(low), float(high)]}


def score(cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count the outcomes of a run.

    Args:
        cases: for each case: name, answer, verdict (or None), oracle (or None), baselines, run.

    Returns:
        seeds with the entries of seeds.yaml that hold any of them, shares with 95 % intervals, times, rows by case.
    """
    rows = [_row(case) for case in cases]
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    shares = [row["gap_share"] for row in rows if row["gap_share"] is not None and np.isfinite(row["gap_share"])]
    methods = sorted({method for row in rows for method in row["baselines"]})
    return {
        "seeds": summary("worlds", [row["seed"] for row in rows]),
        "cases": dict(Counter(row["kind"] for row in rows)),
        "with_baseline": sum(bool(case.get("with_baseline")) for case in cases),
        "redrawn": {  # because the robot fell: first another robot or place, then one level lower; too large: lower
            "cases": sum(row["attempt"] > 0 for row in rows),
            "lowered": sum(row["lowered"] for row in rows),
        },
        "workflow": _shares(rows, lambda row: row["result"]),
        "or_suspected": _shares(rows, lambda row: row["or_suspected"]),
        "in_group": _shares(rows, lambda row: row["in_group"]),
        "baselines": {m: _shares(rows, partial(_by_baseline, m)) for m in methods},
        "by_level": {
            level: rate(*_count(rows, partial(_of_level, level), "right")) for level in ("weak", "medium", "strong")
        },
        "right_where_shown": rate(*_count(rows, _clearly_shown, "right")),
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
        "calibration": calibration(cases),
        "confusion": confusion(rows),
        "by_kind": by_kind(rows, by_world),
        "learnt": by_what_was_learnt(rows, load_nominal(), by_world),
        "ranking": _rankings(rows),
        "rows": rows,
    }


def _row(case: Mapping[str, Any]) -> dict[str, Any]:
    """Outcome, truth and times of one case."""
    answer, run = case["answer"], case.get("run") or {}
    best = gap_reduction(case.get("oracle"))
    verdict = case["verdict"] or {}
    suspected = verdict.get("suspected")
    # What is suspected is in the gap, not in the model.
    gained = 0.0 if suspected or case["verdict"] is None else gap_reduction(case["verdict"])
    found = outcome(answer, case["verdict"])
    taken = {"verdict": "effect", "effects": suspected} if suspected and verdict["verdict"] == "none" else None
    return {
        **found,
        "or_suspected": outcome(answer, taken)["result"] if taken else found["result"],
        "in_group": in_group(answer, case["verdict"]),
        "case": case["name"],
        **{key: answer[key] for key in ("seed", "kind", "families", "levels", "robot", "attempt", "worlds")},
        "lowered": answer["levels"] != answer["wanted"],
        "truth": [effect["name"] for effect in answer["effects"]],
        "seconds": run.get("seconds"),
        "cpu_seconds": run.get("cpu_seconds"),
        "rank": rank_of_truth(answer, case.get("ranking")),
        "ranked_first": first_evidence(case.get("ranking")),
        "size_shown": shown(answer["effects"][0], case.get("ranking")) if answer["kind"] == "single" else None,
        "gap_share": gained / best if best > 0.0 else None,
        "baselines": {
            method: outcome(answer, verdict)["result"]
            for method, verdict in (case.get("baselines") or {}).items()
            if isinstance(verdict, Mapping)
        },
    }


def by_world(rows: Sequence[Any]) -> dict[str, Any]:
    """The shares that have a target, for the rows of one kind of world, and how many of them were drawn again."""
    return {
        **_shares(rows, lambda row: row["result"]),
        "cases": len(rows),
        "clean": sum(row["kind"] == "clean" for row in rows),
        "redrawn": sum(row["attempt"] > 0 for row in rows),
        "lowered": sum(row["lowered"] for row in rows),
    }


def _rankings(rows: Sequence[Any]) -> dict[str, Any]:
    """How often the oracle that knows the variability ranks the hidden effect first, or among the first three.

    It decides nothing. `named` is what it would name with an alarm: the first, where its evidence is above that of
    clean robots, all but as many of them as the workflow calls faulty. The limit is that of the same clean robots,
    which favours the oracle. Null where clean robots were not ranked.
    """
    ranked = [row for row in rows if row["rank"] is not None and _clear(row)]
    clean = [row for row in rows if row["kind"] == "clean" and row["ranked_first"] is not None]
    healthy = sorted((row["ranked_first"] for row in clean), reverse=True)
    alarms = sum(row["result"] in ("wrong", "unknown") for row in clean)
    limit = healthy[alarms] if alarms < len(healthy) else None
    named = [row["rank"] == 1 and row["ranked_first"] > limit for row in ranked if limit is not None]
    shares = {f"first_{n}": rate(sum(row["rank"] <= n for row in ranked), len(ranked)) for n in (1, 3)}
    return {**shares, "named": rate(sum(named), len(named)), "limit": limit}


def _by_baseline(method: str, row: Any) -> str:
    return str(row["baselines"].get(method, "failed"))


def _of_level(level: str, row: Any) -> bool:
    return bool(row["kind"] == "single" and row["levels"][0] == level)


def _clear(row: Any) -> bool:
    """A medium or strong single effect."""
    return bool(row["kind"] == "single" and row["levels"][0] != "weak")


def _clearly_shown(row: Any) -> bool:
    """One that its own recordings show."""
    return _clear(row) and (row["size_shown"] or 0.0) >= SHOWN


def _count(rows: Sequence[Any], of: Callable[[Any], bool], result: str) -> tuple[int, int]:
    chosen = [row for row in rows if of(row)]
    return sum(row["result"] == result for row in chosen), len(chosen)


def false_alarm(kind: str, result: str) -> bool:
    """A clean robot is said to lack something."""
    return kind == "clean" and result not in ("none", "not_excited", "failed")


def _shares(rows: Sequence[Any], result: Callable[[Any], str]) -> dict[str, Any]:
    """The shares that have a target, for one method; a clean robot without a verdict counts as `failed` alone."""

    def share(of: Callable[[Any], bool], *hits: str) -> dict[str, Any]:
        chosen = [result(row) for row in rows if of(row)]
        return rate(sum(r in hits for r in chosen), len(chosen))

    clean = [result(row) for row in rows if row["kind"] == "clean" and result(row) != "failed"]
    return {
        "right_on_medium_and_strong": share(_clear, "right"),
        "wrong_name": share(lambda row: row["kind"] in ("single", "pair"), "wrong"),
        "false_alarms_on_clean": rate(sum(false_alarm("clean", r) for r in clean), len(clean)),
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
        named = "+".join(sorted(row["named"])) if row["kind"] != "pair" else row["result"]
        if row["kind"] != "pair" and len(row["truth"]) == 1 and row["result"] == "right" and named != truth:
            named = CLASSES.get(truth, truth)  # one effect named at several places counts once
        table.setdefault(truth, Counter())[named] += 1
    return {truth: dict(counts.most_common()) for truth, counts in sorted(table.items())}


def score_run(out: str | Path, names: Sequence[str]) -> dict[str, Any]:
    """Open the answers of a run whose verdicts are sealed, and write OUT/score.json.

    Raises:
        OutputError: a verdict was changed after sealing.
    """
    folder = RunFolder(Path(out).absolute())
    digest = seal(folder, names)
    cases = []
    for name in names:
        cases.append(
            {
                "name": name,
                "answer": of_this_catalogue(stored(folder.answer(name))),
                "verdict": read_verdict(folder.verdict(name) / "diagnosis.json"),
                "run": stored(folder.verdict(name) / "run.json"),
                "with_baseline": (folder.verdict(name) / "baseline.yaml").is_file(),
                "baselines": stored(folder.verdict(name) / "baselines.json"),
                "oracle": read_verdict(folder.oracle(name) / "diagnosis.json"),
                "ranking": stored(folder.ranking(name) / "ranking.json"),
            }
        )
    rounds = len(folder.rounds.read_text(encoding="utf-8").splitlines()) if folder.rounds.is_file() else 0
    known = {"version": version(), "commit": folder.begun or commit(), "took": folder.took("diagnosis")}
    result = {**known, "verdicts_sha256": digest, "round": rounds + 1, **score(cases)}
    write_file(folder.out / "score.json", json.dumps(result, indent=1, default=float))
    return result
