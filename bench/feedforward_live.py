# SPDX-License-Identifier: BSD-3-Clause
"""The same in the loop of the nodes: virtual robot, trajectory and predictor, as `coman live` runs them.

    python bench/feedforward_live.py [--duration 60]        # six minutes

COM off its plan: RMS of measured COM minus plan in the support sole while the plan moves. That is not the true COM:
a measured COM takes the sole as flat on the ground, so that what the sole rocks is not in it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

GAITS = ("test1", "test2")
LEADS = (("own lead 0.5", 0.5, ()), ("own lead 0.8", 0.8, ()), ("planned (--compensate)", 0.5, ("--compensate",)))
FACTS = ("COM off its plan while that moves [mm]", "planned deflections in time", "real-time factor")


def walked(folder: Path, gait: str, lead: float, options: tuple[str, ...], duration_s: float) -> list[str]:
    """What `coman live` says at its end of each of FACTS; `-`: nothing."""
    config = folder / f"lead_{lead:g}.yaml"
    config.write_text(f"/**:\n  ros__parameters:\n    virtual_robot.lead: {lead}\n", encoding="utf-8")
    command = [Path(sys.executable).with_name("coman"), "live", "--gait", gait, "--duration", f"{duration_s:g}"]
    done = subprocess.run([*command, "--config", config, *options], capture_output=True, text=True, check=True)
    said = dict(line.split(": ", 1) for line in done.stdout.splitlines() if ": " in line)
    return [said.get(fact, "-") for fact in FACTS]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=60.0, help="of each run, start included [s]")
    arguments = parser.parse_args()
    table = Table("motors lead by", "gait", "COM off its plan, x, y, z [mm]", *FACTS[1:])
    with tempfile.TemporaryDirectory() as folder:
        for name, lead, options in LEADS:
            for gait in GAITS:
                table.add_row(name, gait, *walked(Path(folder), gait, lead, options, arguments.duration))
    Console(width=120, markup=False).print(table)


if __name__ == "__main__":
    main()
