# SPDX-License-Identifier: BSD-3-Clause
"""Predicting a bag against only decoding it, and the memory that a long bag takes against a short one.

    python bench/offline.py [--minutes 10] [--trunk without]    # without: the paper's model

The bags are the shipped test1 over and over, its stamps moved on. Each figure comes from a process of its own.
`prediction alone` leaves out start-up (loading compiled code, opening the bag), which a long bag does not feel; it is
measured by the clock and by processor time, which other processes on the machine disturb less.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.resources import bag_path
from coman_reduced_model.topics import DESCRIPTION, TopicNames

ROBOT = TopicNames()(DESCRIPTION)

DECODE = """
import json, sys, time
from coman_reduced_model.bag.reader import open_bag
TOPICS = ["/joint_states", "/motor_states", "/left_foot/wrench", "/right_foot/wrench", "/com/reference"]
began = time.perf_counter()
count = sum(1 for _ in open_bag(sys.argv[1], TOPICS))
print(json.dumps({"seconds": time.perf_counter() - began, "messages": count}))
"""
PREDICT = """
import json, resource, sys, tempfile
from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.offline import predict_bag
config = Config().replaced({"model.trunk_rotation": sys.argv[2]})
with tempfile.TemporaryDirectory() as folder, Session(sys.argv[1], config) as session:
    summary = predict_bag(session, folder + "/out")
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({"seconds": summary["elapsed_s"], "duration": summary["duration_s"], "samples": summary["samples"],
                  "cpu": used.ru_utime + used.ru_stime, "peak_mb": used.ru_maxrss / 1024}))
"""


def repeat(source: Path, target: Path, seconds: float) -> None:
    """The bag `source` again and again for so many seconds; each message but the description begins with its stamp."""
    with Bag(source) as bag:
        topics = {topic: kind for topic, kind in bag.topics.items() if not topic.startswith("/rosout")}
        period = bag.end_ns - bag.start_ns + 5_000_000
        with BagWriter(target, topics, latched=(ROBOT,)) as writer:
            for turn in range(max(1, round(seconds * 1e9 / period))):
                shift = turn * period
                for topic, log_time, raw in bag.raw(list(topics)):
                    if topic == ROBOT:
                        if turn == 0:
                            writer.write_raw(topic, log_time, raw)
                        continue
                    data = bytearray(raw)  # CDR: four bytes of encapsulation, then seconds and nanoseconds
                    stamp = int.from_bytes(data[4:8], "little") * 10**9 + int.from_bytes(data[8:12], "little") + shift
                    data[4:8] = (stamp // 10**9).to_bytes(4, "little")
                    data[8:12] = (stamp % 10**9).to_bytes(4, "little")
                    writer.write_raw(topic, log_time + shift, bytes(data))


def measure(script: str, bag: Path, trunk: str = "") -> dict[str, float]:
    run = subprocess.run([sys.executable, "-c", script, str(bag), trunk], stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(run.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the long bag")
    parser.add_argument("--trunk", choices=("with", "without"), default="with", help="without: the paper's model")
    arguments = parser.parse_args()
    minutes, trunk = arguments.minutes, arguments.trunk
    with tempfile.TemporaryDirectory() as folder:
        short, long = Path(folder) / "short", Path(folder) / "long"
        repeat(bag_path("test1"), short, 60.0)
        repeat(bag_path("test1"), long, 60.0 * minutes)
        decoded, (one, many) = measure(DECODE, short), (measure(PREDICT, bag, trunk) for bag in (short, long))
    alone = (many["duration"] - one["duration"]) / (many["seconds"] - one["seconds"])
    print(f"200 Hz, {one['duration']:.0f} s: {one['duration'] / one['seconds']:.1f} x real time, start-up included")
    cpu = (many["cpu"] - one["cpu"]) / (many["samples"] - one["samples"])
    print(
        f"200 Hz, {many['duration']:.0f} s: {many['duration'] / many['seconds']:.1f} x; prediction alone {alone:.1f} x"
        f" ({1e6 * cpu:.0f} us of processor time a sample: {1 / (200 * cpu):.1f} x)"
    )
    print(f"decoding the short bag alone: {decoded['seconds']:.2f} s, predicting it: {one['seconds']:.2f} s"
          f" (ratio {one['seconds'] / decoded['seconds']:.1f})")  # fmt: skip
    print(
        f"peak memory: {many['peak_mb']:.0f} MB against {one['peak_mb']:.0f} MB"
        f" (ratio {many['peak_mb'] / one['peak_mb']:.2f})"
    )


if __name__ == "__main__":
    main()
