# SPDX-License-Identifier: BSD-3-Clause
"""All nodes together: the virtual robot walks live, the demonstration, the live view."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComPrediction, ComReference, SupportState
from conftest import PATIENCE, Process, child_environment
from ros_testing import vector
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from coman_reduced_model.core.base.stream_names import IMU, JOINTS, REFERENCE
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.gait.walk import Walk
from coman_reduced_model.messages import prediction_from, reference_from, reference_to, ros_types, stamp_of
from coman_reduced_model.ros.interface import qos
from coman_reduced_model.ros.interface.diagnostic_report import IN_TIME
from coman_reduced_model.ros.tools.paced_clock import PacedClock
from coman_reduced_model.ros.tools.tracking import Tracking
from coman_reduced_model.sim.robot_table import COMAN, with_upper_body
from coman_reduced_model.topics import INPUT_TOPICS, PREDICTION

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


@pytest.mark.slow
@pytest.mark.parametrize("compensate", [False, True])
def test_virtual_robot_walks_its_plan_and_the_prediction_follows(compensate, start, peer):
    """Robot, trajectory and predictor together, in simulated time.

    The motors lead by half of the planned deflection; or by all that com/planned_deflection says: then the COM's
    error is less than half.
    """
    clock, tracking = PacedClock(peer.node), Tracking()

    def on_prediction(message):
        clock.on_prediction(stamp_of(message.header))
        tracking.add(prediction_from(message))

    def advanced():
        clock.advance()
        return True

    for kind, topic, take in (
        (ComReference, REFERENCE, lambda message: tracking.add_plan(reference_from(message))),
        (ComPrediction, PREDICTION, on_prediction),
    ):
        peer.node.create_subscription(kind, topic, take, qos.sensor_input())
    gait = {"gait__steps": 4, "gait__zmp_offset_x": 0.02}
    own = {"virtual_robot__compensate": compensate, "virtual_robot__lead": 0.5, **gait}
    robot = start.node("virtual_robot", use_sim_time=True, output__diagnostics_rate=5.0, **own)
    predictor = start.node("predictor", use_sim_time=True)
    robot.wait_for("ready: coman")
    predictor.wait_for("ready: coman")
    peer.wait(lambda: advanced() and peer.predictions, "predictions")
    trajectory = start.node("trajectory", use_sim_time=True, gait__ahead=0.3, gait__autostart=False, **gait)
    follows, share = "follows com/reference", "share of the lead that is compensated"

    def hear_each_other():
        _, message, values = peer.statuses["virtual_robot: simulation"]
        return message == follows and (not compensate or values[share] == "1.00")

    peer.wait(lambda: advanced() and hear_each_other(), "robot, plan and predictor hear each other")
    assert peer.call(Trigger, "trajectory/start", Trigger.Request()).success
    peer.wait(lambda: advanced() and peer.predictions[-1].sole_pose.position.x > 0.05, "some steps")
    _, message, values = peer.statuses["virtual_robot: simulation"]
    assert message == follows and values["set forward"] == "0"
    phases = [m.support.phase for m in peer.predictions]
    assert set(phases) >= {SupportState.LEFT, SupportState.RIGHT, SupportState.DOUBLE}
    assert phases.count(SupportState.FLIGHT) < 0.02 * len(phases)
    residual = np.array([vector(m.residual) for m in peer.predictions])
    rigid = np.array([vector(m.measured_position) - vector(m.reference_position) for m in peer.predictions])
    assert np.nanmean(residual[:, 2] ** 2) < np.nanmean(rigid[:, 2] ** 2)
    x, _, z = tracking.rms_mm()
    if compensate:
        assert float(values[IN_TIME]) > 0.8  # nearly all, unless the machine is busy elsewhere
        assert x < 1.0 and z < 0.25
    else:
        assert x > 2.0 and z > 0.5
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


def test_live_that_saw_no_prediction_fails(ros_domain):
    process = Process([str(Path(sys.executable).with_name("coman")), "live", "--duration", "0.2"])
    try:
        assert process.wait() == 1
        assert "coman: live failed: no prediction within 0.2 s" in process.output
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


def test_the_virtual_robot_stays_where_it_is_if_a_plan_is_out_of_its_reach(start, peer):
    """Such as one of a larger robot; a plan that it can follow is followed after that."""
    robot = start.node("virtual_robot", output__diagnostics_rate=5.0)
    robot.wait_for("ready: coman")
    plan = peer.publisher(ComReference, REFERENCE, qos.sensor_output())
    near = Walk(Config()).reference(0)
    far = replace(near, com=near.com + [0.0, 0.0, 0.4])

    def told(reference):
        stamp = int(peer.node.get_clock().now().nanoseconds)
        plan.publish(reference_to(ros_types(), replace(reference, stamp_ns=stamp)))
        peer.spin(0.05)
        return peer.statuses.get("virtual_robot: simulation", (0, "", {"references refused": "0"}))

    peer.wait(lambda: int(told(far)[2]["references refused"]) > 2, "it is refused, again and again")
    peer.wait(lambda: "follows" in told(near)[1], "the robot follows")
    assert robot.stop() == 0 and "Traceback" not in robot.output
