# SPDX-License-Identifier: BSD-3-Clause
"""500 bags of ten robots over fifty weeks: what an archive costs, what a killed worker costs, what the report finds.

Each robot is a specimen of its own (springs, dampers and masses some percent off) and is recorded twice on the virtual
robot, in two gaits; `robot_07` twice more with a hidden effect. A bag of a week is a window of 5 s of one of these
recordings, drawn by seed, its stamps moved into that week: bags of one robot and gait overlap, so the spread between
weeks is smaller than that of real recordings. In the second half `robot_07` has the effect. One bag in a hundred is cut
off in its middle or has lost its contents.

    python bench/archive.py                       # the page, archive.md, with its picture
    python bench/archive.py --make DIR            # only the bags; --made DIR measures on them later
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from markdown import table
from matplotlib.figure import Figure

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.sim.disturbances import Scatter, parse
from coman_reduced_model.sim.record import record

COMAN = [sys.executable, "-m", "coman_reduced_model.cli.main", "archive"]
RUNNER = "by processes of this machine, without Ray"
WORKERS, FEW = (1, 2, 3), 3  # how many processes, over the bags of how many robots
ROBOTS, WEEKS = 10, 50
ODD, EFFECT = 7, "encoder_bias:where=LAnkSag,bias=0.01"
GAITS = ("test1", "test2")
RECORDED_S, WINDOW_S = 9.0, 5.0
FIRST = datetime(2026, 3, 2, 9, 0, tzinfo=timezone.utc)  # a Monday
DESCRIPTION = "/robot_description"


def main() -> None:
    """Make the bags, measure, print the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--make", type=Path, help="make the bags here, and nothing else")
    parser.add_argument("--made", type=Path, help="take the bags that --make made here")
    parser.add_argument("--picture", type=Path, help="where the plot goes")
    arguments = parser.parse_args()
    if arguments.make:
        make(arguments.make)
        return
    with tempfile.TemporaryDirectory() as folder:
        if arguments.made is None:
            make(Path(folder))
        print(measured((arguments.made or Path(folder)) / "walks", Path(folder), arguments.picture))


def make(folder: Path) -> None:
    """The bags, as folder/walks/ROBOT/DAY_GAIT."""
    draw, walks = random.Random(30), folder / "walks"
    bags = []
    for number in range(ROBOTS):
        sources = {}
        for hidden in (False, True) if number == ODD else (False,):
            for gait in GAITS:
                source = folder / "recorded" / f"{number}_{gait}_{hidden}"
                effects = [Scatter(number), *([parse(EFFECT)] if hidden else [])]
                record(gait, source, disturbances=effects, seed=number, duration_s=RECORDED_S)
                sources[hidden, gait] = source
        for week in range(WEEKS):
            hidden = number == ODD and week >= WEEKS // 2
            source = sources[hidden, GAITS[week % 2]]
            stamp = FIRST + timedelta(weeks=week, hours=number, minutes=draw.randrange(60))
            bag = walks / f"robot_{number:02d}" / f"{stamp:%Y-%m-%d}_{GAITS[week % 2]}"
            bag.parent.mkdir(parents=True, exist_ok=True)
            window(source, bag, stamp, draw.uniform(0.0, RECORDED_S - WINDOW_S - 1.0))
            bags.append(bag)
    damaged = draw.sample(bags, max(1, len(bags) // 100))
    for i, bag in enumerate(damaged):
        (file,) = bag.glob("*.mcap")
        contents = file.read_bytes()
        file.write_bytes(contents[: len(contents) // 2] if i % 2 else b"\0" * len(contents))


def window(source: Path, target: Path, begins: datetime, skip_s: float) -> None:
    """Copy 5 s of a bag, with the stamps as if they had been recorded at another time."""
    with Bag(source) as bag:
        first = bag.start_ns + round(skip_s * 1e9)
        last, shift = first + round(WINDOW_S * 1e9), round(begins.timestamp() * 1e9) - first
        with BagWriter(target, bag.topics, (DESCRIPTION,)) as out:
            for topic, log_time, raw in bag.raw(bag.topics):
                if topic == DESCRIPTION:
                    out.write_raw(topic, first + shift, raw)
                elif first <= log_time < last:
                    out.write_raw(topic, log_time + shift, moved(raw, shift))


def moved(raw: bytes, shift_ns: int) -> bytes:
    """A serialised message that begins with a header, at another time."""
    message = bytearray(raw)
    seconds, nanoseconds = struct.unpack_from("<iI", message, 4)  # after the four bytes that say how it is encoded
    struct.pack_into("<iI", message, 4, *divmod(seconds * 10**9 + nanoseconds + shift_ns, 10**9))
    return bytes(message)


@dataclass(frozen=True)
class Cost:
    """Of a command: wall time and processor time of all its processes [s], and what it printed."""

    wall: float
    processor: float
    result: dict[str, Any]


def measured(walks: Path, folder: Path, picture: Path | None) -> str:
    """The page."""
    few = [walks / f"robot_{number:02d}" for number in range(FEW)]
    archive([walks / "robot_00"], folder / "warm", "--workers", "1")  # what is read from disk for the first time
    load = os.getloadavg()[0]
    costs = {workers: archive(few, folder / f"by_{workers}", "--workers", str(workers)) for workers in WORKERS}
    redone, same = killed(few, folder / "killed", folder / "by_1")
    few_again = archive(few, folder / "by_1")  # with nothing to do
    everything = archive([walks], folder / "all", "--diagnose")
    again = archive([walks], folder / "all", "--diagnose")
    report = json.loads(run([*COMAN, "report", str(folder / "all"), "--json"]))
    if picture is not None:
        draw(costs, picture)
    bags = FEW * WEEKS
    return "\n\n".join([
        scaling(costs, bags, load),
        kill_words(redone, bags, same),
        found_words(everything, again, report),
        arithmetic(costs[1].processor / bags, everything, listing(again, few_again), efficiency(costs)),
    ])  # fmt: skip


def archive(walks: Sequence[Path], out: Path, *options: str) -> Cost:
    """`coman archive` of some bags."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    found = json.loads(run([*COMAN, *map(str, walks), "--predict", "--out", str(out), "--json", *options]))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(time.perf_counter() - began, processor, found)


def run(command: Sequence[str]) -> str:
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout


def killed(walks: Sequence[Path], out: Path, undisturbed: Path) -> tuple[list[int], bool]:
    """Kill a worker after a third of the bags and the command after two thirds, and start it again.

    Returns:
        Number of parts when the worker was killed, when the command was killed, and made by the second command; whether
        its tables are those of a run that nobody disturbed.
    """
    total = len([*undisturbed.glob("parts/*.json")])
    command = [*COMAN, *map(str, walks), "--predict", "--out", str(out)]
    counts = []
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        for share in (1 / 3, 2 / 3):
            while len([*out.glob("parts/*.json")]) < share * total and process.poll() is None:
                time.sleep(0.05)
            counts.append(len([*out.glob("parts/*.json")]))
            if share < 0.5:
                found = subprocess.run(["pgrep", "-P", str(process.pid), "-f", "spawn_main"], stdout=subprocess.PIPE)
                os.kill(int(found.stdout.split()[0]), signal.SIGKILL)
        process.kill()
    counts.append(archive(walks, out).result["tasks"])
    tables = [f"{name}.parquet" for name in ("bags", "phases", "findings")]
    return counts, all((out / name).read_bytes() == (undisturbed / name).read_bytes() for name in tables)


def listing(many: Cost, few: Cost) -> float:
    """Time a bag [s] to list bags and to put the tables together, by two runs with nothing else to do."""
    bags, fewer = (sum(cost.result["bags"].values()) for cost in (many, few))
    return max((many.wall - few.wall) / (bags - fewer), 0.0)


def efficiency(costs: dict[int, Cost]) -> float:
    """From one worker to two, by wall time."""
    return costs[1].wall / (2.0 * costs[2].wall)


def scaling(costs: dict[int, Cost], bags: int, load: float) -> str:
    rows = [
        [str(workers), f"{cost.wall:.0f}", f"{cost.processor:.0f}", f"{60.0 * bags / cost.wall:.0f}",
         f"{costs[1].wall / (workers * cost.wall):.2f}", f"{costs[1].processor / cost.processor:.2f}"]
        for workers, cost in costs.items()
    ]  # fmt: skip
    slope = np.polyfit(np.log([1, 2]), np.log([bags / costs[n].wall for n in (1, 2)]), 1)[0]
    head = [
        "workers",
        "time [s]",
        "processor time [s]",
        "bags a minute",
        "efficiency",
        "processor time of one worker / this",
    ]
    return "\n\n".join([
        "## Over workers",
        f"{bags} bags of {WINDOW_S:.0f} s of {FEW} robots, predicted (`--predict`) {RUNNER}, start of all "
        f"processes included; two cores, load average before it {load:.1f}. Efficiency: time of one worker / "
        "(workers x time); it is only as good as the cores were free. The last column does not depend on that: what "
        "more workers cost.",
        table(head, rows),
        f"Bags a minute grow with the number of workers to the power {slope:.2f}, from one to two.",
        "![Bags a minute over the number of workers](archive.png)",
    ])  # fmt: skip


def kill_words(redone: list[int], bags: int, same: bool) -> str:
    first, second, last = redone
    return "\n\n".join([
        "## Killed",
        f"Two workers, {bags} bags: one worker killed (SIGKILL) when {first} were done, the command when "
        f"{second} were. "
        f"Started again, it did the {last} that were missing. The tables are "
        f"{'the same bytes as' if same else '**not** those'} of a run by one worker that nobody disturbed.",
    ])  # fmt: skip


def found_words(everything: Cost, again: Cost, report: dict[str, Any]) -> str:
    bags = sum(everything.result["bags"].values())
    states = ", ".join(f"{count} {status}" for status, count in everything.result["bags"].items())
    truth = FIRST + timedelta(weeks=WEEKS // 2)
    lines = [*report["changes"], *report["effects"], *(f"to look at: {line}" for line in report["look_at"][:5])]
    return "\n\n".join([
        "## What the report says",
        f"{bags} bags ({states}; {max(1, bags // 100)} damaged on purpose), "
        f"{everything.result['diagnoses']} diagnoses month by month: "
        f"{everything.wall:.0f} s with two workers, {everything.processor:.0f} s of processor time; again with nothing "
        f"to do {again.wall:.1f} s. Hidden: `{EFFECT}` in robot_{ODD:02d} from {truth:%Y-%m-%d} "
        f"(week {truth:%G-W%V}) on. "
        "`coman archive report`:",
        "```text\n" + "\n".join(textwrap.fill(line, 150, subsequent_indent="    ") for line in lines) + "\n```",
    ])  # fmt: skip


def of_a_diagnosis(everything: Cost, per_bag: float) -> float:
    """Processor time [s] of one diagnosis: what a run took beside predictions of `per_bag` [s] each."""
    bags = sum(everything.result["bags"].values())
    return (everything.processor - bags * per_bag) / everything.result["diagnoses"]


def arithmetic(per_bag: float, everything: Cost, restart_per_bag: float, efficiency_of_two: float) -> str:
    """What many bags cost, by processor time of a prediction [s] and what a run with diagnoses took."""
    nodes, cores, bags = 64, 16, 100_000
    per_diagnosis = of_a_diagnosis(everything, per_bag)
    diagnoses = bags * everything.result["diagnoses"] / sum(everything.result["bags"].values())
    work = bags * per_bag + diagnoses * per_diagnosis
    seconds = work / (nodes * cores * min(efficiency_of_two, 1.0))
    return "\n\n".join([
        "## 100,000 bags on 64 nodes",
        f"By arithmetic, from what was measured {RUNNER}: {per_bag:.2f} s of processor time to predict a bag "
        f"of {WINDOW_S:.0f} s, {per_diagnosis:.1f} s for a diagnosis (what the run above took beside its predictions), "
        f"{bags:,} bags, {diagnoses:,.0f} diagnoses (as many a bag as above), {nodes} nodes of {cores} cores like "
        f"these, efficiency as above: {bags * per_bag / 3600:.0f} core hours for predictions and "
        f"{diagnoses * per_diagnosis / 3600:.0f} for diagnoses, {seconds / 60:.1f} minutes of all nodes. "
        "One process lists the bags and puts the tables together: "
        f"{bags * restart_per_bag / 60:.0f} minutes, by the {1e3 * restart_per_bag:.0f} ms a bag more that a run with "
        "nothing to do takes for all bags than for few. What Ray, an object store and the network take is not in it. "
        "Longer bags cost more in proportion, apart from the start.",
    ])  # fmt: skip


def draw(costs: dict[int, Cost], target: Path) -> None:
    figure = Figure((6.4, 3.2), layout="constrained")
    ax = figure.subplots()
    rates = {workers: costs[1].wall / cost.wall for workers, cost in costs.items()}
    ax.plot([1, max(rates)], [1, max(rates)], ":", color="#5b606b", label="efficiency 1")
    ax.plot([*rates], [*rates.values()], "o-", color="#d55e00", label="measured")
    ax.set(xlabel="workers", ylabel="speed, one worker = 1", xticks=[*rates])
    ax.grid(color="#d9dce3", linewidth=0.6)
    ax.legend(frameon=False)
    figure.savefig(target, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
