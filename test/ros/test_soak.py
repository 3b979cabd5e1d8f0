# SPDX-License-Identifier: BSD-3-Clause
"""Predictors under fire: nodes and participants killed, streams cut, delayed, twice, in bursts, clocks that jump.

One node lives from the beginning to the end. Every minute another one and a listener are started and killed, and the
participant that publishes leaves and comes back. `make soak` runs it for an hour (COMAN_SOAK, in seconds). Each
prediction that was published is what the pipeline makes of the same messages, and each message is counted as used,
rejected or late.
"""

from __future__ import annotations

import importlib
import os
import random
import signal
import struct
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComPrediction
from fuzz_tools import walk
from ros_testing import Peer, numbers, robot_urdf, stamp_of
from std_msgs.msg import String

from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.messages import INPUT_TYPES, prediction_to
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.topics import DESCRIPTION, INPUT_TOPICS

pytestmark = pytest.mark.ros
SECONDS = float(os.environ.get("COMAN_SOAK", "8"))
SHORT, MINUTE = 4.0, 60.0  # [s] between two kills: in `make test`, and in a long run
FASTER = 5.0  # times real time: 200 Hz become 1 kHz
SETTLED = 2.0  # [s] in which readers of a node find all new publishers, on a busy machine too
AHEAD = 100  # messages: many more overflow the transport, which sends some again, after those of other topics
JUMPS = (0, 10_000_000_000, -10_000_000_000)
GROWTH = 30.0  # [MB] of resident memory after the first segment
VETERAN = "veteran/com/prediction"
LISTENER = """
import rclpy
from coman_reduced_model_msgs.msg import ComPrediction
from coman_reduced_model.ros.interface import qos
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(ComPrediction, "com/prediction", lambda raw: None, qos.prediction_output(), raw=True)
rclpy.spin(node)
"""


def under_fire(seed: int, seconds: float) -> list[tuple[str, bytes]]:
    """Messages of the shipped walk over and over, with faults; each lap begins with another clock."""
    rng, (_, messages) = random.Random(seed), walk()
    result: list[tuple[str, bytes]] = []
    shift, lap = 0, stamp(messages[-1][1]) - stamp(messages[0][1]) + 1_000_000_000
    streams = sorted({stream for stream, _ in messages})
    for k in range(max(1, round(seconds * FASTER / 12.0))):
        shift += (lap if k else 0) + JUMPS[(k + seed) % 3]
        cut = {stream: rng.randrange(len(messages)) for stream in streams}
        delayed, since, by = rng.choice(streams), rng.randrange(len(messages)), rng.randrange(100, 400)
        arrivals: list[tuple[int, str, bytes]] = []
        for i, (stream, raw) in enumerate(messages):
            if cut[stream] <= i < cut[stream] + 600 and rng.random() < 0.9:
                continue
            at = i + (by if stream == delayed and since <= i < since + 1500 else 0)
            at += rng.randrange(30) if rng.random() < 0.01 else 0
            arrivals += [(at, stream, moved(raw, shift))] * (2 if rng.random() < 0.01 else 1)
        arrivals.sort(key=lambda each: each[0])
        result += [(stream, raw) for _, stream, raw in arrivals]
    return result


def stamp(raw: bytes) -> int:
    sec, nanosec = struct.unpack_from("<iI", raw, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


def moved(raw: bytes, by_ns: int) -> bytes:
    data = bytearray(raw)
    struct.pack_into("<iI", data, 4, *divmod(stamp(raw) + by_ns, 1_000_000_000))
    return bytes(data)


def resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024.0


class Expected:
    """What the pipeline of a node makes of what was sent to it: stamp and numbers of each prediction."""

    def __init__(self, types) -> None:
        self.pipeline = Pipeline(walk()[0], Config())
        self._decoders = {stream: decoder(stream) for stream in INPUT_TYPES}
        self._types = types
        self.predictions: list = []

    def feed(self, messages) -> list[int]:
        """How many predictions there are after each of these messages, which are of one segment."""
        self.predictions, counts = [], []
        for stream, raw in messages:
            found = self.pipeline.feed(stream, raw, self._decoders[stream])
            self.predictions += [(each.stamp_ns, numbers(prediction_to(self._types, each))) for each in found]
            counts.append(len(self.predictions))
        return counts


@dataclass
class Figures:
    """What the run has seen, for the page of results."""

    totals: Counter = field(default_factory=Counter)
    memory_mb: list[float] = field(default_factory=list)  # of the node that lives on, after each segment
    p50_ms: list[float] = field(default_factory=list)
    p99_ms: list[float] = field(default_factory=list)


@pytest.mark.timeout(120 + 20 * SECONDS)
def test_predictions_under_fire_are_those_of_the_pipeline(start, nodes_compiled, ros_domain, record_property):
    begin, seed, figures = time.monotonic(), 0, Figures()
    remap = ("-r", "__node:=veteran", "-r", f"com/prediction:={VETERAN}")
    veteran, expected = start("predictor", "--ros-args", *remap, *options()), None
    length = SHORT
    while seed < 2 or time.monotonic() < begin + SECONDS:
        peer, began = Peer(), time.monotonic()
        try:
            expected = expected or Expected(peer.types)
            segment(start, peer, expected, under_fire(seed, length), figures)
        finally:
            peer.close()
        if SECONDS > MINUTE:  # as much as this machine gets through in a minute, 60 s of messages at most
            length = min(max(SHORT, MINUTE * length / (time.monotonic() - began)), MINUTE)
        figures.memory_mb.append(resident_mb(veteran.pid))
        seed += 1
    status = expected.pipeline.status()
    figures.totals["late"] = sum(each.late for each in status.streams.values())
    figures.totals["rejected"] = sum(status.rejected.values())
    for name, value in {**figures.totals, "segments": seed, "seconds_long": round(time.monotonic() - begin)}.items():
        record_property(name, value)
    for name in ("memory_mb", "p50_ms", "p99_ms"):
        record_property(name, " ".join(f"{each:.3f}" for each in getattr(figures, name)))
    record_property("reasons", ", ".join(f"{reason} {n}" for reason, n in sorted(status.rejected.items())))
    assert figures.totals["late"] and figures.totals["rejected"] and figures.totals["killed_compared"]
    assert figures.memory_mb[-1] - figures.memory_mb[0] < GROWTH, figures.memory_mb
    if seed >= 9:
        early, late = (float(np.median(part)) for part in np.array_split(figures.p50_ms, 3)[::2])
        assert late < 2.0 * early, figures.p50_ms


def options() -> list[str]:
    reliable = [f"qos_overrides./{topic}.subscription.reliability:=reliable" for topic in INPUT_TOPICS.values()]
    return [part for each in (*reliable, "output.diagnostics_rate:=2.0") for part in ("-p", each)]


def segment(start, peer, expected, messages, figures):
    """Until a node is killed: two nodes and a listener, messages of one participant."""
    rng = random.Random(len(messages))
    counts, fresh = expected.feed(messages), Expected(peer.types)
    killed_at = rng.randrange(len(messages) // 2, len(messages))
    counts_fresh = fresh.feed(messages[:killed_at])
    node = start("predictor", "--ros-args", *options())
    listener = start(sys.executable, "-c", LISTENER)
    received = {"veteran": [], "killed": peer.predictions}
    peer.node.create_subscription(ComPrediction, VETERAN, received["veteran"].append, qos.prediction_output())
    publishers = {}
    for stream, kind in INPUT_TYPES.items():
        package, _, short = kind.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), short)
        publishers[stream] = peer.publisher(message_type, INPUT_TOPICS[stream])
    description = peer.publisher(String, DESCRIPTION, qos.latched())
    description.publish(String(data=robot_urdf()))
    peer.wait(lambda: all(p.get_subscription_count() >= 2 for p in publishers.values()), "both nodes subscribe")
    peer.wait(lambda: peer.node.count_publishers(VETERAN) and peer.node.count_publishers("com/prediction"), "publish")
    peer.spin(SETTLED)
    awaited = [("veteran", counts), ("killed", counts_fresh)]
    send(peer, publishers, messages, 0, killed_at, received, awaited, rng)
    node.send(signal.SIGKILL)
    listener.send(signal.SIGKILL)
    received["killed"] = list(peer.predictions)
    send(peer, publishers, messages, killed_at, len(messages), received, awaited[:1], rng)
    wanted = expected.predictions
    peer.wait(lambda: len(received["veteran"]) >= len(wanted), f"{len(wanted)} predictions")
    same(received["veteran"], wanted)
    same(received["killed"], fresh.predictions[: len(received["killed"])])
    counted(peer, expected.pipeline.status())
    figures.totals["messages"] += len(messages)
    figures.totals["compared"] += len(wanted)
    figures.totals["killed_compared"] += len(received["killed"])
    latency = peer.statuses["veteran: latency"][2]
    figures.p50_ms.append(float(latency.get("p50 [ms]", "nan")))
    figures.p99_ms.append(float(latency.get("p99 [ms]", "nan")))
    sent = f"{len(messages)} messages, {len(wanted)} and {len(received['killed'])} predictions as offline"
    print(f"{sent}; p50 {figures.p50_ms[-1]} ms", flush=True)


def same(published, wanted):
    """Stamps, and numbers to 1e-9."""
    assert [stamp_of(each) for each in published] == [each for each, _ in wanted]
    if published:
        found = np.concatenate([numbers(each) for each in published])
        np.testing.assert_allclose(found, np.concatenate([values for _, values in wanted]), rtol=0, atol=1e-9)


def send(peer, publishers, messages, first, end, received, awaited, rng):
    """At five times the real rate, in bursts now and then, and never far ahead of the nodes."""
    period, due = 1.0 / (5.0 * 200.0 * FASTER), time.monotonic()
    for k in range(first, end):
        stream, raw = messages[k]
        publishers[stream].publish(raw)
        due += period
        if k < 100:  # until the readers of all topics have found these new publishers
            peer.spin(0.02)
            due = time.monotonic()
        if k % 20 == 0 and rng.random() < 0.9:
            peer.spin(max(0.0, due - time.monotonic()))
        if k % AHEAD == AHEAD - 1:
            for name, counts in awaited:
                least = counts[max(0, k - AHEAD)]
                peer.wait(lambda n=name, m=least: len(received[n]) >= m, f"{least} predictions of the {name} node")


def counted(peer, status):
    """Each message that was sent was received, and used, rejected for the reason that the pipeline has, or late."""

    def agrees() -> bool:
        values = peer.statuses.get("veteran: input", (0, "", {}))[2]
        rejected = {k.removeprefix("rejected: "): int(v) for k, v in values.items()
                    if k.startswith("rejected: ") and not k.endswith(": last")}  # fmt: skip
        streams = {name: tuple(int(values.get(f"{name}: {what}", 0)) for what in ("received", "accepted", "late"))
                   for name in status.streams}  # fmt: skip
        wanted = {name: (each.received, each.accepted, each.late) for name, each in status.streams.items()}
        return (rejected, streams) == (status.rejected, wanted)

    peer.wait(agrees, f"counters {status.rejected} {status.streams}")
    for name, each in status.streams.items():
        lost = sum(n for key, n in status.rejected.items() if key.rpartition("/")[0] == name)
        waits = 1 if each.received != each.accepted + lost else 0  # the last stamp may still be in doubt
        assert each.received == each.accepted + lost + waits
