# SPDX-License-Identifier: BSD-3-Clause
"""All nodes together: the virtual robot walks live, the demonstration, the live view."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import SupportState
from conftest import PATIENCE, Process, child_environment
from ros_testing import vector

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


@pytest.mark.slow
def test_virtual_robot_walks_live(start, peer):
    """Robot, trajectory and predictor together: the robot walks its plan, the prediction follows it."""
    robot = start.node("virtual_robot", output__diagnostics_rate=5.0)
    predictor = start.node("predictor")
    robot.wait_for("ready: coman")
    predictor.wait_for("ready: coman")
    peer.wait(lambda: peer.predictions, "predictions")
    # On a busy machine the robot may hear of the walk too late to join it: then it joins the next one.
    trajectory = start.node("trajectory", gait__steps=4, gait__zmp_offset_x=0.02, gait__repeat=True)

    def hopeless():
        return robot.output.count("too slow for real time") > 4

    peer.wait(lambda: peer.predictions[-1].sole_pose.position.x > 0.05 or hopeless(), "some steps")
    if hopeless():
        pytest.skip("this machine is too busy now for a robot in real time")
    level, message, _ = peer.statuses["virtual_robot: simulation"]
    assert message == "follows com/reference" or "cannot keep real time" in message  # the latter on a busy machine
    phases = [m.support.phase for m in peer.predictions]
    assert set(phases) >= {SupportState.LEFT, SupportState.RIGHT, SupportState.DOUBLE}
    assert phases.count(SupportState.FLIGHT) < 0.02 * len(phases)  # a stumble, on a busy machine
    residual = np.array([vector(m.residual) for m in peer.predictions])
    rigid = np.array([vector(m.measured_position) - vector(m.reference_position) for m in peer.predictions])
    assert np.nanmean(residual[:, 2] ** 2) < np.nanmean(rigid[:, 2] ** 2)
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
        process.wait_for("support")
        process.wait_for("RMS 5 s: model")
        process.interrupt(2)
        assert process.wait() == 0, process.output
        assert "Traceback" not in process.output and "predictions; RMS error" in process.output
    finally:
        process.kill()
