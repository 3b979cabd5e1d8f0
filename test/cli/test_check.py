# SPDX-License-Identifier: BSD-3-Clause
"""`coman check` says in a few lines what a bag holds, and one sentence for each thing that looks wrong."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import recording
from synthetic import JOINTS, LEFT, MOTORS, RIGHT, description, walk, write_bag

from coman_reduced_model.cli.main import run
from coman_reduced_model.resources import bag_path


def check(capsys, bag, *arguments):
    assert run(["check", str(bag), *map(str, arguments)]) == 0
    return capsys.readouterr().out


@pytest.mark.slow
def test_a_good_recording(capsys):
    lines = check(capsys, bag_path("test1")).splitlines()
    assert len(lines) <= 10 and lines[-1] == "nothing looks wrong"
    assert "17.3 kg" in lines[0] and any("read 100 % of it" in line for line in lines)
    found = json.loads(check(capsys, bag_path("test1"), "--json"))
    assert found["wrong"] == [] and found["streams"]["joint_states"]["rate_hz"] == pytest.approx(200.0, abs=10.0)
    assert found["phases"]["LEFT"] == pytest.approx(found["phases"]["RIGHT"], rel=0.1)


def scaled(streams, field, factor):
    def change(stream, message):
        return replace(message, **{field: factor * getattr(message, field)}) if stream in streams else message

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (scaled((JOINTS, MOTORS), "position", 180.0 / np.pi), "in degrees"),
        (scaled((MOTORS,), "position", 100.0), "before the gear"),
        (scaled((LEFT, RIGHT), "force", 1.0 / 9.81), "in kilograms"),
        (scaled((LEFT,), "force", -1.0), "wrong sign"),
        (scaled((LEFT, RIGHT), "force", 0.0), "neither foot carries the robot"),
    ],
)
def test_one_sentence_for_one_cause(tmp_path, capsys, change, words):
    out = check(capsys, write_bag(tmp_path / "bag", walk(4.0), change))
    (line,) = [line for line in out.splitlines() if line.startswith("wrong?")]
    assert words in line


def test_joints_that_mimic_others_are_named(tmp_path, capsys):
    """In the model they follow nothing: those in the messages are where these say, others are held at zero."""
    finger = (
        '<link name="tip"/><joint name="finger" type="revolute"><parent link="base_link"/><child link="tip"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="LHipSag"/></joint>'
        "</robot>"
    )
    knee = '<joint name="LKneeSag" type="revolute">'
    text = description().replace("</robot>", finger).replace(knee, f'{knee}<mimic joint="LHipSag" multiplier="-2"/>')
    out = check(capsys, write_bag(tmp_path / "bag", walk(2.0), urdf_text=text))
    assert "<mimic> joints, which the model takes as free: LKneeSag, finger" in out
    (line,) = [line for line in out.splitlines() if line.startswith("wrong?")]
    assert "without finger, which <mimic>" in line


def test_what_is_missing(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", walk(2.0), skip=(MOTORS,))
    assert "motor_states: none" in check(capsys, bag, "--set", "prediction.reference=none")
    assert run(["check", str(tmp_path / "gone")]) == 2
    text, err = capsys.readouterr()
    assert text == "" and len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_real_robot_whose_sensors_were_not_zeroed(capsys):
    out = check(capsys, recording("real/icub_yoga/raw"), "--config", recording("real/icub_yoga/icub02.yaml"))
    assert sum("without load" in line for line in out.splitlines()) == 2
