# SPDX-License-Identifier: BSD-3-Clause
"""`coman judge`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import JsonOption, print_json, print_table, progress

_ROWS = (
    ("right_on_medium_and_strong", "right name or class, medium and strong", ">= 90 %"),
    ("wrong_name", "wrong name, singles and pairs", "<= 3 %"),
    ("false_alarms_on_clean", "false alarms on clean robots", "<= 2 %"),
    ("unknown_recall_on_strong", "unknown, strong and outside the catalogue", ">= 80 %"),
    ("named_outside_catalogue", "named although outside the catalogue", ""),
    ("both_of_a_pair", "both of a pair", ">= 70 %"),
    ("one_of_a_pair", "one of a pair, nothing wrong", ""),
    ("failed", "no verdict", ""),
)


def judge(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the run; an interrupted run continues there.")
    ],
    seeds: Annotated[
        str,
        typer.Option(
            "--seeds",
            metavar="FIRST:END",
            help="Cases, END not included. Default: those of the run in DIR, else the next 200 fresh ones: seeds on "
            "which nothing was chosen or reported yet.",
            show_default=False,
        ),
    ] = "",
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Processes at a time.")] = 1,
    only: Annotated[
        str, typer.Option("--only", metavar="KINDS", help="Some of clean,single,pair,unknown; default: all.")
    ] = "",
    workflow: Annotated[
        str,
        typer.Option("--workflow", metavar="COMMAND", help="Judge another command with the options of coman diagnose."),
    ] = "",
    no_baselines: Annotated[bool, typer.Option("--no-baselines", help="Leave out the simpler methods.")] = False,
    no_oracle: Annotated[
        bool, typer.Option("--no-oracle", help="Leave out the diagnoses that are given the name of the effect.")
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Another round of verdicts on the bags in DIR; the score counts the rounds.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Judge `coman diagnose` on robots with hidden effects, whose answers it cannot see.

    Seeds on which something was chosen or reported are spent; they are listed in judge/seeds.yaml, and the result says
    which of its seeds are. A run on fresh seeds prints the line to add to that file: they are spent from then on.
    """
    from ..judge.run import BASELINES, DIAGNOSE, choose_seeds, run
    from ..judge.score import score_run
    from ..judge.seeds import describe

    kinds = _kinds(only)
    chosen = choose_seeds(seeds, out)
    print(f"seeds {min(chosen)} to {max(chosen)}: {describe('judge', chosen)}", file=sys.stderr)
    with progress("judging") as report:
        names = run(
            out,
            chosen,
            kinds,
            jobs,
            shlex.split(workflow) or DIAGNOSE,
            () if no_baselines else BASELINES,
            not no_oracle,
            again,
            report,
        )
        result = score_run(out, names)
    if json:
        print_json(result)
    else:
        _show(result, out)


def _kinds(only: str) -> list[str]:
    """The kinds of cases that --only names.

    Raises:
        ConfigError: there is no such kind.
    """
    from ..errors import ConfigError
    from ..judge.cases import KINDS

    kinds = [kind.strip() for kind in only.split(",") if kind.strip()]
    for kind in kinds:
        if kind not in KINDS:
            raise ConfigError(f"--only: {kind!r} is not allowed (allowed: {', '.join(KINDS)})")
    return kinds


def _show(result: dict[str, Any], out: Path) -> None:
    _show_shares(result)
    _show_cases(result["confusion"], result["rows"])
    levels = ", ".join(f"{level} {_share(value)}" for level, value in result["by_level"].items())
    print(f"right by level: {levels}; right place: {_share(result['right_place'])}")
    gap, time, redrawn = result["gap_reduction"], result["seconds"], result["redrawn"]
    print(
        f"held-out gap reduction, share of the oracle's: median {_number(gap['median_share_of_oracle'])} (target 0.8)"
    )
    print(f"one diagnosis: median {_number(time['median'])} s, longest {_number(time['largest'])} s (target 60 s)")
    if redrawn["cases"]:
        print(
            f"{redrawn['cases']} cases were drawn again because the robot fell, {redrawn['lowered']} at a lower level"
        )
    if result["round"] > 1:
        print(f"round {result['round']}: the answers to these bags were opened before")
    print(
        f"verdicts sealed as {result['verdicts_sha256'][:16]} before the answers were opened; all in {out}/score.json"
    )
    _show_how_to_record(result["seeds"])


def _show_shares(result: dict[str, Any]) -> None:
    """Seeds, and the shares of workflow and baselines beside their targets."""
    methods = {"workflow": result["workflow"], **result["baselines"]}
    count = ", ".join(f"{number} {kind}" for kind, number in result["cases"].items())
    seeds, of = result["seeds"], len(result["rows"])
    state = f"{of - seeds['fresh']} of {of} spent" if seeds["spent"] else "fresh"
    print_table(
        f"seeds {seeds['first']} to {seeds['last']} ({state}): {count}",
        ["", "target", *methods],
        [[title, target, *(_share(method[key]) for method in methods.values())] for key, title, target in _ROWS],
    )
    for entry in seeds["spent"]:
        print(f"spent: {entry['seeds']} {entry['purpose']} ({entry['commit']})")


def _show_cases(confusion: dict[str, dict[str, int]], rows: list[dict[str, Any]]) -> None:
    """Confusion table, and the cases with a wrong name, a false alarm or no verdict."""
    counts = [[truth, ", ".join(f"{named} {n}" for named, n in row.items())] for truth, row in confusion.items()]
    print_table("hidden effects and verdicts", ["hidden", "verdicts"], counts)
    bad = [row for row in rows if row["result"] in ("wrong", "failed") or _is_false_alarm(row)]
    listed = [[str(row["seed"]), row["robot"], _truth(row), " + ".join(row["named"])] for row in bad]
    if listed:
        print_table("wrong names, false alarms, no verdict", ["seed", "robot", "hidden", "verdict"], listed)


def _show_how_to_record(seeds: dict[str, Any]) -> None:
    """The line that records seeds as spent, if some were fresh."""
    from ..judge.seeds import FILE, entry_to_add

    if seeds["fresh"]:
        print(f"these seeds are spent now; add to {FILE.name} under judge, with the purpose:")
        print(entry_to_add((seeds["first"], seeds["last"])))


def _is_false_alarm(row: dict[str, Any]) -> bool:
    return row["kind"] == "clean" and row["result"] not in ("none", "not_excited")


def _truth(row: dict[str, Any]) -> str:
    return (
        " + ".join(f"{level} {family}" for family, level in zip(row["families"], row["levels"], strict=True)) or "clean"
    )


def _share(value: dict[str, Any]) -> str:
    if value["share"] is None:
        return "-"
    low, high = value["interval"]
    return f"{100 * value['share']:.0f} % ({value['hits']}/{value['of']}; {100 * low:.0f}-{100 * high:.0f})"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
