# SPDX-License-Identifier: BSD-3-Clause
"""`coman judge`."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from . import complete
from .common import ConfigOption, JsonOption, print_json, progress
from .judge_tables import show_diagnosis, show_folder, show_monitor, show_prediction, show_watched

WHAT = ("diagnosis", "prediction", "monitor")
TAKEN = {  # options by what is judged, beside --out, --jobs and --json
    "diagnosis": (
        "--seeds", "--only", "--world", "--workflow", "--no-baselines", "--no-oracle", "--baseline", "--again",
    ),
    "prediction": ("--seeds", "--world"),
    "monitor": ("--seeds", "--world", "--hours"),
    "diagnosis --cases": ("--config", "--workflow"),
    "prediction --cases": ("--config",),
    "monitor --cases": ("--config",),
}  # fmt: skip


def judge(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the run; an interrupted run continues there.")
    ],
    what: Annotated[
        str, typer.Argument(metavar="WHAT", help="diagnosis (default), prediction or monitor.", show_default=False)
    ] = "diagnosis",
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
    jobs: Annotated[
        int, typer.Option("--jobs", metavar="N", min=0, help="Processes at a time; 0: as many as there are cores.")
    ] = 0,
    only: Annotated[
        str, typer.Option("--only", metavar="KINDS", help="Some of clean,single,pair,unknown; default: all.")
    ] = "",
    worlds: Annotated[
        list[str] | None,
        typer.Option(
            "--world",
            metavar="KIND",
            help="Only worlds of this kind (coman worlds lists them); repeatable.",
            autocompletion=complete.worlds,
        ),
    ] = None,
    cases: Annotated[
        Path | None,
        typer.Option("--cases", metavar="DIR", help="Judge on recordings of others, with their answers."),
    ] = None,
    config: ConfigOption = None,
    workflow: Annotated[
        str,
        typer.Option("--workflow", metavar="COMMAND", help="Judge another command with the options of coman diagnose."),
    ] = "",
    no_baselines: Annotated[bool, typer.Option("--no-baselines", help="Leave out the simpler methods.")] = False,
    no_oracle: Annotated[
        bool,
        typer.Option("--no-oracle", help="Leave out the two oracles: given the effect, and given the variability."),
    ] = False,
    baseline: Annotated[
        bool,
        typer.Option(
            "--baseline",
            help="Each diagnosis gets the baseline of its robot, from three nominal recordings.",
        ),
    ] = False,
    hours: Annotated[
        float,
        typer.Option(
            "--hours",
            metavar="H",
            min=0.0,
            max=1000.0,
            help="Monitor: watch clean walks of 120 s until this many hours were walked, earlier runs included; their "
            "bags are not kept.",
            show_default=False,
        ),
    ] = 0.0,
    again: Annotated[
        bool, typer.Option("--again", help="Another round of verdicts on the bags in DIR; the score counts the rounds.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Judge diagnosis, prediction or monitor on virtual robots of all kinds of worlds, whose answers they cannot see.

    Seeds on which something was chosen or reported are spent; they are listed in judge/seeds.yaml, and the result says
    which of its seeds are. A run on fresh seeds prints the line to add to that file: they are spent from then on.
    """
    from ..errors import ConfigError
    from ..judge.run import BASELINES

    if what not in WHAT:
        raise ConfigError(f"{what!r}: allowed: {', '.join(WHAT)}")
    given = {"--seeds": seeds, "--only": only, "--world": worlds, "--config": config, "--workflow": workflow,
             "--no-baselines": no_baselines, "--no-oracle": no_oracle, "--baseline": baseline, "--hours": hours,
             "--again": again}  # fmt: skip
    _refuse_ignored(what + (" --cases" if cases else ""), [option for option, value in given.items() if value])
    jobs = jobs or len(os.sched_getaffinity(0))
    try:
        command = shlex.split(workflow)
    except ValueError as error:
        raise ConfigError(f"--workflow: {error}") from None
    if cases is not None:
        _judge_folder(what, cases, out, config, jobs, command, json)
        return
    chosen, fixed = _seeds(seeds, out), {"worlds": _worlds(worlds or ())}
    if what == "diagnosis":
        options: dict[str, Any] = {"baselines": () if no_baselines else BASELINES, "oracle": not no_oracle}
        options |= {"again": again, "baseline": baseline, **fixed}
        _judge_diagnosis(out, chosen, _kinds(only), jobs, command, options, json)
    else:
        _judge_on_clean(what, out, chosen, jobs, fixed, hours, json)


def _refuse_ignored(what: str, given: Sequence[str]) -> None:
    """Refuse options that would have no effect.

    Raises:
        ConfigError: one is given.
    """
    from ..errors import ConfigError

    for option in given:
        if option not in TAKEN[what]:
            raise ConfigError(f"{option}: has no effect with {what} (allowed: {', '.join(TAKEN[what])})")


def _judge_folder(
    what: str, cases: Path, out: Path, config: Path | None, jobs: int, command: Sequence[str], json: bool
) -> None:
    from ..judge.foreign import judge_folder, watch_folder
    from ..judge.run import DIAGNOSE

    with progress("judging") as report:
        if what == "diagnosis":
            result = judge_folder(cases, out, config, jobs, command or DIAGNOSE, report)
        else:
            result = watch_folder(cases, out, config, jobs, report)
    if json:
        print_json(result)
    elif what == "diagnosis":
        show_folder(result, out)
    elif what == "prediction":
        show_prediction(result["prediction"], out, "walks")
    else:
        show_watched(result["monitor"], out)


def _judge_diagnosis(
    out: Path,
    seeds: Sequence[int],
    kinds: Sequence[str],
    jobs: int,
    command: Sequence[str],
    options: Mapping[str, Any],
    json: bool,
) -> None:
    from ..judge.folder import RunFolder
    from ..judge.run import DIAGNOSE, run
    from ..judge.score import score_run

    with progress("judging") as report, RunFolder(out.absolute()).timed("diagnosis", jobs):
        names = run(out, seeds, kinds, jobs, command or DIAGNOSE, progress=report, **options)
    result = score_run(out, names)
    if json:
        print_json(result)
    else:
        show_diagnosis(result, out)


def _judge_on_clean(
    what: str, out: Path, seeds: Sequence[int], jobs: int, fixed: Mapping[str, Any], hours: float, json: bool
) -> None:
    """The prediction, or the monitor, whose false alarms are those of the same walks, and of long ones."""
    from ..judge.folder import RunFolder
    from ..judge.hours import run_hours
    from ..judge.monitor import run_onsets, score_monitor
    from ..judge.prediction import run_predictions, score_predictions

    folder = RunFolder(out.absolute())
    with progress("predicting") as report, folder.timed(what, jobs):
        names = run_predictions(out, seeds, jobs, report, **fixed)
    if what == "prediction":
        result = score_predictions(out, names)
    else:
        with progress("watching") as report, folder.timed(what, jobs):
            run_onsets(out, seeds, jobs, report, **fixed)
            long = run_hours(out, seeds, hours, jobs, report, **fixed)
        result = score_monitor(out, names, seeds, long)
    if json:
        print_json(result)
    else:
        (show_prediction if what == "prediction" else show_monitor)(result, out)


def _seeds(text: str, out: Path) -> Sequence[int]:
    from ..judge.run import choose_seeds
    from ..judge.seeds import describe

    chosen = choose_seeds(text, out)
    print(f"seeds {min(chosen)} to {max(chosen)}: {describe('worlds', chosen)}", file=sys.stderr)
    return chosen


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


def _worlds(names: Sequence[str]) -> dict[str, str]:
    """By axis, the kind of world that --world names; `plain` stands for the plain kind of each axis.

    Raises:
        ConfigError: there is no such kind, or two of one axis.
    """
    from ..errors import ConfigError
    from ..sim.worlds import PLAIN, kind_named
    from ..sim.worlds.draw import plain_kinds

    fixed = plain_kinds() if PLAIN in names else {}
    chosen: dict[str, str] = {}
    for name in names:
        if name == PLAIN:
            continue
        axis, kind = kind_named(name)
        if axis in chosen:
            raise ConfigError(f"--world: {chosen[axis]} and {name} are both of the axis {axis}")
        chosen[axis] = kind.name
    return fixed | chosen
