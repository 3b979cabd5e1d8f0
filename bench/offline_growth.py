# SPDX-License-Identifier: BSD-3-Clause
"""How the time of `coman predict` grows with the length of a bag and with its rate.

    python bench/offline_growth.py [--picture FILE]     # some minutes

CPU time of reading, predicting and writing; start-up (imports, loading compiled code) is left out. Lengths: the shipped
test1 over and over, at 200 Hz. Rates: the same gait recorded with the virtual robot, 12 s. The exponent is the slope of
a straight line through the logarithms: 1 is proportional.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from offline import measure, repeat
from rich.console import Console
from rich.table import Table

from coman_reduced_model.resources import bag_path

matplotlib.use("Agg")
import matplotlib.pyplot as plt

LENGTHS = (12, 24, 60, 120)  # [s]
RATES = (100, 200, 500, 1000)  # [Hz]

PREDICT = """
import json, sys, time
from coman_reduced_model.bag.session import Session
from coman_reduced_model.offline import predict_bag
from coman_reduced_model.resources import bag_path
for bag, out in ((bag_path("stand"), "/warm"), (sys.argv[1], "/out")):
    with Session(bag) as session:
        began = time.process_time()
        summary = predict_bag(session, sys.argv[1] + out)
        cpu = time.process_time() - began
print(json.dumps({"cpu": cpu, "samples": summary["samples"], "duration": summary["duration_s"]}))
"""


def record(target: Path, rate: int) -> None:
    """Twelve seconds of the gait of test1 at a rate [Hz]."""
    command = [sys.executable, "-m", "coman_reduced_model.cli.main", "record", "--gait", "test1", "--duration", "12"]
    subprocess.run([*command, "--rate", str(rate), "--out", str(target)], check=True, stdout=subprocess.DEVNULL)


def exponent(x: np.ndarray, y: np.ndarray) -> float:
    """Slope of the line through the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def draw(
    curves: dict[str, tuple[np.ndarray, np.ndarray]], path: Path, what: str = "CPU time of predicting [s]"
) -> None:
    """A panel a curve, both axes logarithmic."""
    figure, panels = plt.subplots(1, len(curves), figsize=(9.0, 3.4), layout="constrained", squeeze=False)
    for panel, (name, (x, cpu)) in zip(panels[0], curves.items(), strict=True):
        panel.loglog(x, cpu, "o-", label=f"exponent {exponent(x, cpu):.2f}")
        panel.loglog(x, cpu[0] * x / x[0], ":", color="0.5", label="proportional")
        panel.set_xlabel(name)
        panel.set_xticks(x, [f"{each:.0f}" for each in x])
        panel.minorticks_off()
        panel.set_ylabel(what)
        panel.grid(alpha=0.3)
        panel.legend(frameon=False)
    figure.savefig(path, dpi=75, metadata={"Software": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path, help="where to draw both curves")
    arguments = parser.parse_args()
    cases = [("length of the bag [s]", each) for each in LENGTHS] + [("rate [Hz]", each) for each in RATES]
    table = Table("what grows", "value", "samples", "CPU [s]", "us a sample", "x real time")
    found: dict[str, list[tuple[float, float]]] = {}
    for name, value in cases:
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "bag"
            if name.startswith("rate"):
                record(bag, value)
            else:
                repeat(bag_path("test1"), bag, value)
            result = measure(PREDICT, bag)
        cpu, samples = result["cpu"], result["samples"]
        x = value if name.startswith("rate") else result["duration"]
        found.setdefault(name, []).append((x, cpu))
        row = (f"{x:.0f}", f"{samples}", f"{cpu:.2f}", f"{1e6 * cpu / samples:.0f}", f"{result['duration'] / cpu:.1f}")
        table.add_row(name, *row)
    Console(width=100, markup=False).print(table)
    curves = {name: (np.array(points)[:, 0], np.array(points)[:, 1]) for name, points in found.items()}
    for name, (x, cpu) in curves.items():
        print(f"{name}: CPU time grows with exponent {exponent(x, cpu):.2f}")
    if arguments.picture:
        draw(curves, arguments.picture)


if __name__ == "__main__":
    main()
