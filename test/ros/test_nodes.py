# SPDX-License-Identifier: BSD-3-Clause
"""What all nodes do alike, as users meet them: they end when told to, and refuse bad settings in one line."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.errors import ConfigError

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


SIGNALS = {"twice": [signal.SIGINT] * 2, "terminated": [signal.SIGTERM]}


@pytest.mark.parametrize("signals", SIGNALS.values(), ids=SIGNALS.keys())
def test_stops_cleanly(start, ros_domain, signals):
    """Also a predictor that still waits for the URDF, one that predicts, and one that has hardly begun to start."""
    robot, trajectory = start.node("virtual_robot"), start.node("trajectory")
    waiting, predicting = start.node("predictor", "-r", "__ns:=/other"), start.node("predictor")
    waiting.wait_for("waiting for the URDF on /other/robot_description")
    predicting.wait_for("ready: coman")
    robot.wait_for("ready")
    starting = start.node("predictor")
    starting.wait_until_it_takes(signal.SIGTERM)
    nodes = (robot, trajectory, waiting, predicting, starting)
    for number in signals:
        for node in nodes:
            node.send(number)
    for node in nodes:
        assert node.wait() == 0, node.output
        assert "Traceback" not in node.output


def test_ends_with_the_command_that_started_it(start, ros_domain):
    """A terminal that is closed leaves no node of `coman live` behind."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    node = start("trajectory", COMAN_PARENT=str(ended.pid))
    assert node.wait() == 0 and "Traceback" not in node.output


HANGS = """
import ctypes, sys
from coman_reduced_model.ros.runtime.spin import run

def find():
    from rclpy.node import Node

    class Hangs(Node):
        def __init__(self):
            super().__init__("hangs")
            self.create_timer(0.1, lambda: print("spins", flush=True))

        def finish(self):
            pass

        def destroy_node(self):
            ctypes.PyDLL(None).sleep(600)  # with the interpreter's lock, as where the middleware hangs

    return Hangs

sys.exit(run("hangs", find))
"""


def test_ends_even_if_the_middleware_hangs_while_it_is_taken_down(start, ros_domain):
    node = start(sys.executable, "-c", HANGS)
    node.wait_for("spins")
    node.send(signal.SIGTERM)
    assert node.wait(60.0) == 0
    assert "Traceback" not in node.output


BAD_CONFIGURATIONS = {
    "unknown key": "support.contact_no: 0.2",
    "wrong type": "support.contact_on: high",
    "out of range": "support.contact_on: 3.0",
    "wrong choice": "model.stiffness: fulll",
    "inconsistent": "support.contact_off: 0.8",
    "unknown effect": "effects.active: [magic]",
    "quality of service": "qos_overrides./joint_states.subscription.reliability: reliabel",
}


@pytest.mark.parametrize("line", BAD_CONFIGURATIONS.values(), ids=BAD_CONFIGURATIONS.keys())
def test_bad_configuration_is_refused_as_on_the_command_line(start, ros_domain, tmp_path, line):
    path = tmp_path / "bad.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    {line}\n")
    with pytest.raises(ConfigError) as told:
        load_config(path)
    node = start.node("predictor", "--params-file", path)
    assert node.wait() == 2
    assert node.output.strip() == f"predictor: {told.value}"


@pytest.mark.parametrize(
    ("executable", "parameter", "wanted"),
    [
        ("trajectory", "gait.stepps:=3", "did you mean 'gait.steps'"),
        ("trajectory", "gait.name:=moonwalk", "moonwalk"),
        ("predictor", "robot.urdf:=/nowhere/robot.urdf", "/nowhere/robot.urdf"),
        ("trajectory", "virtual_robot.rate:=7.0", "virtual_robot.rate"),
        ("predictor", "qos_overrides./joint_states.subscription.reliability:=best-effort", "best_effort"),
        ("predictor", "qos_overrides./joint_states.subscription.depth:=true", "a whole number"),
    ],
)
def test_bad_parameter_is_refused_in_one_line(start, ros_domain, executable, parameter, wanted):
    node = start(executable, "--ros-args", "-p", parameter)
    assert node.wait() == 2
    assert wanted in node.output and len(node.output.strip().splitlines()) == 1


def test_file_that_ros_cannot_read_is_refused_in_one_line(start, ros_domain, tmp_path):
    path = tmp_path / "mixed.yaml"
    path.write_text("/**:\n  ros__parameters:\n    prediction.horizons: [1, 0.2]\n")  # ROS wants one type in a list
    node = start.node("predictor", "--params-file", path)
    assert node.wait() == 2
    assert "mixed.yaml" in node.output and "Traceback" not in node.output
