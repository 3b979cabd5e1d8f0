# SPDX-License-Identifier: BSD-3-Clause
"""Ground that is not level: free run on slopes and with feet at different heights, beside that on the flat.

    python bench/ground.py [--seconds 13] [--gait test1]

The virtual robot walks two gaits on floors that its plan knows (worlds of sim/worlds, without tolerances). RMS error of
the free run, x, y, z, with the slope by the IMU, with the ground taken as level (`model.slope: level`), and the error
over that of the same gait on the flat, of which at most 1.5 is the aim; skill of what is published 0.2 s ahead. Steep
slopes are walked with the COM at 0.36 m, steps up and down with strides that are longer than the soles. `LEAST` and
`STEP` follow from how far IMUs are off, and from how far encoders are; the contact was chosen on `test1`, 3 cm.
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

USUAL: dict[str, float] = {}
LOW = {"com_height_m": 0.36}
LONG = {"step_length_m": 0.12, "step_height_m": 0.06}
FLOORS = {  # with changes of the gait
    "flat": (Floor(), USUAL),
    "5 degrees uphill": (Floor(pitch=-radians(5.0)), USUAL),
    "5 degrees to the right": (Floor(roll=radians(5.0)), USUAL),
    "left foot 3 cm higher": (Floor(kerb=0.03), USUAL),
    "left foot 5 cm higher": (Floor(kerb=0.05), USUAL),
    "flat, COM at 0.36 m": (Floor(), LOW),
    "10 degrees uphill": (Floor(pitch=-radians(10.0)), LOW),
    "10 degrees downhill": (Floor(pitch=radians(10.0)), LOW),
    "10 degrees to the right": (Floor(roll=radians(10.0)), LOW),
    "flat, steps of 12 cm": (Floor(), LONG),
    "2 cm up and down": (Floor(platform=0.02), LONG),
    "3 cm up and down": (Floor(platform=0.03), LONG),
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
            flat = np.full(3, np.nan)  # error [m] of the last floor that is
            for name, (floor, changes) in FLOORS.items():
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
                    flat = error
                table.add_row(name, gait, shown(1e3 * error), shown(error / flat), shown(1e3 * level), shown(skill))
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
