# SPDX-License-Identifier: BSD-3-Clause
"""`coman judge`."""

from __future__ import annotations

import shlex
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
        Path, typer.Option("--out", metavar="DIR", help="Folder of the run; an unfinished run is gone on with.")
    ],
    seeds: Annotated[
        str,
        typer.Option(
            "--seeds", metavar="FIRST:END", help="Cases; below 1000 for choosing thresholds, from 1000 on to report."
        ),
    ] = "1000:1200",
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
        bool, typer.Option("--no-oracle", help="Leave out the diagnoses that are told the effect.")
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Judge anew on the bags of an earlier run; the score counts the rounds.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Judge `coman diagnose` on robots with hidden effects, whose answers it cannot see."""
    from ..errors import ConfigError
    from ..judge.cases import KINDS
    from ..judge.run import BASELINES, DIAGNOSE, parse_seeds, run
    from ..judge.score import score_run

    kinds = [kind.strip() for kind in only.split(",") if kind.strip()]
    for kind in kinds:
        if kind not in KINDS:
            raise ConfigError(f"--only: {kind!r} is not allowed (allowed: {', '.join(KINDS)})")
    with progress("judging") as report:
        names = run(
            out,
            parse_seeds(seeds),
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


def _show(result: dict[str, Any], out: Path) -> None:
    methods = {"workflow": result["workflow"], **result["baselines"]}
    count = ", ".join(f"{number} {kind}" for kind, number in result["cases"].items())
    seeds, redrawn = result["seeds"], result["redrawn"]
    print_table(
        f"seeds {seeds['first']} to {seeds['last']}, for {seeds['purpose']}: {count}",
        ["", "target", *methods],
        [[title, target, *(_share(method[key]) for method in methods.values())] for key, title, target in _ROWS],
    )
    rows = [
        [truth, ", ".join(f"{said} {n}" for said, n in counts.items())] for truth, counts in result["confusion"].items()
    ]
    print_table("what was hidden, and what was said of it", ["hidden", "said"], rows)
    bad = [row for row in result["rows"] if row["result"] in ("wrong", "failed") or _alarm(row)]
    listed = [[str(row["seed"]), row["robot"], _truth(row), " + ".join(row["named"])] for row in bad]
    if listed:
        print_table("wrong names, false alarms, no verdict", ["seed", "robot", "hidden", "said"], listed)
    levels = ", ".join(f"{level} {_share(value)}" for level, value in result["by_level"].items())
    print(f"right by level: {levels}; right place: {_share(result['right_place'])}")
    gap, time = result["gap_reduction"], result["seconds"]
    print(
        f"held-out gap reduction, share of the oracle's: median {_number(gap['median_share_of_oracle'])} (target 0.8)"
    )
    print(f"one diagnosis: median {_number(time['median'])} s, longest {_number(time['largest'])} s (target 60 s)")
    if redrawn["cases"]:
        print(
            f"{redrawn['cases']} cases were drawn again because the robot fell, {redrawn['lowered']} at a lower level"
        )
    if result["round"] > 1:
        print(f"round {result['round']}: the answers to these bags have been opened before")
    print(
        f"verdicts sealed as {result['verdicts_sha256'][:16]} before the answers were opened; all in {out}/score.json"
    )


def _alarm(row: dict[str, Any]) -> bool:
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
