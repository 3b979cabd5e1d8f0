# SPDX-License-Identifier: BSD-3-Clause
"""Bad input on the command line: every row of the list has a defined behaviour, is counted and is said.

Bad messages cost themselves, never the run; bad files are refused in one line with exit code 2; there is never a
traceback, and nothing that is missing becomes zero.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bad_input_tools import SECONDS, check_bounds
from synthetic import JOINTS, LEFT, MOTORS, RIGHT, T0, names, walk, write_bag

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.cli.main import run

BAGS = Path(__file__).resolve().parents[2] / "bags"
SAMPLES = 400


def at(stream, index, **changes):
    """Changes to the one message of a stream with that index."""
    seen = -1

    def change(name, message):
        nonlocal seen
        if name != stream:
            return message
        seen += 1
        if seen != index:
            return message
        return replace(message, **{key: value(message) if callable(value) else value for key, value in changes.items()})

    return change


def where(stream, test, **changes):
    """Changes to all messages of a stream at times [s] that pass a test."""

    def change(name, message):
        if name not in np.atleast_1d(stream) or not test((message.stamp_ns - T0) * 1e-9):
            return message
        return replace(message, **{key: value(message) if callable(value) else value for key, value in changes.items()})

    return change


def with_value(array, value):
    return lambda message: np.append(getattr(message, array)[:-1], value)


# --- values ---


@pytest.mark.slow
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("stream", "array"),
    [(JOINTS, "position"), (JOINTS, "velocity"), (MOTORS, "position"), (LEFT, "force"), (RIGHT, "torque")],
)
def test_nan_or_infinite_values(spoiled, stream, array, value):
    summary = spoiled(at(stream, 100, **{array: with_value(array, value)}))
    assert summary["rejected"] == {f"{stream}/nan": 1}
    assert summary["samples"] == SAMPLES - (stream == JOINTS)
    assert summary["rmse_m"]["x"] is not None


def test_a_missing_joint(spoiled):
    summary = spoiled(where(JOINTS, lambda t: 1.0 < t < 1.1, names=lambda m: ("nobody", *m.names[1:])))
    assert summary["rejected"] == {"joint_states/missing_joint": 19}
    assert names()[0] in summary["last_rejection"]["joint_states/missing_joint"]


def test_a_joint_that_is_missing_from_the_whole_bag(unpredictable):
    error = unpredictable(where(JOINTS, lambda t: True, names=lambda m: ("nobody", *m.names[1:])))
    assert "joint_states: joint" in error and names()[0] in error


def test_wrenches_that_are_all_zero(unpredictable):
    error = unpredictable(where([LEFT, RIGHT], lambda t: True, force=np.zeros(3), torque=np.zeros(3)))
    assert "neither foot carries the robot" in error


def test_the_last_sentence_of_each_reason_is_printed(tmp_path, predict):
    nan = at(JOINTS, 100, position=with_value("position", math.nan))
    frame = where(LEFT, lambda t: 1.0 < t < 1.1, frame_id="r_sole")
    bag = write_bag(tmp_path / "bag", walk(SECONDS), lambda stream, message: nan(stream, frame(stream, message)))
    code, summary, err = predict(bag)
    assert code == 0 and len(summary["last_rejection"]) == 2
    for reason, sentence in summary["last_rejection"].items():
        assert f"warning: rejected {summary['rejected'][reason]}: {sentence}" in err


def test_an_extra_joint(spoiled):
    def extra(message):
        return replace(
            message,
            names=("gripper", *message.names),
            position=np.append(9.0, message.position),
            velocity=np.append(9.0, message.velocity),
            effort=None,
        )

    plain = spoiled(None)
    summary = spoiled(lambda stream, message: extra(message) if stream in (JOINTS, MOTORS) else message)
    assert summary["rejected"] == {} and summary["extra_joints"] == ["gripper"]
    assert summary["rmse_m"] == plain["rmse_m"]


def test_a_renamed_joint_is_refused_by_the_configuration(spoiled, predict, tmp_path):
    bag = write_bag(tmp_path / "bag", walk(SECONDS))
    wrong = "[LHipSag, LHipLat, LHipYaw, LKnee, LAnkSag, LAnkLat]"
    code, _, err = predict(bag, "--set", f"robot.left.joints={wrong}")
    assert code == 2 and "LKnee" in err and "LKneeSag" in err


@pytest.mark.parametrize("array", ["position", "velocity", "effort"])
def test_arrays_of_unequal_length(spoiled, array):
    summary = spoiled(at(JOINTS, 50, **{array: np.zeros(5)}))
    assert summary["rejected"] == {"joint_states/length": 1} and summary["samples"] == SAMPLES - 1


def scaled_walk(path, factor, topics):
    """Five seconds of a shipped walk with other joint positions."""
    with Bag(BAGS / "test1") as opened, BagWriter(path, opened.topics, ("/robot_description",)) as writer:
        for topic, log_time, message in opened.messages(opened.topics):
            if log_time > opened.start_ns + 5_000_000_000:
                return path
            if topic in topics:
                message.position = factor * message.position
            writer.write(topic, log_time, message)
    return path


@pytest.mark.slow
@pytest.mark.timeout(300, method="thread")  # the report drew lines that left the figure for good
def test_springs_that_carry_no_robot(tmp_path, capsys):
    """Predictions beyond physics are restarts with their flag, no table says inf, and the page says what it hides."""
    out = tmp_path / "out"
    capsys.readouterr()
    weak = [f"robot.{side}.stiffness=[5, 5, 5, 5, 5, 5]" for side in ("left", "right")]
    assert run(["predict", str(BAGS / "test1"), "--out", str(out), "--set", weak[0], "--set", weak[1]]) == 0
    text, err = capsys.readouterr()
    assert "inf" not in text and "nan" not in text and "RuntimeWarning" not in err
    assert json.loads((out / "summary.json").read_text())["flags"]["REJECTED_STATE"] > 5
    check_bounds(out)
    assert run(["report", str(out)]) == 0
    page = (out / "report.html").read_text()
    assert "which is beyond physics. It was restarted from the measurement" in page


@pytest.mark.parametrize("topics", [("/joint_states",), ("/joint_states", "/motor_states")])
def test_joint_positions_in_degrees(tmp_path, predict, topics):
    code, _, err = predict(scaled_walk(tmp_path / "bag", 180.0 / math.pi, topics))
    assert code == 2 and "in degrees?" in err and "rad, by far beyond its limits" in err


def test_bytes_that_are_no_message(predict, tmp_path):
    bag = write_bag(tmp_path / "bag", walk(SECONDS))
    with Bag(bag) as opened, BagWriter(tmp_path / "bad", opened.topics) as writer:
        for k, (topic, log_time, raw) in enumerate(opened.raw(opened.topics)):
            writer.write_raw(topic, log_time, raw[:20] if k % 100 == 50 else raw)
    code, summary, _ = predict(tmp_path / "bad")
    assert code == 0 and sum(summary["rejected"].values()) == 16
    assert all(key.endswith("/malformed") for key in summary["rejected"])


# --- stamps ---


@pytest.mark.slow
@pytest.mark.parametrize("stream", [JOINTS, MOTORS, LEFT])
@pytest.mark.parametrize(
    ("reason", "stamp"),
    [
        ("stamp_back", lambda message: message.stamp_ns - 20_000_000),
        ("stamp_repeated", lambda message: message.stamp_ns - 5_000_000),
        ("zero_stamp", 0),
        ("stamp_jump", lambda message: message.stamp_ns + 10**12),
        ("stamp_jump", lambda message: message.stamp_ns - 10**12),
    ],
)
def test_stamps_that_go_back_repeat_jump_or_are_zero(spoiled, stream, reason, stamp):
    summary = spoiled(at(stream, 100, stamp_ns=stamp))
    assert summary["rejected"] == {f"{stream}/{reason}": 1}
    assert summary["samples"] == SAMPLES - (stream == JOINTS) and summary["restarts"] == 0


def test_all_stamps_are_zero(unpredictable):
    error = unpredictable(lambda stream, message: replace(message, stamp_ns=0))
    assert "the header is not filled in" in error


def test_a_bag_that_was_played_twice(tmp_path, predict):
    code, summary, _ = predict(write_bag(tmp_path / "bag", walk(SECONDS) * 2))
    assert code == 0 and summary["restarts"] == 1 and summary["samples"] == 2 * SAMPLES and summary["rejected"] == {}


# --- streams ---


def test_a_stream_that_stops(spoiled):
    summary = spoiled(lambda stream, message: None if stream == LEFT and message.stamp_ns > T0 + 10**9 else message)
    assert summary["samples"] == SAMPLES
    assert summary["incomplete"]["left_foot/wrench"] == pytest.approx(190, abs=2)
    assert summary["flags"]["STALE_WRENCH"] == summary["incomplete"]["left_foot/wrench"]
    assert any("left_foot/wrench: no message for the last" in line for line in summary["warnings"])


def test_a_stream_that_stops_and_comes_back(spoiled):
    summary = spoiled(where(RIGHT, lambda t: False), seconds=SECONDS)
    gap = spoiled(lambda stream, m: None if stream == RIGHT and 0.8 < (m.stamp_ns - T0) * 1e-9 < 1.2 else m)
    assert gap["samples"] == summary["samples"] and gap["warnings"] == []
    assert 60 <= gap["incomplete"]["right_foot/wrench"] <= 72


def test_joint_states_that_stop_and_come_back(spoiled):
    summary = spoiled(lambda stream, m: None if stream == JOINTS and 0.8 < (m.stamp_ns - T0) * 1e-9 < 1.2 else m)
    assert summary["restarts"] == 1 and summary["samples"] == pytest.approx(320, abs=2)


def test_a_stream_that_starts_late(spoiled):
    summary = spoiled(lambda stream, m: None if stream == MOTORS and m.stamp_ns < T0 + 10**9 else m)
    assert summary["samples"] == SAMPLES
    assert summary["flags"]["NO_REFERENCE"] == pytest.approx(195, abs=3)


@pytest.mark.parametrize("shift_s", [-3600.0, -1.0, 3600.0])
def test_wrench_and_joint_clocks_that_differ(unpredictable, shift_s):
    error = unpredictable(where([LEFT, RIGHT], lambda t: True, stamp_ns=lambda m: m.stamp_ns + round(shift_s * 1e9)))
    assert "its clock is" in error and ("behind" if shift_s < 0 else "ahead of") in error
    assert float(re.search(r"is ([\d.]+) s", error)[1]) == pytest.approx(abs(shift_s), abs=0.1)


def test_wrenches_that_are_stamped_a_second_late(spoiled):
    summary = spoiled(where([LEFT, RIGHT], lambda t: True, stamp_ns=lambda m: m.stamp_ns + 1_000_000_000))
    assert summary["samples"] == SAMPLES
    assert len([line for line in summary["warnings"] if "its clock is" in line and "ahead of" in line]) == 2


def test_swapped_feet(tmp_path, predict):
    other = {LEFT: (RIGHT, "r_sole"), RIGHT: (LEFT, "l_sole")}
    swapped = [
        (other[stream][0], replace(message, frame_id=other[stream][1])) if stream in other else (stream, message)
        for stream, message in walk(6.0)
    ]
    _, summary, err = predict(write_bag(tmp_path / "bag", swapped))
    assert any("swapped" in line for line in summary["warnings"]) and "swapped" in err
    assert summary["suspect"]["wrenches/swapped"] > 50


@pytest.mark.slow
def test_a_foot_sensor_that_was_not_zeroed(spoiled):
    summary = spoiled(where(LEFT, lambda t: True, force=lambda m: m.force + np.array([0.0, 0.0, 80.0])), seconds=6.0)
    assert [line.split(":")[0] for line in summary["warnings"] if "taken off" in line] == [LEFT]


@pytest.mark.parametrize("frame", ["r_sole", "nowhere"])
def test_wrong_frame_of_a_wrench(unpredictable, frame):
    error = unpredictable(where(LEFT, lambda t: True, frame_id=frame))
    assert "left_foot/wrench" in error and frame in error


def test_wrong_sign_of_the_vertical_force(spoiled, unpredictable):
    summary = spoiled(where(LEFT, lambda t: True, force=lambda m: -m.force), seconds=4.0)
    assert [line.split(":")[0] for line in summary["warnings"] if "sign" in line] == [LEFT]
    assert summary["suspect"][f"{LEFT}/negative"] > 50
    error = unpredictable(where([LEFT, RIGHT], lambda t: True, force=lambda m: -m.force), seconds=4.0)
    assert LEFT in error and "wrong sign?" in error
