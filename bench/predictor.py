# SPDX-License-Identifier: BSD-3-Clause
"""What one sample costs the predictor: the whole update and its parts.

    python bench/predictor.py [BAG]           # a bag of the robot of config/coman.yaml; default: the shipped test1
    python bench/predictor.py --first-call    # what compiling costs a new machine

One core, samples of a walk (12 joints, motor side, both wrenches), garbage collection as usual; CPU time. The
yardstick is one forward dynamics of the same robot by Pinocchio (ABA) from Python, timed once after each sample, when
caches are cold for it: `x ABA` are ratios in one run, which carry over to other machines better than times do. Parts
are means by wall time; calls of Pinocchio are counted in the run, their time is that number times the median of a call.
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
import pinocchio as pin
from rich.console import Console
from rich.table import Table

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Estimate, Flags, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.monitor.monitor import Monitor
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
SAMPLES, WARM = 1500, 300  # measured; before that, so that compiled code is loaded and caches are warm
PARTS = ("the paper's model, horizons", "the turning trunk, horizons")
CALLING = ("the turning trunk, no horizons", "the turning trunk, horizons")


def read_samples(path: Path) -> tuple[Robot, list[Sample]]:
    with Session(path) as session:
        return session.robot, list(session.samples())


class NoObserver:
    """In the place of the observer, to see what the rest costs."""

    flags = Flags.OK
    constants = np.zeros((3, 3))

    def update(self, *_: object) -> Estimate:
        return Estimate()

    def reset(self) -> None:
        pass


def timed(predictor: Predictor, samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """CPU seconds of each update, and of a forward dynamics after it."""
    model = predictor.robot.model
    data, q, v = model.createData(), pin.neutral(model), np.zeros(model.nv)
    updates, yardstick = np.empty(len(samples)), np.empty(len(samples))
    for i, sample in enumerate(samples):
        start = time.process_time()
        predictor.update(sample)
        middle = time.process_time()
        pin.aba(model, data, q, v, v)
        updates[i], yardstick[i] = middle - start, time.process_time() - middle
    return updates, yardstick


class Stopwatch:
    """Wraps functions of objects and modules, and keeps the time within each call; undone by `stop`."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}
        self._watched: list[tuple[object, str, Callable]] = []

    def watch(self, owner: object, function: str, name: str) -> None:
        call: Callable = getattr(owner, function)

        def wrapped(*arguments: object, **named: object) -> object:
            start = time.perf_counter()
            result = call(*arguments, **named)
            self.seconds.setdefault(name, []).append(time.perf_counter() - start)
            return result

        setattr(owner, function, wrapped)
        self._watched.append((owner, function, call))

    def stop(self) -> None:
        for owner, function, call in self._watched:
            setattr(owner, function, call)


def through(predictor: Predictor, monitor: Monitor, samples: Sequence[Sample]) -> None:
    """Predict and monitor all samples."""
    for sample in samples:
        made = predictor.update(sample)
        assert predictor.sample is not None
        monitor.update(predictor.sample, predictor.link, made)


def parts(robot: Robot, config: Config, samples: Sequence[Sample]) -> dict[str, float]:
    """Mean time of each part in one update [s]; some 0.3 us of each are the stopwatch's own."""
    through(Predictor(robot, config), Monitor(robot, config), samples[:WARM])
    predictor, monitor, watch = Predictor(robot, config), Monitor(robot, config), Stopwatch()
    for owner, method, name in (
        (predictor.support, "update", "support phase"),
        (predictor.link, "update", "kinematics, link side"),
        (predictor, "_zmp", "ZMP"),
        (predictor.dynamics, "prepare", "equation of motion (motor side, springs, filter)"),
        (predictor, "_free_run", "free run"),
        (predictor.dynamics, "ahead", "horizons"),
        (predictor.judge, "update", "judge of the horizons"),
        (predictor.observer, "update", "observer"),
        (predictor, "_deflections", "deflections and their sigma"),
        (monitor, "update", "monitor"),
    ):
        watch.watch(owner, method, name)
    through(predictor, monitor, samples)
    return {name: sum(seconds) / len(samples) for name, seconds in watch.seconds.items()}


def of_pinocchio(robot: Robot, config: Config, samples: Sequence[Sample]) -> dict[str, tuple[float, float]]:
    """What an update calls of Pinocchio, by function: mean number of calls; that times the median of a call [s].

    The first `WARM` samples are not counted. Some 0.3 us of each call are the stopwatch's own.
    """
    predictor, watch, kind = Predictor(robot, config), Stopwatch(), type(pin.aba)
    for sample in samples[:WARM]:
        predictor.update(sample)
    for name in [name for name in dir(pin) if type(getattr(pin, name)) is kind]:  # functions of C++
        watch.watch(pin, name, name)
    try:
        for sample in samples[WARM:]:
            predictor.update(sample)
    finally:
        watch.stop()
    calls = {name: len(seconds) / (len(samples) - WARM) for name, seconds in watch.seconds.items()}
    return {name: (calls[name], calls[name] * float(np.median(watch.seconds[name]))) for name in calls}


def pinocchio_table(robot: Robot, samples: Sequence[Sample], cold: float) -> Table:
    """Calls and time of Pinocchio in an update; `cold` is the median of an ABA after an update [s]."""
    found = [of_pinocchio(robot, Config().replaced(VARIANTS[name]), samples) for name in CALLING]
    title = f"Pinocchio, called from Python; for comparison, one ABA after an update {cold * 1e6:.1f} us"
    table = Table("function: calls an update, their time [us]", *CALLING, title=title)
    for name in sorted(set().union(*found)):
        table.add_row(name, *(_calls(*each.get(name, (0.0, 0.0))) for each in found))
    table.add_row("all", *(_calls(*map(sum, zip(*each.values(), strict=True))) for each in found))
    return table


def _calls(calls: float, seconds: float) -> str:
    return f"{calls:.1f}: {seconds * 1e6:.1f}"


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
    parser.add_argument("--first-call", action="store_true", help="instead: what compiling costs a new machine")
    arguments = parser.parse_args()
    console = Console(width=140, markup=False)
    if arguments.first_call:
        table = Table("first samples of a process", "wall [s]", "CPU [s]")
        for name, (wall, cpu) in zip(("nothing compiled yet", "compiled before"), first_call(), strict=True):
            table.add_row(name, f"{wall:.1f}", f"{cpu:.1f}")
        console.print(table)
        return
    path = arguments.bag or bag_path("test1")
    robot, samples = read_samples(path)
    samples = samples[:SAMPLES]

    names = ("predictor", "mean [us]", "median [us]", "x ABA", "p99 [us]", "p99 x ABA")
    table = Table(*names, title=f"{path.name}: {len(samples)} samples; in brackets without the observer")
    for name, changes in VARIANTS.items():
        config = Config().replaced(changes)
        timed(Predictor(robot, config), samples[:WARM])
        cells = []
        for observer in (True, False):
            predictor = Predictor(robot, config)
            if not observer:
                predictor.observer = NoObserver()  # type: ignore[assignment]
            updates, yardstick = timed(predictor, samples)
            aba, (median, p99) = float(np.median(yardstick)), np.percentile(updates, [50, 99])
            micro = [f"{each * 1e6:.0f}" for each in (updates.mean(), median, p99)]
            cells.append((*micro[:2], f"{median / aba:.1f}", micro[2], f"{p99 / aba:.0f}"))
        table.add_row(name, *(f"{one} ({other})" for one, other in zip(*cells, strict=True)))
    console.print(table)

    console.print(pinocchio_table(robot, samples, aba))
    table = Table("part, mean [us]", *PARTS)
    columns = [parts(robot, Config().replaced(VARIANTS[name]), samples) for name in PARTS]
    for part in columns[0]:
        table.add_row(part, *(f"{column[part] * 1e6:.1f}" for column in columns))
    console.print(table)


if __name__ == "__main__":
    main()
