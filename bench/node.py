# SPDX-License-Identifier: BSD-3-Clause
"""The predictor node under load, beside an empty relay: lost messages, CPU and latency.

    python bench/node.py [--seconds 60] [--rate 1000] [--reference none|motor] [--relays events,raw,default]

Joint states and both wrenches (and motor states, if asked for) come at the rate. The relay is a minimal rclpy node that
subscribes to the same topics and publishes one ComPrediction for each joint state: with message objects on rclpy's
default executor, the same on the one that our nodes use (events), and on that with serialised messages in and out, as
our nodes have them (raw). One after the other, fed by the same process. Latency is from just before a joint state is
published to the arrival of its answer in a third process, both on this machine's clock.
"""

from __future__ import annotations

import argparse
import os
import random
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("ROS_DOMAIN_ID", str(random.SystemRandom().randint(1, 101)))  # children inherit it

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from coman_reduced_model.core.base.types import JointMessage, WrenchMessage
from coman_reduced_model.messages import joint_to, ros_types, wrench_to
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.robot_table import COMAN

TOPICS = {"joint_states": JointState, "left_foot/wrench": WrenchStamped, "right_foot/wrench": WrenchStamped}
_STAMP = struct.Struct("<iI")


def relay(executor: str, topics: list[str]) -> None:
    """A node that does nothing but answer."""
    from coman_reduced_model_msgs.msg import ComPrediction, HorizonPrediction

    rclpy.init()
    node = Node("relay")
    publisher = node.create_publisher(ComPrediction, "com/prediction", qos.prediction_output())
    answer = ComPrediction(horizons=[HorizonPrediction() for _ in range(3)])

    def on_joint(message: JointState) -> None:
        answer.header.stamp = message.header.stamp
        publisher.publish(answer)

    serialised, raw = bytearray(serialize_message(answer)), executor == "raw"

    def on_raw(message: bytes) -> None:
        serialised[4:12] = message[4:12]  # the stamp
        publisher.publish(bytes(serialised))

    for topic in topics:
        kind = TOPICS.get(topic, JointState)
        callback = (on_raw if raw else on_joint) if topic == "joint_states" else lambda message: None
        node.create_subscription(kind, topic, callback, qos.sensor_input(), raw=raw)
    chosen = rclpy.executors.SingleThreadedExecutor() if executor == "default" else EventsExecutor()
    chosen.add_node(node)
    with suppress(Exception):  # whatever shutting down in mid-message looks like
        while rclpy.ok():
            chosen.spin_once(timeout_sec=0.1)


def collect(path: str) -> None:
    """Writes stamp and arrival [ns] of every com/prediction."""
    from coman_reduced_model_msgs.msg import ComPrediction

    rclpy.init()
    node = Node("collector")
    seen: list[tuple[int, int]] = []

    def on_prediction(raw: bytes) -> None:
        arrival = time.time_ns()
        sec, nanosec = _STAMP.unpack_from(raw, 4)
        seen.append((sec * 10**9 + nanosec, arrival))

    node.create_subscription(ComPrediction, "com/prediction", on_prediction, qos.prediction_output(), raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    while not Path(f"{path}.stop").exists():
        for _ in range(200):
            executor.spin_once(timeout_sec=0.005)
    np.save(path, np.array(seen, dtype=np.int64).reshape(-1, 2))


class Feeder:
    """Publishes a walk on the spot, serialised beforehand; only the stamps are written when it is sent."""

    def __init__(self, topics: list[str], rate: float) -> None:
        self.rate = rate
        self.node = Node("feeder")
        self.publishers = [
            self.node.create_publisher(TOPICS.get(topic, JointState), topic, qos.sensor_output()) for topic in topics
        ]
        self.description = self.node.create_publisher(String, "robot_description", qos.latched())
        self.description.publish(String(data=urdf(COMAN)))
        types, count = ros_types(), round(rate)
        self.messages = []
        for k in range(count):
            swing = 0.02 * np.sin(2.0 * np.pi * k / count + np.arange(12))
            q = np.array((-0.3, 0.0, 0.0, 0.6, -0.3, 0.0) * 2) + swing
            share = (0.5, 1.0, 0.5, 0.0)[4 * k // count]
            zero, row = np.zeros(12), []
            for topic in topics:
                if topic.endswith("wrench"):
                    left = topic.startswith("left")
                    force = np.array((0.0, 0.0, (share if left else 1.0 - share) * COMAN.mass * 9.81))
                    row.append(wrench_to(types, WrenchMessage(0, "l_sole" if left else "r_sole", force, np.zeros(3))))
                else:
                    lead = 0.01 if topic == "motor_states" else 0.0
                    row.append(joint_to(types, JointMessage(0, COMAN.joint_names, q + lead, zero, zero)))
            self.messages.append([bytearray(serialize_message(message)) for message in row])

    def wait(self) -> None:
        """Until all topics have a subscriber."""
        end = time.monotonic() + 120.0
        while not all(publisher.get_subscription_count() for publisher in self.publishers):
            if time.monotonic() > end:
                sys.exit("nobody subscribes")
            time.sleep(0.05)
        time.sleep(0.5)

    def run(self, seconds: float) -> int:
        """Send for so long; the number of joint states."""
        count, period = round(seconds * self.rate), 1.0 / self.rate
        began = time.monotonic()
        for k in range(count):
            left = began + k * period - time.monotonic()
            if left > 0.0:
                time.sleep(left)
            now = divmod(time.time_ns(), 10**9)
            for publisher, message in zip(self.publishers, self.messages[k % len(self.messages)], strict=True):
                _STAMP.pack_into(message, 4, *now)
                publisher.publish(bytes(message))
        return count


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(name: str, command: list[str], topics: list[str], rate: float, seconds: float) -> list[str]:
    """One node under load: a row of the table."""
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    path = f"/tmp/coman_bench_{os.getpid()}.npy"
    collector = subprocess.Popen([sys.executable, __file__, "--collect", path], env=environment)
    node = subprocess.Popen(command, env=environment)
    feeder = Feeder(topics, rate)
    try:
        feeder.wait()
        feeder.run(2.0)  # until caches and clocks are warm
        time.sleep(0.3)
        cpu, began, first = cpu_seconds(node.pid), time.monotonic(), time.time_ns()
        sent = feeder.run(seconds)
        elapsed = time.monotonic() - began
        time.sleep(0.5)
        cpu = cpu_seconds(node.pid) - cpu
        Path(f"{path}.stop").touch()
        collector.wait(20.0)
        stamp, arrival = np.load(path).T
    finally:
        for process in (node, collector):
            process.terminate()
            process.wait(10.0)
        feeder.node.destroy_node()
        for each in (Path(path), Path(f"{path}.stop")):
            each.unlink(missing_ok=True)
    latency = (arrival - stamp)[stamp >= first] * 1e-6
    p50, p99 = np.percentile(latency, [50, 99])
    lost = sent - len(latency)
    return [
        name, f"{sent}", f"{lost}", f"{100 * cpu / elapsed:.1f}", f"{p50:.3f}", f"{p99:.3f}", f"{latency.max():.2f}",
        f"{sent / elapsed:.0f}",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--reference", choices=("none", "motor"), default="none")
    parser.add_argument("--relays", default="events,raw,default", help="of which the first is compared with")
    parser.add_argument("--collect", help=argparse.SUPPRESS)
    parser.add_argument("--relay", help=argparse.SUPPRESS)
    parser.add_argument("--topics", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.collect:
        collect(options.collect)
        return
    if options.relay:
        relay(options.relay, options.topics.split(","))
        return
    # The joint state last: it is what completes a sample.
    topics = ["left_foot/wrench", "right_foot/wrench", "joint_states"]
    if options.reference == "motor":
        topics.insert(2, "motor_states")
    rclpy.init()
    predictor = [
        str(Path(sys.executable).with_name("predictor")), "--ros-args", "--log-level", "warn",
        "-p", f"prediction.reference:={options.reference}",
    ]  # fmt: skip
    relays = {
        f"relay, {name}": [sys.executable, __file__, "--relay", name, "--topics", ",".join(topics)]
        for name in options.relays.split(",")
    }
    load = os.getloadavg()[0]
    rows = [
        measure(name, command, topics, options.rate, options.seconds)
        for name, command in {"predictor": predictor, **relays}.items()
    ]
    table = Table(title=f"{len(topics)} topics at {options.rate:g} Hz for {options.seconds:g} s, reference: "
                  f"{options.reference}; {os.cpu_count()} cores, load before {load:.1f}")  # fmt: skip
    for column in ("node", "sent", "lost", "CPU [%]", "p50 [ms]", "p99 [ms]", "max [ms]", "sent [Hz]"):
        table.add_column(column, justify="left" if column == "node" else "right")
    for row in rows:
        table.add_row(*row)
    Console(width=110).print(table)
    cpu, p99 = (float(rows[0][k]) / float(rows[1][k]) for k in (3, 5))
    print(f"predictor against the {rows[1][0]}: CPU x {cpu:.1f}, p99 x {p99:.1f}")
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
