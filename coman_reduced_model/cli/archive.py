# SPDX-License-Identifier: BSD-3-Clause
"""`coman archive` and `coman archive report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..errors import ConfigError
from .common import (
    ConfigOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_json,
    print_table,
    progress,
    read_config,
)


class _RunByDefault(TyperGroup):
    """`coman archive URI...` is `coman archive run URI...`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["run", *args]
        return super().parse_args(ctx, args)


archive = typer.Typer(
    cls=_RunByDefault, help="Predict and diagnose thousands of recordings; report robots over months."
)


@archive.command(epilog="Example: `coman archive walks --predict --diagnose --out results`")
def run(
    uris: Annotated[
        list[str], typer.Argument(metavar="URI...", help="Folders with bags at any depth: paths, s3://..., gs://...")
    ],
    out: Annotated[
        str, typer.Option("--out", metavar="DIR_OR_URI", help="Folder of the tables; a started one is gone on with.")
    ],
    predict: Annotated[bool, typer.Option("--predict", help="Predict each bag.")] = False,
    diagnose: Annotated[bool, typer.Option("--diagnose", help="Diagnose each robot's bags, period by period.")] = False,
    every: Annotated[str, typer.Option("--every", metavar="PERIOD", help="Of a diagnosis: week or month.")] = "month",
    robots: Annotated[
        Path | None, typer.Option("--robots", metavar="FILE", help="CSV table: bag (a pattern), robot, date.")
    ] = None,
    workers: Annotated[int, typer.Option("--workers", metavar="N", min=1, help="Processes of this machine.")] = 2,
    address: Annotated[
        str,
        typer.Option(
            "--address", metavar="HOST:PORT", help="Work on this cluster of Ray; local: start Ray on this machine."
        ),
    ] = "",
    memory: Annotated[
        int, typer.Option("--memory", metavar="MB", min=0, help="A worker that takes more is ended; 0: no limit.")
    ] = 2048,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    json: JsonOption = False,
) -> None:
    """Predict and diagnose all bags below some folders; write bags, phases and findings as Parquet tables."""
    settings = read_config(config, changes)
    if every not in ("week", "month"):
        raise ConfigError(f"--every: {every!r} is not allowed (allowed: week, month)")
    from ..archive.robots import read_robots
    from ..archive.run import Run, run_archive
    from ..archive.work import Settings
    from ..bag.session import read_urdf
    from ..topics import TopicNames

    TopicNames(namespace, remap or ())  # says now what is wrong with them
    text = read_urdf(urdf) if urdf else ""
    work = Settings(settings, text, namespace, tuple(remap or ()), predict, memory)
    table = tuple(read_robots(robots)) if robots else ()
    with progress("archive") as report_progress:
        summary = run_archive(Run(tuple(uris), out, work, diagnose, every, table, workers, address), report_progress)
    if json:
        print_json(summary)
    else:
        _show(summary)


@archive.command(epilog="Example: `coman archive report results`")
def report(
    directory: Annotated[str, typer.Argument(metavar="DIR_OR_URI", help="Output folder of coman archive.")],
    json: JsonOption = False,
) -> None:
    """How errors and effects of each robot change over months, since when, and which bags to look at: a page."""
    from ..archive.report.page import write_report

    with progress("drawing"):
        found = write_report(directory)
    if json:
        print_json(found)
        return
    for line in found["changes"]:
        print(line)
    print(f"written: {found['page']}")


def _show(summary: dict[str, Any]) -> None:
    rows = [[status, str(count)] for status, count in summary["bags"].items()]
    print_table("Bags", ["status", "bags"], rows)
    print(
        f"{summary['tasks']} tasks in {summary['elapsed_s']:.0f} s, {summary['tasks_done_before']} done before; "
        f"{summary['diagnoses']} diagnoses"
    )
    print(f"written: {summary['out']}; next: coman archive report {summary['out']}")
