# SPDX-License-Identifier: BSD-3-Clause
"""`coman replay`: plays, says how it went, ends cleanly."""

from __future__ import annotations

import json
import sys
import time

import pytest
import rclpy
from sensor_msgs.msg import JointState
from synthetic import walk, write_bag

pytestmark = pytest.mark.ros
MODULE = ("-m", "coman_reduced_model.cli.main", "replay")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "walk", walk(1.0))


def test_a_bag_is_played_to_its_end(start, ros_domain, bag):
    process = start(sys.executable, *MODULE, bag, "--rate", "2", "--wait", "0", "--json")
    assert process.wait(60.0) == 0, process.output
    result = json.loads(process.output)
    assert result["messages"] == 800 and result["skipped"] == {}


def test_a_loop_goes_on_until_ctrl_c(start, ros_domain, bag):
    process = start(sys.executable, *MODULE, bag, "--loop", "--rate", "5")
    process.wait_for("replaying: ", 60.0)
    process.interrupt(2)
    assert process.wait() == 0
    assert "messages; at most" in process.output and "Traceback" not in process.output


def test_it_waits_for_a_listener(start, ros_domain, bag):
    waiting = start(sys.executable, *MODULE, bag, "--await", "/joint_states", "--rate", "5", "--json")
    rclpy.init()
    try:
        node = rclpy.create_node("late")
        time.sleep(3.0)
        received = []
        node.create_subscription(JointState, "joint_states", received.append, 1000)
        while waiting.running:
            rclpy.spin_once(node, timeout_sec=0.1)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    assert waiting.wait() == 0, waiting.output
    assert len(received) == 200  # all of them, though it came seconds after the replay


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["/nowhere"], "no such file"),
        (["{bag}", "--namespace", "a b"], "namespace"),
        (["{bag}", "--remap", "a"], "--remap"),
        (["{bag}", "--rate", "nan"], "--rate"),
    ],
)
def test_what_cannot_be_played_is_said_in_one_line(start, ros_domain, bag, arguments, words):
    process = start(sys.executable, *MODULE, *(argument.format(bag=bag) for argument in arguments))
    assert process.wait(60.0) == 2
    assert words in process.output and process.output.startswith("coman: ") and process.output.count("\n") == 1
