# SPDX-License-Identifier: BSD-3-Clause
"""What a command takes from its start to its end, in a new process, once all is compiled.

    python bench/startup.py [RUNS]

Medians of some runs, in turn: wall time, and CPU time of the process. Ratios are to a bare Python that imports
Pinocchio and numpy, in the same round; they carry over to other machines better than times do. One round before these
is not counted: it compiles what is not compiled yet, bytecode as well, which an environment can forbid to write.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.base.types import Array
from coman_reduced_model.resources import bag_path

RUNS = 7
BARE = "python -c 'import pinocchio, numpy'"
PREDICT = "coman predict bags/test1 --out DIR"
COMAN = [sys.executable, "-m", "coman_reduced_model.cli.main"]


def commands(out: Path) -> dict[str, list[str]]:
    return {
        BARE: [sys.executable, "-c", "import pinocchio, numpy"],
        "coman --version": [*COMAN, "--version"],
        PREDICT: [*COMAN, "predict", str(bag_path("test1")), "--out", str(out), "--force"],
    }


def taken(command: Sequence[str]) -> tuple[float, float]:
    """Wall and CPU time [s] of a process and of those that it waits for."""
    environment = {key: text for key, text in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def rows(times: Mapping[str, Array], bare: str) -> list[list[str]]:
    """A row a command, of (runs, 2) wall and CPU times [s]: medians, and those of the ratios to the command `bare`."""
    found = []
    for name, each in times.items():
        (wall, cpu), (more, cpu_more) = np.median(each, axis=0), np.median(each / times[bare], axis=0)
        found.append([name, f"{wall:.2f}", f"{cpu:.2f}", f"{more:.1f}", f"{cpu_more:.1f}"])
    return found


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    with tempfile.TemporaryDirectory() as folder:
        measured = commands(Path(folder) / "out")
        rounds = [[taken(command) for command in measured.values()] for _ in range(1 + runs)][1:]
    times = {name: np.array([each[i] for each in rounds]) for i, name in enumerate(measured)}
    table = Table("command", "wall [s]", "CPU [s]", "wall / bare", "CPU / bare", title=f"medians of {runs} runs")
    for row in rows(times, BARE):
        table.add_row(*row)
    Console(width=140, markup=False).print(table)


if __name__ == "__main__":
    main()
