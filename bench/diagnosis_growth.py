# SPDX-License-Identifier: BSD-3-Clause
"""How the time of `coman diagnose` grows with the length of the recordings and with their number.

    python bench/diagnosis_growth.py [--picture FILE]     # some ten minutes

Virtual robots with a backlash of 1 degree in the left knee, gaits of test1 to diagnose from and of test2 to hold out,
recorded for this. CPU time of the command and its second process, start-up included. The exponent is the slope of a
straight line through the logarithms: 1 is proportional.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from offline_growth import draw, exponent
from rich.console import Console
from rich.table import Table

from coman_reduced_model.sim.disturbances.springs import Backlash
from coman_reduced_model.sim.record import record

LENGTHS = (8, 15, 30, 60)  # [s] of each of two recordings to diagnose from
NUMBERS = (1, 2, 4, 8)  # recordings of 12 s


def diagnosed(train: list[Path], hold: Path, out: Path) -> tuple[float, float, str]:
    """CPU and wall seconds of `coman diagnose`, and its verdict."""
    command = [sys.executable, "-m", "coman_reduced_model.cli.main", "diagnose", *map(str, train)]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run([*command, "--holdout", str(hold), "--out", str(out), "--json"], check=True, stdout=-1)
    wall, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    found = json.loads(done.stdout)
    names = ", ".join(f"{each['name']} {each['where']}".strip() for each in found["effects"])
    names += " (minor)" if found["only_minor"] else ""
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall, names or found["verdict"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path, help="where to draw both curves")
    arguments = parser.parse_args()
    cases = [("length of two recordings [s]", each, 2, each) for each in LENGTHS]
    cases += [("recordings of 12 s", 12, each, each) for each in NUMBERS]
    shown = Table("what grows", "value", "CPU [s]", "wall clock [s]", "verdict")
    found: dict[str, list[tuple[float, float]]] = {}
    for name, seconds, number, x in cases:
        with tempfile.TemporaryDirectory() as folder:
            hidden = [Backlash("LKneeSag", np.deg2rad(1.0))]
            bags = [Path(folder) / f"bag_{i}" for i in range(number + 1)]
            for i, bag in enumerate(bags):
                record("test1" if i else "test2", bag, disturbances=hidden, seed=i, duration_s=float(seconds))
            cpu, wall, verdict = diagnosed(bags[1:], bags[0], Path(folder) / "out")
        found.setdefault(name, []).append((x, cpu))
        shown.add_row(name, f"{x}", f"{cpu:.1f}", f"{wall:.1f}", verdict)
    Console(width=100, markup=False).print(shown)
    curves = {name: (np.array(points)[:, 0], np.array(points)[:, 1]) for name, points in found.items()}
    for name, (values, cpu) in curves.items():
        print(f"{name}: CPU time grows with exponent {exponent(values, cpu):.2f}")
    if arguments.picture:
        draw(curves, arguments.picture, "CPU time of diagnosing [s]")


if __name__ == "__main__":
    main()
