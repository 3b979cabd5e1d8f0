# SPDX-License-Identifier: BSD-3-Clause
"""Bags played to the predictor: in time and in order, and it answers as it does offline."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import SupportState
from conftest import PATIENCE
from ros_testing import numbers, paced, robot_urdf, stamp_of, vector
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from synthetic import T0, walk, write_bag

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.session import Session
from coman_reduced_model.bag.types import bag_types
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.messages import STRING, prediction_to, ros_types
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.ros.tools.replay import Replay
from coman_reduced_model.topics import TF_STATIC

ENCODER = {"spring/LKneeSag", "feet/pitch"}  # channels that an encoder of the left knee is in

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


def watched(path, config):
    """A pipeline that has seen a bag, and its predictions."""
    with Session(path, config) as session:
        return session.pipeline, list(session.predictions())


def offline(path, config):
    types = ros_types()
    return [prediction_to(types, p) for p in watched(path, config)[1]]


def replayed(peer, node, path, rate, count):
    """What the node predicts while the bag is played to it; it is stopped at the end."""
    replay = Replay(peer.node, path)
    topics = ("joint_states", "motor_states", "left_foot/wrench", "right_foot/wrench", "com/reference")
    replay.wait_for_subscribers(topics, PATIENCE)
    replay.play(rate, keep_going=paced(peer, replay.bag))

    def all_received() -> bool:
        _, _, values = peer.statuses["predictor: input"]
        return all(values.get(f"{topic}: received") == str(replay.bag.counts[f"/{topic}"]) for topic in topics)

    peer.wait(all_received, "every message of the bag")
    replay.close()
    assert node.stop() == 0  # now it answers the last ones, which still wait for other streams
    peer.wait(lambda: len(peer.predictions) >= count, f"{count} predictions (only {len(peer.predictions)})")


@pytest.mark.parametrize("reference", ["motor", "topic"])
def test_live_equals_offline(start, peer, recorded_walk, reference):
    """The same messages give the same predictions, all of them, through DDS and from the file."""
    config = Config().replaced({"prediction.reference": reference})
    expected = offline(recorded_walk, config)
    node = start.node("predictor", prediction__reference=reference)
    replayed(peer, node, recorded_walk, 2.0, len(expected))
    assert [stamp_of(message) for message in peer.predictions] == [stamp_of(message) for message in expected]
    assert [len(message.horizons) for message in peer.predictions] == [len(message.horizons) for message in expected]
    # In `motor`, the preview of com/reference only helps; which point of it is the newest depends on arrival.
    for got, wanted in zip(peer.predictions, expected, strict=True):
        if reference == "motor":
            got.horizons, wanted.horizons = [], []
        np.testing.assert_allclose(numbers(got), numbers(wanted), rtol=0.0, atol=1e-9)
    phases = {message.support.phase for message in peer.predictions}
    assert phases == {SupportState.LEFT, SupportState.RIGHT, SupportState.DOUBLE}
    residuals = np.array([vector(message.residual) for message in peer.predictions])
    assert np.isfinite(residuals).all(axis=1).mean() > 0.95


def test_replay_keeps_time_and_order_and_latches_the_description(peer, recorded_walk):
    clocks, stamps, texts = [], [], []
    peer.node.create_subscription(Clock, "/clock", lambda m: clocks.append(m.clock.sec + m.clock.nanosec * 1e-9), 1000)
    peer.node.create_subscription(JointState, "joint_states", lambda m: stamps.append(stamp_of(m)), 1000)
    replay = Replay(peer.node, recorded_walk, exclude=("com/reference",))
    replay.wait_for_subscribers(["joint_states"], PATIENCE)
    began = time.monotonic()
    expected = 2 * replay.bag.duration_s / 4.0

    def keep_going(progress):
        peer.executor.spin_once(timeout_sec=0.0)
        return progress.loops < 3

    progress = replay.play(4.0, True, keep_going)
    took = time.monotonic() - began
    assert expected - 0.3 < took < expected + 0.3 + 2 * progress.max_lag_s, "two passes at four times the speed"
    peer.node.create_subscription(peer.types.String, "robot_description", lambda m: texts.append(m.data), qos.latched())
    peer.wait(lambda: texts, "robot_description for a late subscriber")
    assert texts == [robot_urdf()]
    with Bag(recorded_walk) as bag:
        recorded = [stamp_of(message) for _, _, message in bag.messages(["/joint_states"])]
    assert stamps == recorded * 2
    steps = np.diff(clocks)
    assert np.median(steps) == pytest.approx(0.005, abs=1e-6) and (steps < 0.0).sum() == 1
    assert progress.messages == 2 * progress.total and not peer.node.count_subscribers("com/reference")
    replay.close()


def test_all_static_transforms_are_latched_and_names_that_ros_does_not_have_are_left_out(peer, tmp_path):
    """Each node that publishes them has sent its own message. Texts here, as not each ROS has the type."""
    types, camera = bag_types(), "/camera-1/name"
    with BagWriter(tmp_path / "bag", {TF_STATIC: STRING, camera: STRING}, (TF_STATIC,)) as bag:
        for i, link in enumerate(("camera", "lidar")):
            bag.write(TF_STATIC, T0 + i, types.String(data=link))
        bag.write(camera, T0 + 2, types.String(data="front"))
    replay, links = Replay(peer.node, tmp_path / "bag"), []
    assert list(replay.progress.skipped) == [camera]
    peer.node.create_subscription(peer.types.String, "tf_static", lambda m: links.append(m.data), qos.latched(100))
    peer.wait(lambda: len(links) == 2, "both transforms")
    assert sorted(links) == ["camera", "lidar"]
    replay.close()


def test_bag_loop_restarts_the_prediction(start, peer, recorded_walk):
    node = start.node("predictor", output__diagnostics_rate=10.0)
    replay = Replay(peer.node, recorded_walk)
    replay.wait_for_subscribers(["joint_states", "right_foot/wrench"], PATIENCE)
    in_step = paced(peer, replay.bag)
    replay.play(4.0, True, lambda progress: in_step(progress) and progress.loops < 3)

    def both_passes() -> bool:
        back = np.flatnonzero(np.diff([stamp_of(message) for message in peer.predictions]) < 0)
        return len(back) > 0 and len(peer.predictions) > 1.95 * back[0]

    peer.wait(both_passes, "predictions of both passes")  # a busy machine is behind when the replay ends
    peer.spin(0.5)
    _, _, values = peer.statuses["predictor: prediction"]
    assert values["restarts"] == "1"
    stamps = np.array([stamp_of(message) for message in peer.predictions])
    (back,) = np.flatnonzero(np.diff(stamps) < 0)
    first, second = peer.predictions[: back + 1], peer.predictions[back + 1 :]
    # Odometry and phases begin again: the second pass is the first one again.
    same = {stamp_of(message): message for message in first}
    compared = [message for message in second if stamp_of(message) in same][20:]
    assert len(compared) > 0.9 * len(first)
    for message in compared:
        np.testing.assert_allclose(
            vector(message.sole_pose.position), vector(same[stamp_of(message)].sole_pose.position), atol=1e-9
        )
    replay.close()
    assert node.stop() == 0


def test_diagnostics_name_what_breaks_in_mid_walk(start, peer, tmp_path):
    """An encoder slips at 6 s: /diagnostics are silent before, and warn with its spring (and the foot it turns).

    That the same walk is told of within five seconds is read off the samples' own time, by the same code offline: a
    machine that is busy elsewhere may hold the replay up and then hurry it.
    """

    def change(stream, message):
        late = stream == "joint_states" and (message.stamp_ns - T0) * 1e-9 >= 6.0
        slip = 0.012 * (np.array(message.names) == "LKneeSag") if late else 0.0
        return replace(message, position=message.position + slip) if late else message

    node = start.node("predictor")
    path = write_bag(tmp_path / "walk", walk(11.5), change)
    replay = Replay(peer.node, path)
    replay.wait_for_subscribers(("joint_states", "motor_states", "left_foot/wrench", "right_foot/wrench"), PATIENCE)
    keep_going, told = paced(peer, replay.bag), []

    def warned() -> bool:
        level, message, _ = peer.statuses.get("predictor: mismatch", (0, "", {}))
        if level and not told:
            told.append(((stamp_of(peer.predictions[-1]) - T0) * 1e-9, level, message))
        return bool(told)

    def watching(progress):
        warned()
        return keep_going(progress)

    replay.play(1.0, keep_going=watching)
    replay.close()
    peer.wait(warned, "a warning of what broke")
    seconds, level, message = told[0]
    assert seconds > 6.0 and level == 1 and "spring/LKneeSag" in message
    assert set(peer.statuses["predictor: mismatch"][2]) <= {*ENCODER, "support phases compared"}
    assert node.stop() == 0
    first = watched(path, Config())[0].monitor.first
    assert set(first) <= ENCODER
    slip = first["spring/LKneeSag"]
    assert slip.detected_ns == min(each.detected_ns for each in first.values()) <= T0 + 11_000_000_000
    assert slip.onset_ns >= T0 + 6_000_000_000 and slip.size == pytest.approx(-0.012, abs=0.001)
