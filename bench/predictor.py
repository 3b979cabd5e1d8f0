# SPDX-License-Identifier: BSD-3-Clause
"""What one sample costs the predictor: the whole update, its parts, and the first call on a new machine.

    python bench/predictor.py [BAG]           # a bag of the robot of config/coman.yaml; default: the shipped test1

One core, samples of a walk (12 joints, motor side, both wrenches), garbage collection as usual; CPU time. `x call` is
the median over that of an empty numpy call (`np.empty(3)`) timed after every sample: a figure that carries over.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.resources import bag_path

PAPER = {"model.trunk_rotation": "without"}
VARIANTS = {
    "the paper's model, no horizons": PAPER | {"prediction.horizons": []},
    "the paper's model, horizons": PAPER,
    "condensed, both legs, gravity, lateral; horizons": {
        "model.stiffness": "condensed",
        "model.double_support": "both_legs",
        "model.trunk_rotation": "without",
        "model.gravity_stiffness": "with",
        "model.lateral_compliance": "with",
    },
    "no motor side (LIPM), horizons": {"prediction.reference": "none"},
    "the turning trunk, no horizons": {"prediction.horizons": []},
    "the turning trunk, horizons": {},
}
PARTS = ("the paper's model, horizons", "the turning trunk, horizons")


def read_samples(path: Path) -> tuple[Robot, list[Sample]]:
    with Session(path) as session:
        return session.robot, list(session.samples())


def timed(predictor: Predictor, samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """CPU seconds of each update, and of an empty numpy call after it."""
    updates, calls = np.empty(len(samples)), np.empty(len(samples))
    for i, sample in enumerate(samples):
        start = time.process_time()
        predictor.update(sample)
        middle = time.process_time()
        np.empty(3)
        updates[i], calls[i] = middle - start, time.process_time() - middle
    return updates, calls


class Stopwatch:
    """Wraps methods of an object and adds up the time within each."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def watch(self, owner: object, method: str, name: str) -> None:
        call: Callable = getattr(owner, method)

        def wrapped(*arguments: object) -> object:
            start = time.perf_counter()
            result = call(*arguments)
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            return result

        setattr(owner, method, wrapped)


def parts(robot: Robot, config: Config, samples: Sequence[Sample]) -> dict[str, float]:
    """Mean time of each part in one update [s]; some 0.3 us of each are the stopwatch's own."""
    predictor, watch = Predictor(robot, config), Stopwatch()
    for owner, method, name in (
        (predictor.support, "update", "support phase"),
        (predictor.link, "update", "kinematics, link side"),
        (predictor, "_zmp", "ZMP"),
        (predictor.dynamics, "prepare", "equation of motion (motor side, springs, filter)"),
        (predictor, "_free_run", "free run"),
        (predictor.dynamics, "ahead", "horizons"),
        (predictor.judge, "update", "judge of the horizons"),
    ):
        watch.watch(owner, method, name)
    for sample in samples:
        predictor.update(sample)
    return {name: seconds / len(samples) for name, seconds in watch.seconds.items()}


FIRST_CALL = """
import resource, sys, time
def used(): return sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.base.types import Sample
import numpy as np
from coman_reduced_model.resources import config_path
robot = Robot(config_path("coman.urdf").read_text(), Config().robot)
start = time.perf_counter(), used()
predictor = Predictor(robot, Config())
q, load = np.full(12, 0.2), np.array([0.0, 0.0, 80.0, 0.0, 0.0, 0.0])
for i in range(100):
    predictor.update(Sample(10**9 + i * 5_000_000, q, 0 * q, None, q, 0 * q, load, load))
print(time.perf_counter() - start[0], used() - start[1])
"""


def first_call() -> list[tuple[float, float]]:
    """Wall and CPU time [s] of the first samples without and with what numba has compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        outputs = [
            subprocess.run(
                [sys.executable, "-c", FIRST_CALL], env=environment, check=True, capture_output=True, text=True
            ).stdout
            for _ in range(2)
        ]
    return [(float(text.split()[0]), float(text.split()[1])) for text in outputs]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", nargs="?", type=Path, default=None)
    path = parser.parse_args().bag or bag_path("test1")
    robot, samples = read_samples(path)
    console = Console(width=120)

    table = Table(
        "predictor", "mean [us]", "median [us]", "p99 [us]", "x call", title=f"{path.name}: {len(samples)} samples"
    )
    for name, changes in VARIANTS.items():
        config = Config().replaced(changes)
        timed(Predictor(robot, config), samples[:1200])  # compiled, caches warm
        updates, calls = timed(Predictor(robot, config), samples)
        median, p99 = np.percentile(updates, [50, 99]) * 1e6
        ratio = np.median(updates) / np.median(calls)
        table.add_row(name, f"{updates.mean() * 1e6:.0f}", f"{median:.0f}", f"{p99:.0f}", f"{ratio:.0f}")
    console.print(table)

    table = Table("part, mean [us]", *PARTS)
    columns = [parts(robot, Config().replaced(VARIANTS[name]), samples) for name in PARTS]
    for part in columns[0]:
        table.add_row(part, *(f"{column[part] * 1e6:.1f}" for column in columns))
    console.print(table)

    table = Table("first samples of a process", "wall [s]", "CPU [s]")
    for name, (wall, cpu) in zip(("nothing compiled yet", "compiled before"), first_call(), strict=True):
        table.add_row(name, f"{wall:.1f}", f"{cpu:.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
