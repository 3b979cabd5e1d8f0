# SPDX-License-Identifier: BSD-3-Clause
"""What the node tests share: a peer on the same ROS domain, a standing robot's messages, a short recorded walk."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from coman_reduced_model_msgs.msg import ComPrediction
from conftest import PATIENCE
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.types import bag_types
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.core.base.types import Foot, JointMessage, WrenchMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.messages import (
    INPUT_TYPES,
    STRING,
    imu_to,
    joint_to,
    reference_to,
    ros_types,
    wrench_to,
)
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.ros.tools.replay import Progress
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import VirtualRobot
from coman_reduced_model.topics import DESCRIPTION, INPUT_TOPICS
from coman_reduced_model.warm_up import warm_up

WEIGHT = COMAN.mass * 9.81
NAMES = COMAN.joint_names
# Knees bent, trunk upright.
Q = np.array((-0.3, 0.0, 0.0, 0.6, -0.3, 0.0) * 2)
PERIOD_NS = 5_000_000


def robot_urdf() -> str:
    return urdf(COMAN)


@cache
def compile_once() -> None:
    """Compiled code is cached beside the source; the first time takes longer than a node may take to start."""
    config = Config()
    warm_up(Robot(robot_urdf(), config.robot), config, ros_types())


class Peer:
    """A node of the test's own process: publishes inputs, collects predictions and diagnostics."""

    def __init__(self, namespace: str = "") -> None:
        compile_once()
        self.context = Context()
        rclpy.init(context=self.context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        self.node = Node("peer", context=self.context, namespace=namespace)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.types = ros_types()
        self.predictions: list[ComPrediction] = []
        self.statuses: dict[str, tuple[int, str, dict[str, str]]] = {}
        self.reports = 0
        self.node.create_subscription(ComPrediction, "com/prediction", self.predictions.append, qos.prediction_output())
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.reports += 1
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            self.statuses[status.name] = (ord(status.level), status.message, values)

    def publisher(self, kind: type, topic: str, profile: Any = None) -> Any:
        return self.node.create_publisher(kind, topic, profile or qos.sensor_output())

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def wait(self, condition: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, f"{what}: not within {timeout} s; diagnostics: {self.statuses}"
            self.executor.spin_once(timeout_sec=0.05)

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Answer of a service, called again after 10 s: a server drops answers to clients it has not discovered yet."""
        client, end = self.node.create_client(kind, name), time.monotonic() + PATIENCE
        self.wait(client.service_is_ready, f"service {name}")
        while time.monotonic() < end:
            future, again = client.call_async(request), time.monotonic() + 10.0
            while not future.done() and time.monotonic() < again:
                self.executor.spin_once(timeout_sec=0.05)
            if future.done():
                self.node.destroy_client(client)
                return future.result()
        raise AssertionError(f"no answer of {name}; diagnostics: {self.statuses}")

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


class Standing:
    """Sends what a robot that stands sends; stamps advance by 5 ms a sample, whatever the wall clock does."""

    def __init__(self, peer: Peer, start_ns: int = 1_000_000_000_000) -> None:
        self.peer, self.stamp, self._types = peer, start_ns, peer.types
        self.joints = peer.publisher(JointState, "joint_states")
        self.motors = peer.publisher(JointState, "motor_states")
        self.wrenches = {
            Foot.LEFT: peer.publisher(WrenchStamped, "left_foot/wrench"),
            Foot.RIGHT: peer.publisher(WrenchStamped, "right_foot/wrench"),
        }
        self.description = peer.publisher(String, DESCRIPTION, qos.latched())

    def describe(self, text: str | None = None) -> None:
        self.description.publish(self._types.String(data=text or robot_urdf()))

    def wait_until_heard(self) -> None:
        publishers = (self.joints, self.motors, *self.wrenches.values())
        self.peer.wait(lambda: all(p.get_subscription_count() for p in publishers), "the node subscribes")

    def wait_until_published(self, topic: str) -> None:
        """Describe the robot, and wait until the node subscribes to all and publishes a topic."""
        self.describe()
        self.wait_until_heard()
        self.peer.wait(lambda: self.peer.node.count_publishers(topic), "the outputs")
        self.peer.spin(0.5)

    def joint(self, q: np.ndarray = Q, names: tuple[str, ...] = NAMES, stamp: int | None = None) -> Any:
        message = JointMessage(self.stamp if stamp is None else stamp, names, q, np.zeros(len(q)), None)
        return joint_to(self._types, message)

    def wrench(self, foot: Foot, force: float, stamp: int | None = None, frame: str | None = None) -> Any:
        frame = frame or {Foot.LEFT: "l_sole", Foot.RIGHT: "r_sole"}[foot]
        stamp = self.stamp if stamp is None else stamp
        return wrench_to(self._types, WrenchMessage(stamp, frame, np.array((0.0, 0.0, force)), np.zeros(3)))

    def sample(self, left: float = 0.5, right: float = 0.5, q: np.ndarray = Q, **skip: bool) -> None:
        """One period of all streams, `left` and `right` being shares of the weight."""
        self.stamp += PERIOD_NS
        if skip.get("left_stream", True):
            self.wrenches[Foot.LEFT].publish(self.wrench(Foot.LEFT, left * WEIGHT))
        if skip.get("right_stream", True):
            self.wrenches[Foot.RIGHT].publish(self.wrench(Foot.RIGHT, right * WEIGHT))
        if skip.get("motor_stream", True):
            self.motors.publish(self.joint(q + 0.01))
        if skip.get("joint_stream", True):
            self.joints.publish(self.joint(q))

    def samples(self, count: int, **arguments: Any) -> None:
        for _ in range(count):
            self.sample(**arguments)
            self.peer.spin(0.0005)


def record_walk(folder: Path, steps: int = 4) -> Path:
    """A bag of the virtual robot walking, with the default noise and its plan on com/reference."""
    path = folder / "walk"
    motion, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", steps=steps)))
    robot = VirtualRobot(COMAN, SensorOptions(), seed=3)
    robot.reset(motion)
    types = bag_types()
    topics = {f"/{topic}": INPUT_TYPES[stream] for stream, topic in INPUT_TOPICS.items()}
    start = None
    with BagWriter(path, {**topics, f"/{DESCRIPTION}": STRING}, latched=(f"/{DESCRIPTION}",)) as bag:
        while robot.t < motion.end:
            readings = robot.step()
            messages = {
                "/joint_states": (readings.joint_states, joint_to),
                "/motor_states": (readings.motor_states, joint_to),
                "/left_foot/wrench": (readings.left_wrench, wrench_to),
                "/right_foot/wrench": (readings.right_wrench, wrench_to),
                "/imu/data": (readings.imu, imu_to),
            }
            if readings.joint_states is not None:
                stamp = readings.joint_states.stamp_ns
                messages["/com/reference"] = (plan.reference(readings.t, stamp, 0.02, 25), reference_to)
            for topic, (message, convert) in messages.items():
                if message is None:
                    continue
                if start is None:
                    start = message.stamp_ns
                    bag.write(f"/{DESCRIPTION}", start, types.String(data=robot_urdf()))
                bag.write(topic, message.stamp_ns + 300_000, convert(types, message))
    return path


def paced(peer: Peer, bag: Bag) -> Callable[[Progress], bool]:
    """For `Replay.play`: it waits where the predictor is a second behind, so that a busy machine loses nothing."""
    each = sum(bag.counts.values()) / bag.counts["/joint_states"]

    def keep_going(progress: Progress) -> bool:
        peer.executor.spin_once(timeout_sec=0.0)
        due = progress.messages / each - 200.0
        if len(peer.predictions) < due:
            peer.wait(lambda: len(peer.predictions) >= due, f"{due:.0f} predictions (only {len(peer.predictions)})")
        return True

    return keep_going


def vector(value: Any) -> np.ndarray:
    return np.array((value.x, value.y, value.z))


def numbers(prediction: Any) -> np.ndarray:
    """All numbers of a ComPrediction in one array."""
    p = prediction.sole_pose
    parts = [
        vector(getattr(prediction, f"{name}_{kind}"))
        for name in ("measured", "reference", "predicted")
        for kind in ("position", "velocity")
    ]
    parts += [vector(prediction.residual), vector(p.position), *(vector(h.position) for h in prediction.horizons)]
    o, s = p.orientation, prediction.support
    rest = (o.x, o.y, o.z, o.w, s.phase, s.support_foot, s.left_share, s.phase_time, s.total_force, prediction.flags)
    return np.concatenate([*parts, np.array(rest, dtype=float)])


def stamp_of(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
