# SPDX-License-Identifier: BSD-3-Clause
"""Hours of clean walking for the monitor: long walks of the worlds of seeds in turn, whose recordings are not kept.

    OUT/hours/SEED_ROUND.json   a walk: its world, seconds walked, alarms; `failed` and why, if it says nothing

A round goes through the worlds of all seeds; with each round a world takes the next gait and other noise.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ComanError, EngineError
from ..output import to_json, write_file
from ..progress import Progress
from ..sim.worlds import World, draw_world, record_world
from ..sim.worlds.kinds import GAITS
from .cases import ATTEMPTS, data_sheet
from .folder import RunFolder, stored
from .monitor import detections
from .run import run_all

LONG_S = 120.0  # of a walk
FALLS = "it falls"


def run_hours(
    out: str | Path,
    seeds: Sequence[int],
    hours: float,
    jobs: int = 1,
    progress: Progress | None = None,
    worlds: Mapping[str, str] | None = None,
) -> list[dict[str, Any]]:
    """Record and watch clean walks until `hours` were walked; what exists is kept, and counts.

    Returns:
        A row for each walk, as `prediction_rows` has them. Less is walked only if all walks of a round fail.
    """
    folder = RunFolder(Path(out).absolute()).out / "hours"

    def task(number: int) -> tuple[Path, int, int, Mapping[str, str] | None]:
        seed, round_ = seeds[number % len(seeds)], number // len(seeds)
        return folder / f"{seed}_{round_}.json", seed, round_, worlds

    rows: list[dict[str, Any]] = []
    while True:
        while (row := stored(task(len(rows))[0])) is not None:
            rows.append(row)
        missing = hours - sum(row["seconds"] for row in rows) / 3600.0
        if missing <= 0.0 or (len(rows) >= len(seeds) and all(row["failed"] for row in rows[-len(seeds) :])):
            return rows
        tasks = [task(len(rows) + more) for more in range(math.ceil(missing * 3600.0 / LONG_S))]
        run_all(_walk, tasks, jobs, progress, "long walks")


def draw_walk(seed: int, round_: int, attempt: int = 0, worlds: Mapping[str, str] | None = None) -> World:
    """The world of a walk. `attempt`: see cases.draw_case."""
    kinds, gaits = draw_world(seed, worlds).kinds, list(GAITS)
    if "gait" not in (worlds or {}):
        kinds["gait"] = gaits[(gaits.index(kinds["gait"]) + round_) % len(gaits)]
    world = draw_world(seed + 1_000_003 * attempt, kinds)
    return replace(world, duration_s=LONG_S, kinds={**kinds, "length": f"{LONG_S:g} s"})


def _walk(target: Path, seed: int, round_: int, worlds: Mapping[str, str] | None) -> None:
    if stored(target) is not None:
        return
    for attempt in range(ATTEMPTS):
        world = draw_walk(seed, round_, attempt, worlds)
        noise = int(np.random.default_rng([29, seed, round_]).integers(2**31))
        row = {"seed": seed, "worlds": world.kinds, "attempt": attempt, **_watched(world, noise)}
        if row["failed"] != FALLS:
            break
    write_file(target, to_json(row))


def _watched(world: World, noise: int) -> dict[str, Any]:
    """Seconds and alarms of a walk; `failed`: the robot falls, or its recording cannot be used."""
    seconds, alarms, failed = 0.0, [], ""
    with tempfile.TemporaryDirectory() as temporary:
        bag, config = Path(temporary) / "walk", Path(temporary) / "robot.yaml"
        config.write_text(data_sheet(world), encoding="utf-8")
        try:
            if record_world(world, bag, seed=noise, store=False).fallen_s is not None:
                failed = FALLS
            else:
                seconds, found = detections(bag, config)
                alarms = [channel for channel, _ in found]
        except EngineError:
            failed = FALLS
        except ComanError as error:
            failed = str(error).replace(temporary, "")
    return {"failed": failed, "seconds": seconds, "alarms": alarms}
