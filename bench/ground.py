# SPDX-License-Identifier: BSD-3-Clause
"""Ground that is not level: free run on slopes and with feet at different heights, beside that on the flat.

    python bench/ground.py [--seconds 13] [--gait test1]

The virtual robot walks two gaits on floors that its plan knows (worlds of sim/worlds, without tolerances). RMS error of
the free run, x, y, z, with the slope by the IMU, with the ground taken as level (`model.slope: level`), and the error
over that on the flat with the COM as high, of which at most 1.5 is the aim; skill of what is published 0.2 s ahead.
Steep slopes are walked with the COM at 0.36 m. Nothing was chosen on seeds; `LEAST` and `STEP` follow from how far
IMUs are off, and from how far encoders are.
"""

from __future__ import annotations

import argparse
import tempfile
from math import radians
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model import Config, Session
from coman_reduced_model.core.base.types import Array
from coman_reduced_model.sim.contact import Floor
from coman_reduced_model.sim.worlds import record_world
from coman_reduced_model.sim.worlds.world import World

LOW = 0.36  # [m] COM height
FLOORS = {
    "flat": Floor(),
    "5 degrees uphill": Floor(pitch=-radians(5.0)),
    "5 degrees to the right": Floor(roll=radians(5.0)),
    f"flat, COM at {LOW} m": Floor(),
    "10 degrees uphill": Floor(pitch=-radians(10.0)),
    "10 degrees downhill": Floor(pitch=radians(10.0)),
    "10 degrees to the right": Floor(roll=radians(10.0)),
    "left foot 3 cm higher": Floor(kerb=0.03),
    "left foot 5 cm higher": Floor(kerb=0.05),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=13.0)
    parser.add_argument("--gait", action="append")
    arguments = parser.parse_args()
    table = Table("floor", "gait", "free run [mm]", "over flat", "as level [mm]", "skill, 0.2 s ahead")
    with tempfile.TemporaryDirectory() as folder:
        for gait in arguments.gait or ("test1", "test2"):
            flat: dict[bool, Array] = {}  # error by whether the COM is low
            for name, floor in FLOORS.items():
                low = max(abs(floor.roll), abs(floor.pitch)) > radians(7.0) or name.startswith("flat,")
                changes = {"com_height_m": LOW} if low else {}
                world = World(
                    floor=floor, gait=gait, gait_changes=changes, duration_s=arguments.seconds, tolerances=False
                )
                bag = Path(folder) / f"{name} {gait}"
                if record_world(world, bag, seed=1).fallen_s is not None:
                    table.add_row(name, gait, "the robot falls")
                    continue
                error, skill = predicted(bag, "measured")
                level, _ = predicted(bag, "level")
                if name.startswith("flat"):
                    flat[low] = error
                over = error / flat.get(low, np.full(3, np.nan))
                table.add_row(name, gait, shown(1e3 * error), shown(over), shown(1e3 * level), shown(skill))
    Console(width=130, markup=False).print(table)


def predicted(bag: Path, slope: str) -> tuple[Array, Array]:
    """RMS error of the free run (3,) [m], and skill (3,) 0.2 s ahead."""
    with Session(bag, Config().replaced({"model.slope": slope, "prediction.horizons": [0.2]})) as session:
        residuals = np.array([p.residual for p in session.predictions() if not p.flags.diverged])
        return np.sqrt(np.nanmean(residuals**2, axis=0)), session.pipeline.judge.skill()["0.2"]


def shown(values: Array) -> str:
    """Three numbers."""
    return ", ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    main()
