# SPDX-License-Identifier: BSD-3-Clause
"""A running predictor under fire: killed and started again, streams cut, late, twice, in bursts, clocks that jump.

`make soak` runs it for an hour (COMAN_SOAK, in seconds). Each prediction that was published is what the pipeline makes
of the same messages, and each message is counted.
"""

from __future__ import annotations

import os
import random
import signal
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from fuzz_tools import walk
from ros_testing import numbers, robot_urdf, stamp_of
from std_msgs.msg import String

from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.messages import INPUT_TYPES, prediction_to
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.topics import DESCRIPTION, INPUT_TOPICS

pytestmark = pytest.mark.ros
SECONDS = float(os.environ.get("COMAN_SOAK", "12"))
SEGMENT = 60.0 if SECONDS > 60.0 else 5.0  # [s] between two kills
FASTER = 5.0  # times real time: 200 Hz become 1 kHz
JUMPS = (0, 10_000_000_000, -10_000_000_000)
GROWTH = 100.0  # [MB] of resident memory within a segment


def under_fire(seed: int, seconds: float) -> list[tuple[str, bytes]]:
    """Messages of the shipped walk over and over, with faults; each lap begins with another clock."""
    rng, (_, messages) = random.Random(seed), walk()
    result: list[tuple[str, bytes]] = []
    shift, lap = 0, stamp(messages[-1][1]) - stamp(messages[0][1]) + 1_000_000_000
    for k in range(max(1, round(seconds * FASTER / 12.0))):
        shift += (lap if k else 0) + JUMPS[k % 3]
        cut = {stream: rng.randrange(len(messages)) for stream in INPUT_TYPES}
        for i, (stream, raw) in enumerate(messages):
            if cut[stream] <= i < cut[stream] + 600 and rng.random() < 0.9:
                continue
            message = stream, moved(raw, shift)
            result += [message] * (2 if rng.random() < 0.01 else 1)
        for _ in range(len(messages) // 100):  # late
            i = rng.randrange(len(result) - 30)
            result.insert(i + rng.randrange(30), result.pop(i))
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


def expected(messages, types):
    """By the pipeline: stamp and numbers of each prediction; how many there are after each message; the counters."""
    pipeline = Pipeline(walk()[0], Config())
    decoders = {stream: decoder(stream) for stream in INPUT_TYPES}
    found, counts = [], []
    for stream, raw in messages:
        found += pipeline.feed(stream, raw, decoders[stream])
        counts.append(len(found))
    return [(p.stamp_ns, numbers(prediction_to(types, p))) for p in found], counts, pipeline.status()


@pytest.mark.timeout(120 + 20 * SECONDS)
def test_predictions_under_fire_are_those_of_the_pipeline(start, nodes_compiled, peer):
    end, seed = time.monotonic() + SECONDS, 0
    while seed == 0 or time.monotonic() < end:
        segment(start, peer, seed)
        seed += 1


def segment(start, peer, seed):
    """A node from its start until it is killed."""
    import importlib

    reliable = [f"qos_overrides./{topic}.subscription.reliability:=reliable" for topic in INPUT_TOPICS.values()]
    options = [part for each in (*reliable, "output.diagnostics_rate:=5.0") for part in ("-p", each)]
    node = start("predictor", "--ros-args", *options)
    publishers = {}
    for stream, kind in INPUT_TYPES.items():
        package, _, short = kind.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), short)
        publishers[stream] = peer.publisher(message_type, INPUT_TOPICS[stream])
    description = peer.publisher(String, DESCRIPTION, qos.latched())
    description.publish(String(data=robot_urdf()))
    peer.wait(lambda: all(p.get_subscription_count() for p in publishers.values()), "the node subscribes")
    peer.predictions.clear()
    messages = under_fire(seed, SEGMENT)
    wanted, counts, status = expected(messages, peer.types)
    send(peer, publishers, messages[:2000], counts, seed)
    before = resident_mb(node.pid)
    send(peer, publishers, messages[2000:], counts[2000:], seed)
    peer.wait(lambda: len(peer.predictions) >= len(wanted), f"{len(wanted)} predictions")
    assert resident_mb(node.pid) - before < GROWTH
    published = [(stamp_of(each), numbers(each)) for each in peer.predictions]
    assert [s for s, _ in published] == [s for s, _ in wanted]
    together = (np.concatenate([values for _, values in each]) for each in (published, wanted))
    np.testing.assert_allclose(*together, rtol=0, atol=1e-9)
    counted(peer, status)
    node.send(signal.SIGKILL)
    for publisher in (*publishers.values(), description):
        peer.node.destroy_publisher(publisher)


def send(peer, publishers, messages, counts, seed):
    """At five times the real rate, in bursts now and then, and never more than a queue ahead of the node."""
    rng, period, due = random.Random(seed), 1.0 / (5.0 * 200.0 * FASTER), time.monotonic()
    for k, (stream, raw) in enumerate(messages):
        publishers[stream].publish(raw)
        due += period
        if k % 20 == 0 and rng.random() < 0.9:
            peer.spin(max(0.0, due - time.monotonic()))
        if k % 500 == 499:
            peer.wait(lambda k=k: len(peer.predictions) >= counts[k - 400], f"{counts[k - 400]} predictions")


def counted(peer, status):
    """Each message that was sent was received, and used or rejected for the reason that the pipeline has."""

    def same() -> bool:
        values = peer.statuses.get("predictor: input", (0, "", {}))[2]
        rejected = {k.removeprefix("rejected: "): int(v) for k, v in values.items()
                    if k.startswith("rejected: ") and not k.endswith(": last")}  # fmt: skip
        received = {name: int(values.get(f"{name}: accepted", -1)) for name in status.streams}
        return rejected == status.rejected and all(
            received[name] in (each.accepted, -1) for name, each in status.streams.items()
        )

    peer.wait(same, f"counters {status.rejected}")
    for name, each in status.streams.items():
        lost = sum(n for key, n in status.rejected.items() if key.rpartition("/")[0] == name)
        waits = 1 if each.received != each.accepted + lost else 0  # the last stamp may still be in doubt
        assert each.received == each.accepted + lost + waits
