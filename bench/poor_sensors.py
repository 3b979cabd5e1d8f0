# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts of `coman diagnose` on robots that are well but for poor sensors, play or friction, and with a worn drive.

    python bench/poor_sensors.py [--seeds 3]

COMAN of the data sheet, a training walk and two held-out ones, each recorded for this with other noise. A row is a kind
of robot; the last column has the same robots with a worn ankle roll drive (220 instead of 3000 Nm/rad). Small friction
and play in all joints are in the catalogue: naming them is right.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from coman_reduced_model import load_config
from coman_reduced_model.diagnose import diagnose
from coman_reduced_model.errors import ComanError
from coman_reduced_model.sim.disturbances import Disturbance, make
from coman_reduced_model.sim.record import record
from coman_reduced_model.sim.sensors import SensorOptions

KINDS = {
    "usual sensors": {},
    "link encoders with white noise of 0.5 mrad": {"encoder_noise": 5e-4},
    "neither torques nor IMU": {"effort": False, "imu": False},
    "neither torques, motors nor IMU": {"effort": False, "imu": False, "motor_states": False},
    "50 Hz": {"rate_hz": 50.0},
    "foot sensors with four times the noise": {"force_noise": (4.0, 4.0, 6.0), "moment_noise": (0.16, 0.16, 0.12)},
    "torques with gains 5 % off": {"torque_gain": 0.05},
    "foot sensors with cross-talk of 2 %": {"cross_talk": 0.02},
    "all of these but what is missing": {
        "encoder_noise": 5e-4, "rate_hz": 50.0, "torque_gain": 0.05, "cross_talk": 0.02,
        "force_noise": (4.0, 4.0, 6.0), "moment_noise": (0.16, 0.16, 0.12),
    },
    "friction of 0.2 Nm in all joints": ("joint_friction", {"coulomb": 0.2}),
    "play of 1 mrad in all joints": ("backlash", {"width": 0.001}),
}  # fmt: skip
WORN = ("joint_stiffness", {"where": "RAnkLat", "scale": 220.0 / 3000.0})


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="robots of each kind")
    seeds = range(parser.parse_args().seeds)
    table = Table("robots that are well but for", "verdicts", "with a worn ankle roll drive")
    for name, kind in KINDS.items():
        sensors, hidden = (SensorOptions(**kind), []) if isinstance(kind, dict) else (SensorOptions(), [kind])
        cells = [", ".join(verdicts(sensors, effects, seeds)) for effects in (hidden, [*hidden, WORN])]
        table.add_row(name, *cells)
    Console(width=150, markup=False).print(table)


def verdicts(sensors: SensorOptions, hidden: Sequence[tuple[str, dict]], seeds: range) -> list[str]:
    """What is said, and of how many."""
    found = Counter(verdict(sensors, [make(name, dict(values)) for name, values in hidden], seed) for seed in seeds)
    return [f"{times} {text}" for text, times in found.most_common()]


def verdict(sensors: SensorOptions, hidden: Sequence[Disturbance], seed: int) -> str:
    """Names and places of the effects, else the verdict; or why there is none."""
    config = load_config()
    if not sensors.motor_states:
        config = config.replaced({"prediction.reference": "none"})
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / name for name in ("train", "hold1", "hold2")]
        for k, bag in enumerate(bags):
            record("test2" if k else "test1", bag, sensors=sensors, disturbances=hidden, seed=100 * seed + k)
        try:
            result = diagnose(bags[:1], bags[1:], config).result
        except ComanError as error:
            return str(error).partition(": ")[2][:60]
    names = " and ".join(f"{e['name']} {e['where']}".strip() for e in result["effects"]) or str(result["verdict"])
    return f"{names} (minor)" if result["only_minor"] else names


if __name__ == "__main__":
    main()
