# SPDX-License-Identifier: BSD-3-Clause
"""The monitor on all kinds of worlds: alarms per hour of clean walking, and how soon it detects what begins later.

OUT/predictions/CASE/   the clean walks, as `judge/prediction.py` leaves them; more of them: hours.py
OUT/monitor/SEED.json   a walk in which an effect of medium size begins after 7 to 10 s
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from ..bag.session import Session
from ..core.base.nominal import load_nominal
from ..core.config.files import load_config
from ..errors import ComanError, EngineError
from ..output import to_json, write_file
from ..progress import Progress
from ..resources import version
from ..sim.disturbances import Disturbance, make
from ..sim.worlds import World, draw_world, record_world
from .by_kind import by_kind, by_what_was_learnt
from .cases import data_sheet, kinds_for, times_of
from .families import FAMILIES, LEVELS, draw_effect
from .folder import RunFolder, stored
from .prediction import prediction_rows
from .run import run_all
from .score import rate
from .seeds import commit, summary
from .sudden import beginning

MEDIUM = LEVELS.index("medium")
SECONDS, WITHIN = 17.0, 5.0  # [s] of a walk; after the effect begins, within which a detection counts
ATTEMPTS = 4  # draws until the robot does not fall


@dataclass(frozen=True)
class Onset:
    """A walk in which an effect begins."""

    seed: int
    world: World
    family: str
    after: float  # [s]
    effect: Disturbance
    hidden: dict[str, Any]  # the same, as of an answer
    level: int = MEDIUM  # lower, where medium would be beyond what a walking robot can have


def draw_onset(seed: int, attempt: int = 0, worlds: Mapping[str, str] | None = None, times: float = 1.0) -> Onset:
    """Draw the walk of a seed; families take turns. `attempt`: see draw_case; `times`: see draw_effect."""
    able = families_with_onset()
    family = able[seed % len(able)]
    world = draw_world(seed, kinds_for([family], worlds))
    if attempt:
        world = draw_world(seed + 1_000_003 * attempt, world.kinds)
    rng = np.random.default_rng([23, seed, attempt])
    after = float(rng.uniform(7.0, 10.0))
    values, level = draw_effect(family, rng, MEDIUM, world, times)
    hidden = make(FAMILIES[family].effect, values)
    effect = beginning(hidden, after)
    assert effect is not None
    return Onset(seed, replace(world, duration_s=SECONDS), family, after, effect, hidden.to_dict(), level)


def families_with_onset() -> list[str]:
    """Families whose effect can begin in mid-walk."""
    world, rng = draw_world(0), np.random.default_rng(0)
    return [
        name
        for name, family in FAMILIES.items()
        if beginning(make(family.effect, draw_effect(name, rng, MEDIUM, world)[0]), 1.0) is not None
    ]


def run_onsets(
    out: str | Path, seeds: Sequence[int], jobs: int = 1, progress: Progress | None = None, **fixed: Any
) -> None:
    """Record and watch one walk a seed; what exists is kept.

    Raises:
        OutputError: `out` cannot be written.
    """
    folder = RunFolder(Path(out).absolute())
    (folder.out / "monitor").mkdir(parents=True, exist_ok=True)
    run_all(_watch_seed, [(folder, seed, fixed) for seed in seeds], jobs, progress, "walks with an onset")


def _watch_seed(folder: RunFolder, seed: int, fixed: Mapping[str, Any]) -> None:
    target = folder.out / "monitor" / f"{seed}.json"
    if stored(target) is not None:
        return
    for attempt in range(ATTEMPTS):
        onset = draw_onset(seed, attempt, **fixed)

        def draw(times: Sequence[float], attempt: int = attempt) -> tuple[Sequence[dict[str, Any]], Sequence[str]]:
            drawn = draw_onset(seed, attempt, times=times[0] if times else 1.0, **fixed)
            return [drawn.hidden], [LEVELS[drawn.level]]

        (times,) = times_of(onset.world, draw, seed)
        onset = draw_onset(seed, attempt, times=times, **fixed)
        with tempfile.TemporaryDirectory() as temporary:
            found = watch(onset, Path(temporary) / "walk")
        if not found["fell"]:
            break
    write_file(target, to_json({**found, "attempt": attempt}))


def watch(onset: Onset, bag: Path) -> dict[str, Any]:
    """Record a walk and run the monitor on it: detections, in seconds after the effect began."""
    row: dict[str, Any] = {
        "seed": onset.seed,
        "family": onset.family,
        "worlds": {**onset.world.kinds, "length": f"{SECONDS:g} s"},
        "lowered": onset.level < MEDIUM,
        "fell": False,
        "failed": "",
        "detections": [],
    }
    config = bag.with_suffix(".yaml")
    config.write_text(data_sheet(onset.world), encoding="utf-8")
    try:
        row["fell"] = record_world(onset.world, bag, [onset.effect], onset.seed).fallen_s is not None
        _, found = detections(bag, config)
        row["detections"] = [{"after_s": time - onset.after, "channel": channel} for channel, time in found]
    except EngineError:
        row["fell"] = True
    except ComanError as error:
        row["failed"] = str(error).replace(str(bag.parent), "")
    return row


def detections(bag: Path, config: Path) -> tuple[float, list[tuple[str, float]]]:
    """Length of a recording [s]; of each channel that detects something, its name and when it first does [s].

    Raises:
        ComanError: the recording cannot be used.
    """
    with Session(bag, load_config(config).replaced({"prediction.horizons": []})) as session:
        for _ in session.predictions():
            pass
        monitor, start_ns = session.pipeline.monitor, session.bag.start_ns
        assert monitor is not None
        first = [(each.channel, (each.detected_ns - start_ns) * 1e-9) for each in monitor.first.values()]
        return session.bag.duration_s, first


def score_monitor(
    out: str | Path, names: Sequence[str], seeds: Sequence[int], long: Sequence[Mapping[str, Any]] = ()
) -> dict[str, Any]:
    """Alarms on the clean walks and delays of detections, by kind of world; writes OUT/monitor.json.

    Args:
        out: folder of the run.
        names: of the clean cases, predicted before.
        seeds: of the walks with an onset.
        long: more clean walks, of `hours.run_hours`.
    """
    folder = RunFolder(Path(out).absolute())
    clean = [*prediction_rows(folder, names), *long]
    onsets = [stored(folder.out / "monitor" / f"{seed}.json") for seed in seeds]
    nominal = load_nominal()
    result = {
        "version": version(),
        "commit": folder.begun or commit(),
        "seeds": summary("worlds", seeds),
        "took": folder.took("monitor"),
        "learnt": {
            "alarms": by_what_was_learnt(clean, nominal, alarms, "monitor"),
            "delays": by_what_was_learnt(onsets, nominal, delays, "monitor"),
        },
        "alarms": alarms(clean),
        "alarms_by_kind": by_kind(clean, alarms),
        "delays": delays(onsets),
        "delays_by_kind": by_kind(onsets, delays),
        "delays_by_family": {
            family: delays([row for row in onsets if row["family"] == family])
            for family in sorted({row["family"] for row in onsets})
        },
        "onsets": onsets,
    }
    write_file(folder.out / "monitor.json", to_json(result))
    return result


def alarms(walks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Hours of clean walking, alarms in an hour, walks with an alarm, channels that raise them.

    In a walk a channel counts once. The 95 % interval of alarms in an hour is that of a Poisson process, as if they
    came one by one; several channels may alarm at one cause.
    """
    good = [walk for walk in walks if not walk["failed"]]
    hours = sum(walk["seconds"] for walk in good) / 3600.0
    channels = [channel for walk in good for channel in walk["alarms"]]
    counts = {channel: channels.count(channel) for channel in set(channels)}
    return {
        "hours": hours,
        "alarms_per_hour": len(channels) / hours if hours else None,
        "interval_per_hour": [limit / hours for limit in _poisson_interval(len(channels))] if hours else None,
        "walks_with_alarm": rate(sum(bool(walk["alarms"]) for walk in good), len(good)),
        "failed": len(walks) - len(good),
        "channels": dict(sorted(counts.items(), key=lambda item: -item[1])),
        "redrawn": sum(walk["attempt"] > 0 for walk in walks),
    }


def _poisson_interval(count: int) -> tuple[float, float]:
    """Exact 95 % interval of the mean of a Poisson distribution, from one count (Garwood 1936)."""
    low = 0.5 * chi2.ppf(0.025, 2 * count) if count else 0.0
    return float(low), float(0.5 * chi2.ppf(0.975, 2 * count + 2))


def delays(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Share of effects that are detected within 5 s, and the median delay; walks with an earlier alarm.

    The delay of an effect that is not detected is infinite; the median is null where most are not.

    A walk with an alarm before its effect begins, or whose robot fell, says nothing about the delay.
    """
    watched = [row for row in rows if not (row["fell"] or row["failed"])]
    quiet = [row for row in watched if not any(each["after_s"] < 0.0 for each in row["detections"])]
    first = [min((each["after_s"] for each in row["detections"]), default=np.inf) for row in quiet]
    within = [delay for delay in first if delay < WITHIN]
    median = float(np.median(first)) if first else np.inf
    return {
        "walks": len(rows),
        "fell": sum(row["fell"] for row in rows),
        "failed": sum(bool(row["failed"]) for row in rows),
        "redrawn": sum(row["attempt"] > 0 for row in rows),
        "lowered": sum(row.get("lowered", False) for row in rows),  # not in rows of earlier versions
        "alarm_before": len(watched) - len(quiet),
        "detected": rate(len(within), len(quiet)),
        "median_s": median if np.isfinite(median) else None,
    }
