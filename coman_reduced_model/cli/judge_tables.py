# SPDX-License-Identifier: BSD-3-Clause
"""What `coman judge` prints."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .common import print_table

_ROWS = (
    ("right_on_medium_and_strong", "right name or class, medium and strong", ">= 92 %"),
    ("wrong_name", "wrong name, singles and pairs", "<= 2 %"),
    ("false_alarms_on_clean", "false alarms on clean robots", "<= 1 %"),
    ("unknown_recall_on_strong", "unknown, strong and outside the catalogue", ">= 90 %"),
    ("named_outside_catalogue", "named although outside the catalogue", ""),
    ("both_of_a_pair", "both of a pair", ">= 75 %"),
    ("one_of_a_pair", "one of a pair, nothing wrong", ""),
    ("failed", "no verdict", ""),
)
_LEARNT = "learnt on: kinds of worlds that config/nominal.yaml was learnt from"
_REDRAWN = "redrawn: walks of robots that were drawn again because they fell"


def show_diagnosis(result: Mapping[str, Any], out: Path) -> None:
    """Shares, kinds of worlds, confusion, oracles, times, seeds."""
    _show_shares(result)
    _show_kinds(result)
    _show_cases(result["confusion"], result["rows"])
    levels = ", ".join(f"{level} {share(value)}" for level, value in result["by_level"].items())
    print(
        "right, medium and strong, of those that are five deviations of what their own recordings leave open: "
        f"{share(result['right_where_shown'])}"
    )
    print(f"right by level: {levels}; right place: {share(result['right_place'])}")
    gap, time, redrawn = result["gap_reduction"], result["seconds"], result["redrawn"]
    print(
        f"held-out gap reduction, share of the oracle's that is given the effect: median "
        f"{_number(gap['median_share_of_oracle'])} (target 0.8)"
    )
    ranking = result["ranking"]
    print(
        f"oracle that is given the variability, medium and strong: ranks the effect first {share(ranking['first_1'])}, "
        f"among the first three {share(ranking['first_3'])}"
    )
    if (named := ranking.get("named", {})).get("of"):  # earlier versions did not rank clean robots
        print(f"the same, with an alarm and as many false ones as the workflow: {share(named)}")
    if found := result.get("calibration"):  # earlier versions had none
        _show_calibration(found)
    print(f"one diagnosis: median {_number(time['median'])} s, longest {_number(time['largest'])} s (target 60 s)")
    print(_redrawn(redrawn["cases"], redrawn["lowered"]))
    if result["with_baseline"]:
        print(f"{result['with_baseline']} of {sum(result['cases'].values())} diagnoses had a baseline of their robot")
    if result["round"] > 1:
        print(f"round {result['round']}: the answers to these bags were opened before")
    print(
        f"verdicts sealed as {result['verdicts_sha256'][:16]} before the answers were opened; all in {out}/score.json"
    )
    _show_took(result)
    _show_how_to_record(result)


def show_prediction(result: Mapping[str, Any], out: Path, file: str = "prediction") -> None:
    """Errors, and skills against the best causal baseline, by kind, the worst first."""
    kinds = [(axis, kind, found) for axis, by in result["by_kind"].items() for kind, found in by.items()]
    kinds.sort(key=lambda each: _error(each[2]), reverse=True)
    ordered = [("all", "", result["all"]), *_by_learnt(result.get("learnt")), *kinds]
    print_table(
        "clean walks: medians of the free run's RMS error and the rigid robot's; x, y, z",
        ["axis", "kind", "walks", "model [mm]", "rigid [mm]", "walks worse than rigid", "none", "redrawn"],
        [[axis, kind, *_errors(found)] for axis, kind, found in ordered],
        words=2,
    )
    horizons = list(_skills(result["all"]))
    print_table(
        "predictions ahead: median skill against the best causal baseline; x, y, z",
        ["axis", "kind", *(f"{horizon} s" for horizon in horizons)],
        [
            [axis, kind, *(_three(_skills(found)[horizon], lambda v: f"{v:.2f}") for horizon in horizons)]
            for axis, kind, found in ordered
        ],
        words=2,
    )
    ours = f"{_LEARNT}. {_REDRAWN}. " if "learnt" in result else ""
    print(f"{ours}none: nothing could be predicted; all in {out}/{file}.json")
    _show_took(result)
    _show_how_to_record(result)


def show_monitor(result: Mapping[str, Any], out: Path) -> None:
    """Alarms and delays by kind, the worst first."""
    rows = [["all", "", *_alarms(result["alarms"], result["delays"])]]
    clean, late = (_by_learnt(result.get("learnt", {}).get(name)) for name in ("alarms", "delays"))
    rows += [[title, new, *_alarms(found, after[2])] for (title, new, found), after in zip(clean, late, strict=True)]
    kinds = []
    for axis, by in result["alarms_by_kind"].items():
        for kind, found in by.items():
            kinds.append((axis, kind, found, result["delays_by_kind"].get(axis, {}).get(kind)))
    kinds.sort(key=lambda each: -(each[2]["alarms_per_hour"] or 0.0))
    rows += [[axis, kind, *_alarms(found, delays)] for axis, kind, found, delays in kinds]
    print_table(
        "monitor: clean walks; and effects of medium size that begin in mid-walk",
        ["axis", "kind", "hours", "alarms in an hour", "walks with an alarm", "detected within 5 s", "median [s]",
         "redrawn, lowered"],
        rows,
        words=2,
    )  # fmt: skip
    families = [
        [name, share(found["detected"]), _number(found["median_s"])]
        for name, found in result["delays_by_family"].items()
    ]
    print_table("by effect", ["effect", "detected within 5 s", "median [s]"], families)
    channels = ", ".join(f"{name} {n}" for name, n in result["alarms"]["channels"].items())
    print(
        f"{_LEARNT}. {_REDRAWN}; lowered: at a lower level than medium, which would be beyond what a walking robot can "
        "have"
    )
    print(f"channels of the false alarms, each once a walk: {channels or 'none'}; all in {out}/monitor.json")
    failed = [found.get("failed", 0) for found in (result["alarms"], result["delays"])]
    if any(failed):
        print(
            f"not watched, as they cannot be used: clean walks {failed[0]}, walks in which an effect begins {failed[1]}"
        )
    _show_took(result)
    _show_how_to_record(result)


def show_folder(result: Mapping[str, Any], out: Path) -> None:
    """Outcomes by kind, and each case."""
    print_table(
        "cases of others",
        ["axis", "kind", "right", "missed", "wrong", "false alarms", "none"],
        [
            [
                axis,
                kind,
                *(share(found[key]) for key in ("right", "miss", "wrong", "false_alarms")),
                str(found.get("failed", {}).get("hits", "-")),  # earlier versions did not count them
            ]
            for axis, kind, found in _all_and_kinds(result)
        ],
        words=2,
    )
    print_table(
        "by case",
        ["case", "hidden", "verdict", ""],
        [[row["case"], row["hidden"] or "clean", " + ".join(row["named"]), row["result"]] for row in result["rows"]],
        words=4,
    )
    print(f"none: no verdict; all in {out}/score.json")


def show_walks(result: Mapping[str, Any], out: Path) -> None:
    """Both of what `judge.foreign.watch_folder` says."""
    show_prediction(result["prediction"], out, "walks")
    show_watched(result["monitor"], out)


def show_watched(result: Mapping[str, Any], out: Path) -> None:
    """What the monitor says of recordings of others, by kind."""
    print_table(
        "monitor on recordings of others: walks with an alarm",
        ["axis", "kind", "clean [h]", "alarms in an hour", "clean robots", "effect from the beginning", "none"],
        [
            [axis, kind, f"{found['clean']['hours']:.2f}", _per_hour(found["clean"]),
             *(share(found[which]["walks_with_alarm"]) for which in ("clean", "faulty")), str(found["failed"])]
            for axis, kind, found in _all_and_kinds(result)
        ],
        words=2,
    )  # fmt: skip
    for which in ("clean", "faulty"):
        channels = ", ".join(f"{name} {n}" for name, n in result["all"][which]["channels"].items())
        print(f"channels on {which} robots, each once a walk: {channels or 'none'}")
    print(f"none: nothing could be predicted. A robot's walks count one by one; all in {out}/walks.json")


def _all_and_kinds(result: Mapping[str, Any]) -> list[tuple[str, str, Any]]:
    """Rows of cases of others: axis, kind, measure; of all of them first."""
    kinds = [(axis, kind, found) for axis, by in result["by_kind"].items() for kind, found in by.items()]
    return [("all", "", result["all"]), *kinds]


def show_left_out(result: Mapping[str, Any], path: Path) -> None:
    """What weights are worth on kinds of worlds that were left out when they were learnt; most false alarms first."""
    shares = ("right", "wrong", "false_alarms", "unknown")
    for name, title in (("population", "without a baseline"), ("with_baseline", "with a baseline")):
        if not result[name]:
            continue
        kinds = [(axis, kind, found) for axis, by in result[name].items() for kind, found in by.items()]
        kinds.sort(
            key=lambda each: [each[1] != "", *(-(each[2][k]["share"] or 0.0) for k in ("false_alarms", "wrong"))]
        )
        print_table(
            f"{title}: each kind by weights that were learnt on all others",
            ["axis", "kind", "cases", "right", "wrong", "false alarms", "outside: unknown", "redrawn, lowered"],
            [
                [axis, kind or "all, each left out", str(found["cases"]), *(share(found[key]) for key in shares),
                 ", ".join(str(found.get(key, "-")) for key in ("redrawn", "lowered"))]
                for axis, kind, found in kinds
            ],
            words=2,
        )  # fmt: skip
    source = result["source"]
    if held := result.get("intervals"):  # earlier versions did not count them
        print(f"95 % intervals of hidden effects hold the true value, each learnt without its case: {share(held)}")
    print("redrawn: cases that were drawn again because the robot fell; lowered: at a lower level than wanted")
    print(f"learnt at commit {source['commit']} from {source['cases']} cases; all in {path}")


def _show_shares(result: Mapping[str, Any]) -> None:
    """Seeds, and the shares of workflow and baselines beside their targets."""
    methods = {"workflow": result["workflow"]}
    if "or_suspected" in result:  # earlier versions did not count them
        methods["or suspected"] = result["or_suspected"]
    methods |= result["baselines"]
    count = ", ".join(f"{number} {kind}" for kind, number in result["cases"].items())
    seeds, of = result["seeds"], len(result["rows"])
    state = f"{of - seeds['fresh']} of {of} spent" if seeds["spent"] else "fresh"
    print_table(
        f"seeds {seeds['first']} to {seeds['last']} ({state}): {count}",
        ["", "target", *methods],
        [[title, target, *(share(method[key]) for method in methods.values())] for key, title, target in _ROWS],
    )
    if "or_suspected" in result:
        print("or suspected: if what is suspected without an alarm counted as named")
    if "in_group" in result:
        right, wrong = (share(result["in_group"][key]) for key in ("right_on_medium_and_strong", "wrong_name"))
        print(f"if a group of two that holds what is hidden counted as it: right {right}, wrong {wrong}")
    for entry in seeds["spent"]:
        print(f"spent: {entry['seeds']} {entry['purpose']} ({entry['commit']})")


def _show_kinds(result: Mapping[str, Any]) -> None:
    """Shares by kind of world, those with most false alarms first."""
    from ..core.base.nominal import load_nominal
    from ..judge.by_kind import by_what_was_learnt
    from ..judge.score import by_world

    learnt = result.get("learnt") or by_what_was_learnt(result["rows"], load_nominal(), by_world)  # earlier: without
    rows = [[title, new, *_kind(found)] for title, new, found in _by_learnt(learnt)]
    kinds = [(axis, kind, found) for axis, by in result["by_kind"].items() for kind, found in by.items()]
    kinds.sort(key=lambda each: -(each[2]["false_alarms_on_clean"]["share"] or 0.0))
    rows += [[axis, kind, *_kind(found)] for axis, kind, found in kinds]
    print_table(
        f"by kind of world; {_LEARNT}",
        ["axis", "kind", "cases", "false alarms", "right", "wrong", "outside: unknown", "redrawn, lowered"],
        rows,
        words=2,
    )


def _by_learnt(learnt: Mapping[str, Any] | None) -> list[tuple[str, str, Any]]:
    """Rows of what is never, and of what is always, learnt on: title, kinds, measure; earlier versions had none."""
    if learnt is None:
        return []
    new = ", ".join(learnt["new_kinds"]) or "none"
    return [("never learnt on", new, learnt["some_new_kind"]), ("all learnt on", "", learnt["only_learnt_kinds"])]


def _kind(found: Mapping[str, Any]) -> list[str]:
    keys = ("false_alarms_on_clean", "right_on_medium_and_strong", "wrong_name", "unknown_recall_on_strong")
    return [str(found["cases"]), *(share(found[key]) for key in keys), f"{found['redrawn']}, {found['lowered']}"]


def _show_cases(confusion: Mapping[str, Mapping[str, int]], rows: Sequence[Mapping[str, Any]]) -> None:
    """Confusion table, and the cases with a wrong name, a false alarm or no verdict."""
    from ..judge.score import false_alarm

    counts = [[truth, ", ".join(f"{named} {n}" for named, n in row.items())] for truth, row in confusion.items()]
    print_table("hidden effects and verdicts", ["hidden", "verdicts"], counts, words=2)
    bad = [row for row in rows if row["result"] in ("wrong", "failed") or false_alarm(row["kind"], row["result"])]
    listed = [[str(row["seed"]), row["robot"], _truth(row), " + ".join(row["named"])] for row in bad]
    if listed:
        print_table("wrong names, false alarms, no verdict", ["seed", "robot", "hidden", "verdict"], listed, words=4)


def _show_calibration(found: Mapping[str, Any]) -> None:
    """How right the probabilities are, how well they separate clean robots from others, and what was promised."""
    print_table(
        f"the most likely statement of {found['cases']} diagnoses, by its probability",
        ["probability", "right", "diagnoses"],
        [[f"{100 * p:.0f} %", f"{100 * right:.0f} %", f"{n:.0f}"] for p, right, n in found["reliability"]],
    )
    curve = found["roc"]
    print_table(
        "alarms by the probability that nothing is missing, wherever its limit is",
        ["of clean robots", "of medium and strong effects"],
        [[f"{100 * a:.0f} %", f"{100 * b:.0f} %"] for a, b in zip(curve["false_alarms"], curve["found"], strict=True)],
    )
    (inside, of), power = found["intervals"], found["power"]
    outside = ", ".join(f"{verdict} {n}" for verdict, n in found["outside"].items())
    for line in (
        f"mean probability of the truth, medium and strong: {_number(found['truth'])}, with all that cannot be "
        f"distinguished from it {_number(found['group'])} (target 0.85)",
        f"expected calibration error {_number(found['error'])} (target 0.05); area under the curve of alarms "
        f"{_number(curve['area'])}",
        f"95 % intervals of named and suspected effects hold {inside} of {of} true values",
        f"verdicts on strong effects outside the catalogue: {outside or '-'} (target: unknown 90 %, none 0)",
        f"the size that raises an alarm in 9 of 10 robots is {_number(power['factor'])} times the one that diagnoses "
        f"give, by {power['of']} single effects (target: 1.5 at most)",
    ):
        print(line)


def _show_took(result: Mapping[str, Any]) -> None:
    """How long all of it took, recordings that were not there included; nothing, where that is not known."""
    if took := result.get("took"):
        print(f"took {took['seconds'] / 60.0:.0f} minutes, {took['jobs']} processes at a time, with what it recorded")


def _show_how_to_record(result: Mapping[str, Any]) -> None:
    """The line that records seeds as spent, if some were fresh; nothing, where they are not known."""
    from ..judge.seeds import FILE, entry_to_add

    if (seeds := result.get("seeds")) and seeds["fresh"]:
        print(f"these seeds are spent now; add to {FILE.name} under worlds, with the purpose:")
        print(entry_to_add((seeds["first"], seeds["last"]), result["commit"]))


def _error(found: Mapping[str, Any]) -> float:
    """Length of the median errors of the three axes; infinite: nothing could be predicted."""
    return math.hypot(*(math.inf if value is None else value for value in found["rmse_m"]))


def _skills(found: Mapping[str, Any]) -> Mapping[str, Sequence[float | None]]:
    """By horizon; earlier versions wrote that of 0.2 s alone."""
    return found["skill"] if isinstance(found["skill"], Mapping) else {"0.2": found["skill"]}


def _errors(found: Mapping[str, Any]) -> list[str]:
    return [
        str(found["walks"]),
        _three(found["rmse_m"], lambda v: f"{1e3 * v:.2f}"),
        _three(found["rigid_m"], lambda v: f"{1e3 * v:.2f}"),
        _three(found["worse_than_rigid"], lambda v: f"{100 * v:.0f} %"),
        str(found["failed"]),
        str(found["redrawn"]),
    ]


def _three(values: Sequence[float | None], text: Callable[[float], str]) -> str:
    return ", ".join("-" if value is None else text(value) for value in values)


def _alarms(found: Mapping[str, Any], delays: Mapping[str, Any] | None) -> list[str]:
    redrawn, lowered = found.get("redrawn"), None  # earlier versions did not count them
    detected = ["-", "-"]
    if delays is not None:
        detected = [share(delays["detected"]), _number(delays["median_s"])]
        redrawn, lowered = None if redrawn is None else redrawn + delays["redrawn"], delays.get("lowered")
    again = ", ".join("-" if value is None else str(value) for value in (redrawn, lowered))
    walks = share(found["walks_with_alarm"])
    return [f"{found['hours']:.2f}", _per_hour(found), walks, *detected, again]


def _per_hour(found: Mapping[str, Any]) -> str:
    """Alarms in an hour with the 95 % interval, which earlier versions did not have."""
    interval = found.get("interval_per_hour")
    return _number(found["alarms_per_hour"]) + (f" ({interval[0]:.1f}-{interval[1]:.1f})" if interval else "")


def _redrawn(cases: int, lowered: int) -> str:
    return f"cases drawn again because the robot fell: {cases}; at a lower level than wanted: {lowered}"


def _truth(row: Mapping[str, Any]) -> str:
    pairs = zip(row["families"], row["levels"], strict=True)
    return " + ".join(f"{level} {family}" for family, level in pairs) or "clean"


def share(value: Mapping[str, Any]) -> str:
    """A share with its 95 % interval."""
    if value["share"] is None:
        return "-"
    low, high = value["interval"]
    return f"{100 * value['share']:.0f} % ({value['hits']}/{value['of']}; {100 * low:.0f}-{100 * high:.0f})"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
