# SPDX-License-Identifier: BSD-3-Clause
"""`coman replay`: plays, says how it went, ends cleanly."""

from __future__ import annotations

import json
import sys

import pytest
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
    assert process.wait() == 130
    assert "Traceback" not in process.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["/nowhere"], "no such file"),
        (["{bag}", "--namespace", "a b"], "namespace"),
        (["{bag}", "--remap", "a"], "--remap"),
    ],
)
def test_what_cannot_be_played_is_said_in_one_line(start, ros_domain, bag, arguments, words):
    process = start(sys.executable, *MODULE, *(argument.format(bag=bag) for argument in arguments))
    assert process.wait(60.0) == 2
    assert words in process.output and process.output.startswith("coman: ") and process.output.count("\n") == 1
