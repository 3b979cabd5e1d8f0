# SPDX-License-Identifier: BSD-3-Clause
"""What is wrong with a recording rather than with a robot is the first and only thing that a diagnosis says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import LEFT, RIGHT, T0, robot, walk, write_bag

from coman_reduced_model.core.base.nominal import load_nominal, of_another_robot
from coman_reduced_model.core.base.stream_names import IMU, JOINTS, MOTORS, REFERENCE
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.diagnose.data.recording import load
from coman_reduced_model.diagnose.data.streams import clocks_apart
from coman_reduced_model.diagnose.workflow import diagnose
from coman_reduced_model.errors import BagError

OTHER = {LEFT: (RIGHT, "r_sole"), RIGHT: (LEFT, "l_sole")}


def swapped(stream, message):
    return (OTHER[stream][0], replace(message, frame_id=OTHER[stream][1])) if stream in OTHER else (stream, message)


def scaled(streams, field, factor):
    def change(stream, message):
        return stream, replace(message, **{field: factor * getattr(message, field)}) if stream in streams else message

    return change


def late(stream, message):
    return stream, replace(message, stamp_ns=message.stamp_ns + 10**9) if stream in OTHER else message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swapped, "left and right swapped?"),
        (scaled((LEFT, RIGHT), "force", -1.0), "wrong sign?"),
        (scaled((LEFT, RIGHT), "force", 1.0 / 9.81), "in kilograms?"),
        (scaled((JOINTS, MOTORS), "position", 180.0 / np.pi), "in degrees?"),
        (scaled((MOTORS,), "position", 100.0), "before the gear"),
    ],
    ids=["swapped", "sign", "kilograms", "degrees", "gear"],
)
def test_a_recording_that_cannot_be_right_is_refused_with_the_reason(tmp_path, change, words):
    bag = write_bag(tmp_path / "bag", [change(*each) for each in walk(6.0)])
    with pytest.raises(BagError) as error:
        load(bag, Config())
    assert words in str(error.value) and "\n" not in str(error.value) and str(error.value).startswith("bag: ")


def test_a_recording_that_can_be_right_is_read(tmp_path):
    recording, _ = load(write_bag(tmp_path / "bag", walk(6.0)), Config())
    assert not recording.warnings and not recording.clocks


def test_clocks_that_differ_are_said(tmp_path):
    """A second log can be a second late, and its stamps right: so this is no reason to refuse."""
    recording, _ = load(write_bag(tmp_path / "bag", [late(*each) for each in walk(6.0)]), Config())
    assert len([line for line in recording.warnings if "its clock is" in line]) == len(recording.clocks) == 2
    assert recording.clocks[0].startswith("left_foot/wrench: its clock is ")


def test_clocks_that_are_apart_are_said_before_the_search(tmp_path):
    bag = write_bag(tmp_path / "bag", [late(*each) for each in walk(6.0)])

    def notice(line):
        raise KeyboardInterrupt(line)

    with pytest.raises(KeyboardInterrupt, match="^bag: .*clock"):
        diagnose([bag], [], Config(), second_process=False, notice=notice)


@pytest.mark.slow
@pytest.mark.parametrize(("late_s", "said"), [(-1.0, "s behind"), (0.5, None), (5.0, "s ahead of")])
def test_the_clock_of_a_plan_that_no_prediction_needs_is_compared_too(tmp_path, late_s, said):
    """It may come early."""

    def change(stream, message):
        return replace(message, stamp_ns=message.stamp_ns + round(late_s * 1e9)) if stream == REFERENCE else message

    recording, _ = load(write_bag(tmp_path / "bag", walk(6.0, reference=True), change), Config())
    assert [line.partition(": ")[0] for line in recording.clocks] == ([REFERENCE] if said else [])
    assert not said or said in recording.clocks[0] and recording.clocks[0] in recording.warnings


def test_without_log_times_no_clock_is_apart():
    stamps = [(0, each * 10**7) for each in range(600)]  # all log times are 0, as after a conversion
    assert not clocks_apart({JOINTS: stamps, IMU: stamps, REFERENCE: stamps}, 0.05)
    assert (
        len(clocks_apart({JOINTS: [(at, at) for _, at in stamps], IMU: [(at, at + 10**9) for _, at in stamps]}, 0.05))
        == 1
    )


@pytest.mark.parametrize(("mass", "said"), [(None, 0), (1.0, 0), (1.5, 1), ("heavy", 0)])
def test_a_baseline_of_another_robot_is_said(mass, said):
    source = {"robot": "anna"} if mass is None else {"robot": "anna", "mass_kg": mass}
    if isinstance(mass, float):
        source["mass_kg"] = mass * robot().mass
    lines = of_another_robot(replace(load_nominal(), source=source), robot().mass)
    assert len(lines) == said and all("anna" in line for line in lines)


def test_sensors_that_hang_are_said(tmp_path):
    kept, rng = {}, np.random.default_rng(0)

    def hangs(stream, message):
        """The left one, noisy, for half of each second."""
        if stream != LEFT:
            return message
        second, part = divmod((message.stamp_ns - T0) * 1e-9, 1.0)
        noisy = message.force + rng.normal(0.0, 0.5, 3)
        return replace(message, force=kept.setdefault(second, noisy) if part > 0.5 else noisy)

    recording, _ = load(write_bag(tmp_path / "bag", walk(6.0), hangs), Config())
    assert any("does its driver hang?" in line for line in recording.warnings)
