# SPDX-License-Identifier: BSD-3-Clause
"""All tasks of an archive: those whose part is there are done; the tables are put together from the parts."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.evaluation.statistics import AXES
from ..errors import OutputError
from ..output import to_json
from ..progress import Progress, between
from ..resources import version
from .change import strongest_change
from .inventory import StoredBag, find_bags
from .local import Outcome, run_locally
from .robots import RobotRow, date_of, period_of, robot_of
from .store import Store
from .tables import VERSION, write_table
from .work import DIED, MEMORY, PARTS, USABLE, BagTask, DiagnosisTask, Row, Settings, Task, died, key_of

ARCHIVE_FILE = "archive.json"
TRAIN, HELD_OUT = 3, 2  # bags of a diagnosis at most


@dataclass(frozen=True)
class Run:
    """What to do with an archive, and where.

    Attributes:
        uris: folders with bags; out: URI of the folder of the results.
        settings: of predictions and diagnoses.
        diagnose: whether the bags of each robot are diagnosed, period by period.
        every: length of a period, `week` or `month`.
        robots: table of robots.
        workers: processes of this machine; address: of a cluster of Ray instead, or empty.
    """

    uris: tuple[str, ...]
    out: str
    settings: Settings
    diagnose: bool = False
    every: str = "month"
    robots: tuple[RobotRow, ...] = ()
    workers: int = 2
    address: str = ""


def run_archive(run: Run, progress: Progress | None = None) -> dict[str, Any]:
    """Do what is not done yet, and write bags.parquet, phases.parquet, findings.parquet.

    Returns:
        Number of bags by status, of tasks done now and before, and the time it took [s].

    Raises:
        ComanError: an archive cannot be read, the results cannot be written, or a worker has another version of the
            package.
    """
    began, report = time.perf_counter(), progress or (lambda fraction, what: None)
    report(0.0, "looking for bags")
    bags = find_bags(run.uris)
    store = Store(run.out)
    _claim(store)
    tasks = [BagTask.named(bag, run.settings, run.out) for bag in bags]
    first = between(report, 0.0, 0.5 if run.diagnose else 1.0)
    parts, now = _parts_of(run, store, tasks, first, "bags")
    rows = [_bag_row(run, task, part) for task, part in zip(tasks, parts, strict=True)]
    findings = [row for bag, part in zip(rows, parts, strict=True) for row in _mismatch_rows(run, bag, part)]
    if run.diagnose:
        groups = diagnoses(run, bags, rows)
        found, more = _parts_of(run, store, groups, between(report, 0.5, 1.0), "diagnoses")
        days = {(row["archive"], row["bag"]): row["date"] for row in rows}
        for group, part in zip(groups, found, strict=True):
            findings += _diagnosis_rows(group, part, days)
        now += more
    write_table(store, "bags", rows)
    write_table(store, "phases", [row for bag, part in zip(rows, parts, strict=True) for row in _phase_rows(bag, part)])
    write_table(store, "findings", sorted(findings, key=_order))
    counts = dict(sorted(Counter(row["status"] for row in rows).items()))
    diagnosed = len(groups) if run.diagnose else 0
    facts = {"schema_version": VERSION, "version": version(), "settings": run.settings.digest(), "every": run.every}
    store.write(ARCHIVE_FILE, (to_json({**facts, "archives": run.uris, "bags": counts}) + "\n").encode())
    return {
        "out": run.out,
        "bags": counts,
        "diagnoses": diagnosed,
        "tasks": now,
        "tasks_done_before": len(tasks) + diagnosed - now,
        "elapsed_s": time.perf_counter() - began,
    }


def diagnoses(run: Run, bags: Sequence[StoredBag], rows: Sequence[Row]) -> list[DiagnosisTask]:
    """For each robot and period, at most five of its usable bags, evenly over it: the last two or less are held out.

    Bags from before and from after a change of the robot's errors are not diagnosed together: an effect that only some
    of them have would be held against it.
    """
    usable = [i for i, row in enumerate(rows) if row["status"] in USABLE and row["date"] and row.get("hash")]
    members: dict[tuple[str, str, bool], list[int]] = {}
    for robot in sorted({rows[i]["robot"] for i in usable}):
        mine = [i for i in usable if rows[i]["robot"] == robot]
        mine.sort(key=lambda i: (rows[i]["date"], rows[i]["start_ns"], i))
        first: dict[str, int] = {}
        for i in mine:
            first.setdefault(rows[i]["hash"], i)
        mine = list(first.values())  # a copy confirms nothing
        changed = _first_after_change([rows[i] for i in mine])
        for number, index in enumerate(mine):
            key = robot, period_of(rows[index]["date"], run.every), number >= changed
            members.setdefault(key, []).append(index)
    tasks = []
    for (robot, period, _), ordered in sorted(members.items()):
        count = min(len(ordered), TRAIN + HELD_OUT)
        chosen = [ordered[round(k * (len(ordered) - 1) / max(count - 1, 1))] for k in range(count)]
        held = min(HELD_OUT, count // 2)
        train, hold = chosen[: count - held], chosen[count - held :]
        hashes = tuple(rows[index]["hash"] for index in chosen)
        fit, rest = ([bags[index] for index in part] for part in (train, hold))
        tasks.append(DiagnosisTask.named((robot, period), fit, rest, hashes, run.settings, run.out))
    return tasks


def _first_after_change(rows: Sequence[Row]) -> int:
    """Index of the first bag of a robot after a change of its errors; behind the last if they have not changed."""
    keys = [f"rmse_{axis}_m" for axis in AXES]
    known = [i for i, row in enumerate(rows) if all((row.get(key) or 0.0) > 0.0 for key in keys)]
    errors = np.array([[rows[i][key] for key in keys] for i in known]).reshape(-1, len(keys))
    change = strongest_change(errors)
    return len(rows) if change is None else known[change.first]


def _claim(store: Store) -> None:
    """Begin or go on with a folder of results.

    Raises:
        OutputError: there is something else in it, or it cannot be written.
    """
    if not store.exists(ARCHIVE_FILE):
        found = [name for name in store.names("") if not name.startswith(".")]
        if found:
            raise OutputError(f"{store.uri}: holds {found[0]} and no {ARCHIVE_FILE}: not the output of coman archive")
        store.write(ARCHIVE_FILE, (to_json({"schema_version": VERSION, "version": version()}) + "\n").encode())


def _parts_of(run: Run, store: Store, tasks: Sequence[Task], report: Progress, what: str) -> tuple[list[Row], int]:
    """The parts of all tasks, in their order, and how many tasks had to be done."""
    there = {f"{PARTS}/{name}" for name in store.names(PARTS)}
    stored = _read(store, [task.part for task in tasks if task.part in there])
    todo = [task for task in tasks if stored.get(task.part, {"status": MEMORY})["status"] == MEMORY]
    for task in todo:
        if task.part in stored:  # it may have more memory now
            store.remove(task.part)
    before, lost = len(tasks) - len(todo), set()
    with closing(_outcomes(run, todo)) as outcomes:
        for count, (task, status) in enumerate(outcomes, before + 1):
            report(count / len(tasks), f"{count} of {len(tasks)} {what}")
            if status == DIED:
                lost.add(task.part)
    stored |= _read(store, [task.part for task in todo if task.part not in lost])
    return [died() if task.part in lost else stored[task.part] for task in tasks], len(todo)


def _read(store: Store, parts: list[str]) -> dict[str, Row]:
    return {name: json.loads(contents) for name, contents in store.read_all(parts).items()}


def _outcomes(run: Run, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
    if not tasks:
        return
    if run.address:
        from .cluster import run_on_ray

        yield from run_on_ray(tasks, run.address, run.workers)
    else:
        yield from run_locally(tasks, run.workers)


def _bag_row(run: Run, task: BagTask, part: Row) -> Row:
    bag, table = task.bag, list(run.robots)
    robot = robot_of(bag.bag, part.get("recorded_robot", ""), run.settings.config.robot.name, table)
    return {
        **part,
        "archive": bag.archive,
        "bag": bag.bag,
        "size_bytes": bag.size,
        "robot": robot,
        "date": date_of(bag.bag, part.get("start_ns"), table),
        "version": version(),
        "settings": run.settings.digest(),
    }


def _phase_rows(bag: Row, part: Row) -> list[Row]:
    return [{**bag, **phase} for phase in part.get("phases", ())]


def _mismatch_rows(run: Run, bag: Row, part: Row) -> list[Row]:
    period = period_of(bag["date"], run.every) if bag["date"] else None
    return [{**bag, "kind": "mismatch", "period": period, **each} for each in part.get("mismatches", ())]


def _diagnosis_rows(task: DiagnosisTask, part: Row, days: dict[tuple[str, str], Any]) -> list[Row]:
    common = {
        "kind": "diagnosis",
        "robot": task.robot,
        "period": task.period,
        "date": min(days[bag.archive, bag.bag] for bag in (*task.train, *task.holdout)),
        "bags": task.bags,
        "hash": key_of(task.hashes),
        "version": version(),
        "settings": task.settings.digest(),
        "status": part["status"],
        "reason": part["reason"],
    }
    return [{**common, **finding} for finding in part["findings"]]


def _order(row: Mapping[str, Any]) -> tuple[str, ...]:
    keys = ("kind", "robot", "date", "archive", "bag", "effect", "place", "sentence")
    return tuple(str(row.get(key) or "") for key in keys)
