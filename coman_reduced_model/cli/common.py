# SPDX-License-Identifier: BSD-3-Clause
"""What the commands share: options, configuration, progress on standard error, results on standard output."""

from __future__ import annotations

import gc
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from ..errors import ConfigError
from . import complete
from .compiling import COMPILING, compilation

if TYPE_CHECKING:
    from ..core.config.schema import Config
    from ..progress import Progress

_SHOW_AFTER = 0.5  # [s] shorter work needs no progress
_LINE_EVERY = 2.0  # [s] between lines where standard error is no terminal

BagArgument = Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a rosbag2 recording, or one of its files.")]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="ROS 2 parameter file; default: the shipped coman.yaml.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a parameter, as in prediction.reference=none; repeatable.",
        autocompletion=complete.parameters,
    ),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace what an earlier run wrote there.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON; progress goes to standard error.")]
NamespaceOption = Annotated[str, typer.Option("--namespace", metavar="NS", help="Namespace of the topics.")]
RemapOption = Annotated[
    list[str] | None, typer.Option("--remap", metavar="OLD:=NEW", help="Other name of a topic; repeatable.")
]
BaselineOption = Annotated[
    Path | None, typer.Option("--baseline", metavar="FILE", help="What is usual for this robot, by coman baseline.")
]
UrdfOption = Annotated[
    Path | None,
    typer.Option("--urdf", metavar="FILE", help="Robot, instead of the one that bag or configuration name."),
]


def read_config(path: Path | None, changes: Sequence[str] | None = None, node: str = "predictor") -> Config:
    """The configuration of a file, or the shipped one, with the changes of --set.

    Raises:
        ConfigError: the file or a change is not allowed.
    """
    from ..core.config.files import load_config
    from ..core.config.schema import FILES

    config = load_config(path, node)
    warn(config.notes)
    values: dict[str, Any] = {}
    for change in changes or ():
        key, separator, text = change.partition("=")
        if not separator:
            raise ConfigError(f"--set: {change!r} is not of the form KEY=VALUE")
        try:
            value = yaml.safe_load(text)
        except (yaml.YAMLError, ValueError):  # a date that is none
            raise ConfigError(f"--set: {key.strip()}: {text!r} is not a value of YAML") from None
        if key.strip() in FILES and isinstance(value, str) and value:  # from here, not from the configuration's folder
            value = str(Path(value).absolute()) if not value.startswith("~") else value
        values[key.strip()] = value
    return config.replaced(values, "--set") if values else config


@contextmanager
def loading() -> Iterator[None]:
    """No garbage collection: what is loaded stays, and to look through it again and again takes time."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextmanager
def progress(title: str) -> Iterator[Progress]:
    """A function (fraction done, words) that shows progress on standard error once the work takes a while."""
    console = Console(stderr=True)
    if console.is_terminal:
        with _bar(title, console) as (report, say), compilation(say):
            yield report
    else:
        report = _lines(title)
        with compilation(lambda done, total: report(done / total, COMPILING)):
            yield report


@contextmanager
def _bar(title: str, console: Console) -> Iterator[tuple[Progress, Callable[[int, int], None]]]:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    bar = Bar(*columns, TextColumn("{task.fields[words]}"), console=console, transient=True)
    task = bar.add_task(title, total=1.0, words="")
    began = time.monotonic()

    def report(fraction: float, words: str) -> None:
        if not bar.live.is_started and time.monotonic() - began > _SHOW_AFTER:
            bar.start()
        bar.update(task, completed=min(max(fraction, 0.0), 1.0), words=words)

    compiled = bar.add_task(COMPILING, total=None, visible=False, words="")

    def say(done: int, total: int) -> None:
        if not bar.live.is_started and time.monotonic() - began > _SHOW_AFTER:
            bar.start()
        bar.update(compiled, completed=done, total=total, visible=True)

    try:
        yield report, say
    finally:
        bar.stop()


def _lines(title: str) -> Progress:
    last = time.monotonic()

    def report(fraction: float, words: str) -> None:
        nonlocal last
        if time.monotonic() - last > _LINE_EVERY:
            last = time.monotonic()
            print(f"{title}: {100.0 * min(max(fraction, 0.0), 1.0):.0f} %, {words}", file=sys.stderr, flush=True)

    return report


def warn(lines: Sequence[str]) -> None:
    """Warnings, a line each, on standard error."""
    for line in lines:
        print(f"warning: {' '.join(line.split())}", file=sys.stderr)


def say_domain() -> None:
    """Where other processes find the nodes that are started now, on standard error."""
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    found = " ".join(f"{name}={os.environ[name]}" for name in names)
    print(f"nodes run with {found}; set both in another shell to see their topics", file=sys.stderr, flush=True)


def print_json(value: Any) -> None:
    """A result on standard output, null where nothing is known."""
    from ..output import to_json

    print(to_json(value))


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], words: int = 1) -> None:
    """A table on standard output; the first `words` columns are text, the others are numbers."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for index, name in enumerate(header):
        table.add_column(Text(name), justify="left" if index < words else "right")
    for row in rows:
        table.add_row(*map(Text, row))
    print(title)
    columns = os.environ.get("COLUMNS", "")
    Console(width=None if sys.stdout.isatty() else int(columns) if columns.isdigit() else 100).print(table)


def by_axis_text(values: Mapping[str, float], scale: float, digits: int) -> list[str]:
    """x, y, z as text; a dash where nothing is known."""
    return [f"{scale * value:.{digits}f}" if math.isfinite(value) else "-" for value in values.values()]
