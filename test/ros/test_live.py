# SPDX-License-Identifier: BSD-3-Clause
"""All nodes together: the virtual robot walks live, the demonstration, the live view."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComPrediction, ComReference, SupportState
from conftest import PATIENCE, Process, child_environment
from ros_testing import vector
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from coman_reduced_model.core.base.stream_names import IMU, JOINTS, REFERENCE
from coman_reduced_model.messages import prediction_from, reference_from, stamp_of
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.ros.tools.tracking import Tracking
from coman_reduced_model.sim.robot_table import COMAN, with_upper_body
from coman_reduced_model.topics import INPUT_TOPICS, PREDICTION

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


class PacedClock:
    """Simulated time that waits for the virtual robot, however busy the machine is."""

    def __init__(self, peer):
        self._publisher = peer.publisher(Clock, "/clock", qos.clock_output())
        self._now = self._robot = 0  # [ns]
        self._advanced = time.monotonic()
        peer.node.create_subscription(JointState, JOINTS, self._on_joint_states, qos.sensor_input())

    def _on_joint_states(self, message):
        self._robot = stamp_of(message.header)

    def advance(self):
        """5 ms more, unless the robot is 0.15 s behind; then once a second, since messages may be lost."""
        waited = time.monotonic() - self._advanced
        if self._now < max(self._robot + 150_000_000, 500_000_000) or waited > 1.0:
            self._now += 5_000_000
            self._advanced += waited
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(self._now, 1_000_000_000)
            self._publisher.publish(message)
        return True


@pytest.mark.slow
@pytest.mark.parametrize(
    "compensate",
    [False, pytest.param(True, marks=pytest.mark.xfail(reason="live, planned deflections come late"))],
)
def test_virtual_robot_walks_its_plan_and_the_prediction_follows(compensate, start, peer):
    """Robot, trajectory and predictor together, in simulated time; the motors lead by the robot's own lead or not."""
    clock, tracking = PacedClock(peer), Tracking()
    for kind, topic, take in (
        (ComReference, REFERENCE, lambda message: tracking.add_plan(reference_from(message))),
        (ComPrediction, PREDICTION, lambda message: tracking.add(prediction_from(message))),
    ):
        peer.node.create_subscription(kind, topic, take, qos.sensor_input())
    own = {"virtual_robot__compensate": True, "virtual_robot__lead": 0.5} if compensate else {}
    robot = start.node("virtual_robot", use_sim_time=True, output__diagnostics_rate=5.0, **own)
    predictor = start.node("predictor", use_sim_time=True)
    robot.wait_for("ready: coman")
    predictor.wait_for("ready: coman")
    peer.wait(lambda: clock.advance() and peer.predictions, "predictions")
    trajectory = start.node("trajectory", use_sim_time=True, gait__steps=4, gait__zmp_offset_x=0.02, gait__repeat=True)
    peer.wait(lambda: clock.advance() and peer.predictions[-1].sole_pose.position.x > 0.05, "some steps")
    _, message, values = peer.statuses["virtual_robot: simulation"]
    assert message == "follows com/reference" and values["set forward"] == "0"
    phases = [m.support.phase for m in peer.predictions]
    assert set(phases) >= {SupportState.LEFT, SupportState.RIGHT, SupportState.DOUBLE}
    assert phases.count(SupportState.FLIGHT) < 0.02 * len(phases)
    residual = np.array([vector(m.residual) for m in peer.predictions])
    rigid = np.array([vector(m.measured_position) - vector(m.reference_position) for m in peer.predictions])
    assert np.nanmean(residual[:, 2] ** 2) < np.nanmean(rigid[:, 2] ** 2)
    if compensate:
        assert values["share of the lead that is compensated"] == "1.00" and tracking.rms_mm()[0] < 2.5
    for node in (robot, predictor, trajectory):
        assert node.stop() == 0


def test_demo_shows_and_fails_loudly(tmp_path, recorded_walk):
    """The demonstration answers every joint state; with a bag that the nodes cannot answer, it says so and exits 1."""
    coman = Path(sys.executable).with_name("coman")

    def demo(*arguments):
        return subprocess.run(
            [coman, "demo", *map(str, arguments)],
            capture_output=True,
            text=True,
            env=child_environment(),
            timeout=4 * PATIENCE,
        )

    done = demo("--bag", recorded_walk, "--rate", "2", "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["live"]["predictions"] == summary["live"]["joint_states"] > 500
    assert summary["rmse_m"]["z"] < summary["rmse_rigid_m"]["z"]
    assert "<html" in (tmp_path / "out/report.html").read_text()
    # The wrong robot: the predictor ends, and so does the demonstration.
    config = tmp_path / "other.yaml"
    config.write_text("/**:\n  ros__parameters:\n    robot.left.sole_frame: nowhere\n")
    done = demo("--bag", recorded_walk, "--out", tmp_path / "bad", "--config", config)
    assert done.returncode == 1
    assert "predictor has ended with exit code 2" in done.stderr and "nowhere" in done.stderr
    assert not (tmp_path / "bad").exists() and "Traceback" not in done.stderr


@pytest.mark.slow
def test_live_view_on_a_dumb_terminal(ros_domain):
    coman = Path(sys.executable).with_name("coman")
    process = Process([str(coman), "live"], TERM="dumb")
    try:
        process.wait_for(f"nodes run with ROS_DOMAIN_ID={ros_domain} ")
        process.wait_for("support")
        process.wait_for("RMS 5 s: model")
        process.interrupt(2)
        assert process.wait() == 0, process.output
        assert "Traceback" not in process.output and "predictions; RMS error" in process.output
    finally:
        process.kill()


def test_the_virtual_robot_takes_a_world(start, peer, tmp_path):
    """A robot with waist, arms and head that publishes no IMU; an impossible world ends the node in one line."""
    world = tmp_path / "mine.yaml"
    world.write_text("upper_body: true\nsensors: {imu: false, effort: false}\n")
    states, others = [], []
    peer.node.create_subscription(JointState, JOINTS, states.append, qos.sensor_input())
    peer.node.create_subscription(Imu, INPUT_TOPICS[IMU], others.append, qos.sensor_input())
    robot = start.node("virtual_robot", virtual_robot__world=str(world))
    robot.wait_for("ready: coman_whole")
    peer.wait(lambda: len(states) > 20, "joint states")
    assert list(states[-1].name) == list(with_upper_body(COMAN).joint_names)
    assert not states[-1].effort and not others
    assert robot.stop() == 0
    for text, words in (("moon", "'moon': no file, no seed and no kind"), ("tall.yaml", "its robot is tall")):
        (tmp_path / "tall.yaml").write_text("robot: tall\n")
        bad = start.node("virtual_robot", virtual_robot__world=str(tmp_path / text) if "." in text else text)
        assert bad.wait() == 2 and words in bad.output and "Traceback" not in bad.output
