# SPDX-License-Identifier: BSD-3-Clause
"""How fast cases of the judge are made, by engine.

    python bench/cases.py [--first 4120] [--cases 40]

Seconds of the three walks of a case over the CPU time that it takes: recording: all walks that are kept, as they are
written; case: all of it, with the clean walk by which the size of an effect is chosen and cases that are drawn again.
All cases: their seconds over the CPU time of all. One case of each engine before is not counted.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.judge.cases import BAGS, HELD_OUT_S, draw_case, write_case, write_seed


def made(seed: int) -> tuple[str, float, float, float]:
    """Of the case of a seed: engine, seconds of its walks, CPU time of their recording and of all of it [s]."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        case, _ = write_seed(seed, folder)
        whole = time.process_time() - began
        began = time.process_time()
        write_case(case, Path(folder) / "again", force=True)
        alone = time.process_time() - began
    seconds = case.world.duration_s + (len(BAGS) - 1) * min(case.world.duration_s, HELD_OUT_S)
    return case.world.engine, seconds, alone, whole


def warm() -> None:
    """Make the first case of each engine: compiling and importing count nowhere."""
    engines = [draw_case(seed).world.engine for seed in range(40)]
    for engine in sorted({*engines}):
        made(engines.index(engine))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=4120)
    parser.add_argument("--cases", type=int, default=40)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.cases)
    with ProcessPoolExecutor(2, initializer=warm) as pool:
        found = list(pool.map(made, seeds))
    table = Table("engine", "cases", "recording, median", "slowest tenth", "case, median", "slowest tenth", "all cases")
    for engine in sorted({name for name, *_ in found}):
        seconds, *times = np.array([each for name, *each in found if name == engine]).T
        figures = [np.quantile(seconds / time, share) for time in times for share in (0.5, 0.1)]
        table.add_row(engine, str(len(seconds)), *words([*figures, seconds.sum() / times[1].sum()]))
    Console(width=130, markup=False).print(table)


def words(values: Sequence[float]) -> list[str]:
    return [f"{value:.1f}" for value in values]


if __name__ == "__main__":
    main()
