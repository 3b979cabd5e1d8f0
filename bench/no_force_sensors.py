# SPDX-License-Identifier: BSD-3-Clause
"""Robots without foot force sensors: support phases and errors by computed wrenches, beside those by sensors.

    python bench/no_force_sensors.py bags/test1 bags/test2 --worlds 7100 7101

Every recording is predicted with its foot sensors, and without (`streams.wrench_source`): by its joint torques, and
by its contact states if it has them; those of worlds are of switches that close at 8 N. Phases: share of samples with
the same phase as by sensors, times of the changes of phase against the nearest change by sensors into the same phase
(median and 90th percentile of the distance), and how many changes there are. Errors: RMS of the free run, and of what
is published 0.2 s ahead, x, y, z. Worlds are plain but for their imperfections (play, friction, lags, zeros, gains,
clocks, a slope), of seeds on which nothing was chosen.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model import Config, Session
from coman_reduced_model.core.base.stream_names import MOTORS
from coman_reduced_model.core.base.types import Array, Prediction
from coman_reduced_model.errors import ComanError
from coman_reduced_model.sim.worlds import draw_world, record_world
from coman_reduced_model.sim.worlds.draw import plain_kinds


@dataclass(frozen=True)
class Run:
    """Stamps [s], phases (n,), changes of phase as time [s] and new phase (k, 2), errors x, y, z [m]."""

    t: Array
    phase: Array
    changes: Array
    free_run: Array
    ahead: Array


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="*", type=Path)
    parser.add_argument("--worlds", nargs="*", type=int, default=[], help="seeds of worlds that are recorded")
    arguments = parser.parse_args()
    table = Table("recording", "wrenches", "same phase", "changes", "off by [ms]", "free run [mm]", "0.2 s ahead [mm]")
    with tempfile.TemporaryDirectory() as folder:
        bags = [*arguments.bags, *(recorded(seed, Path(folder)) for seed in arguments.worlds)]
        for bag in bags:
            add_rows(table, bag)
    Console(width=150, markup=False).print(table)


def recorded(seed: int, folder: Path) -> Path:
    """The walk of a world with all sensors and with contact switches."""
    world = draw_world(seed, plain_kinds() | {"imperfections": "imperfect", "gait": "test2" if seed % 2 else "test1"})
    world = replace(world, sensors=replace(world.sensors, contact_switches=True))
    record_world(world, folder / f"world_{seed}", seed=seed)
    return folder / f"world_{seed}"


def add_rows(table: Table, bag: Path) -> None:
    """A row for each source that a recording has."""
    measured = predicted(bag, "sensors")
    for source in ("sensors", "torques", "contacts"):
        try:
            run = predicted(bag, source)
        except ComanError as error:
            table.add_row(bag.name, source, *([""] * 4), str(error).partition(": ")[2][:60])
            continue
        same, off = "", ""
        if source != "sensors":
            same = f"{100.0 * np.mean(run.phase == np.interp(run.t, measured.t, measured.phase)):.1f} %"
            distances = 1e3 * np.array([nearest(change, run.changes) for change in measured.changes])
            off = f"{np.median(distances):.1f}, {np.percentile(distances, 90.0):.1f}"
        table.add_row(bag.name, source, same, str(len(run.changes)), off, shown(run.free_run), shown(run.ahead))


def nearest(change: Array, changes: Array) -> float:
    """[s] to the nearest change into the same phase."""
    alike = changes[changes[:, 1] == change[1]] if len(changes) else changes
    return float(np.abs(alike[:, 0] - change[0]).min()) if len(alike) else float("nan")


def predicted(bag: Path, source: str) -> Run:
    """Predict a recording."""
    with Session(bag) as session:
        motors = MOTORS in session.streams.values()
    changes = {"streams.wrench_source": source, "prediction.reference": "motor" if motors else "none"}
    with Session(bag, Config().replaced(changes)) as session:
        predictions = list(session.predictions())
        ahead = session.pipeline.judge.rmse()["0.2"]["published"]
    stamps = np.array([p.stamp_ns for p in predictions])
    t, phase = 1e-9 * (stamps - stamps[0]), np.array([int(p.support.phase) for p in predictions])
    at = np.flatnonzero(np.diff(phase)) + 1
    began = t[at] - np.array([predictions[i].support.phase_time for i in at])
    return Run(t, phase, np.column_stack([began, phase[at]]), rms(predictions), np.asarray(ahead))


def rms(predictions: list[Prediction]) -> Array:
    """(3,) of the residuals [m]."""
    residuals = np.array([p.residual for p in predictions if not p.flags.diverged])
    return np.asarray(np.sqrt(np.nanmean(residuals**2, axis=0)))


def shown(error: Array) -> str:
    """Metres by axis, in mm."""
    return ", ".join(f"{1e3 * value:.2f}" for value in error)


if __name__ == "__main__":
    main()
