# SPDX-License-Identifier: BSD-3-Clause
"""Bad input on the command line: every row of the list has a defined behaviour, is counted and is said.

Bad messages cost themselves, never the run; bad files are refused in one line with exit code 2; there is never a
traceback, and nothing that is missing becomes zero.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mutations import Mutation, clock_mutations, spoil, value_mutations
from synthetic import JOINTS, LEFT, MOTORS, RIGHT, T0, description, names, walk, write_bag

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.limits import DIVERGED
from coman_reduced_model.core.base.types import Flags
from coman_reduced_model.core.config.files import config_to_yaml
from coman_reduced_model.core.config.schema import Config, parameter_table
from coman_reduced_model.errors import ComanError
from coman_reduced_model.topics import INPUT_TOPICS

BAGS = Path(__file__).resolve().parents[2] / "bags"
few = settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
SECONDS, SAMPLES = 2.0, 400


@pytest.fixture
def predict(tmp_path, capsys):
    """Runs `coman predict` on a bag; gives exit code, summary and standard error. Never a traceback."""

    def call(bag, *arguments):
        out = tmp_path / "out"
        shutil.rmtree(out, ignore_errors=True)
        capsys.readouterr()
        code = run(["predict", str(bag), "--out", str(out), "--json", *map(str, arguments)])
        text, err = capsys.readouterr()
        assert "Traceback" not in err
        if code:
            assert code == 2 and text == "" and not out.exists()
            lines = [line for line in err.splitlines() if line.startswith("coman: ")]
            assert len(lines) == 1, err
        return code, json.loads(text) if text else None, err

    return call


@pytest.fixture
def unpredictable(tmp_path, predict):
    """Runs `coman predict` on a walk so spoiled that there is no prediction; gives the one line of the error."""

    def call(change, seconds=SECONDS):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        code, _, err = predict(write_bag(tmp_path / "bag", walk(seconds), change))
        assert code == 2, "nothing was predicted"
        (line,) = [line for line in err.splitlines() if "nothing could be predicted" in line]
        return line

    return call


@pytest.fixture
def spoiled(tmp_path, predict):
    """Runs `coman predict` on a walk whose messages `change` has spoiled; it must succeed."""

    def call(change, *arguments, seconds=SECONDS):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        bag = write_bag(tmp_path / "bag", walk(seconds), change)
        code, summary, err = predict(bag, *arguments)
        assert code == 0, err
        return summary

    return call


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


@pytest.mark.timeout(300, method="thread")  # the report drew lines that left the figure for good
@pytest.mark.parametrize("topics", [("/joint_states",), ("/joint_states", "/motor_states")])
def test_joint_positions_in_degrees(tmp_path, capsys, topics):
    """Predictions beyond physics are restarts with their flag, no table says inf, and the page says what it hides."""
    with Bag(BAGS / "test1") as opened, BagWriter(tmp_path / "bag", opened.topics, ("/robot_description",)) as writer:
        for topic, log_time, message in opened.messages(opened.topics):
            if log_time > opened.start_ns + 5_000_000_000:
                break
            if topic in topics:
                message.position = np.degrees(message.position)
            writer.write(topic, log_time, message)
    out = tmp_path / "out"
    capsys.readouterr()
    assert run(["predict", str(tmp_path / "bag"), "--out", str(out)]) == 0
    text, err = capsys.readouterr()
    assert "inf" not in text and "nan" not in text and "RuntimeWarning" not in err
    rejected = json.loads((out / "summary.json").read_text())["flags"]["REJECTED_STATE"]
    assert rejected > 50 and f"predictions diverged in {rejected} of " in err
    _check_bounds(out)
    assert run(["report", str(out)]) == 0
    page = (out / "report.html").read_text()
    assert "which is beyond physics. It was restarted from the measurement" in page


def _check_bounds(out):
    """What `coman predict` wrote is physically possible, or NaN with a flag."""
    with Bag(out / "predictions") as written:
        for _, _, message in written.messages(["/com/prediction"]):
            residual = message.residual
            assert not math.hypot(residual.x, residual.y, residual.z) >= DIVERGED
            for each in message.horizons:
                p = each.position
                assert math.isfinite(p.x + p.y + p.z) or message.flags & Flags.REJECTED_STATE


def test_bytes_that_are_no_message(predict, tmp_path):
    bag = write_bag(tmp_path / "bag", walk(SECONDS))
    with Bag(bag) as opened, BagWriter(tmp_path / "bad", opened.topics) as writer:
        for k, (topic, log_time, raw) in enumerate(opened.raw(opened.topics)):
            writer.write_raw(topic, log_time, raw[:20] if k % 100 == 50 else raw)
    code, summary, _ = predict(tmp_path / "bad")
    assert code == 0 and sum(summary["rejected"].values()) == 16
    assert all(key.endswith("/malformed") for key in summary["rejected"])


# --- stamps ---


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


# --- robot ---


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace('"l_sole"', '"foot"'), "l_sole"),
        (lambda text: text.replace('"LKneeSag"', '"Knee"'), "LKneeSag"),
        (lambda text: re.sub(r'mass value="[^"]*"', 'mass value="0"', text), "mass"),
        (lambda text: text[: len(text) // 2], "not XML"),
        (lambda text: "<robot/>", "not a URDF"),
        (lambda text: "hello", "not XML"),
        (lambda text: " ", "empty"),
    ],
)
def test_a_robot_description_that_cannot_be_used(tmp_path, predict, change, words):
    code, _, err = predict(write_bag(tmp_path / "bag", walk(0.1), urdf_text=change(description())))
    assert code == 2 and words in err and "/robot_description" in err
    (tmp_path / "robot.urdf").write_text(change(description()))
    code, _, err = predict(write_bag(tmp_path / "bag2", walk(0.1)), "--urdf", tmp_path / "robot.urdf")
    assert code == 2 and words in err and "robot.urdf" in err


def test_a_robot_description_that_is_not_there(tmp_path, predict):
    bag = write_bag(tmp_path / "bag", walk(0.1))
    code, _, err = predict(bag, "--urdf", tmp_path / "no.urdf")
    assert code == 2 and "no.urdf" in err
    assert predict(bag, "--urdf", tmp_path)[0] == 2
    (tmp_path / "binary.urdf").write_bytes(bytes(range(256)))
    assert predict(bag, "--urdf", tmp_path / "binary.urdf")[0] == 2


# --- configuration ---


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "short", walk(0.1))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("support.contact_onn: 0.2", ["support.contact_onn", "support.contact_on"]),
        ("support.contact_on: lots", ["support.contact_on", "lots", "a number"]),
        ("support.contact_on: 7", ["support.contact_on", "7", "0.9"]),
        ("prediction.reference: motors", ["prediction.reference", "motors", "'motor'"]),
        ("robot.left.joints: [a]", ["robot.left"]),
        ("effects.active: [nonsense]", ["effects.active", "nonsense"]),
    ],
)
def test_a_configuration_with_an_unknown_key_a_wrong_type_or_a_value_out_of_range(
    short, predict, tmp_path, text, words
):
    file = tmp_path / "c.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    {text}\n")
    code, _, err = predict(short, "--config", file)
    assert code == 2 and all(word in err for word in [*words, str(file)])
    key, _, value = text.partition(": ")
    code, _, err = predict(short, "--set", f"{key}={value}")
    assert code == 2 and all(word in err for word in words)


@few
@given(
    st.dictionaries(
        st.one_of(st.sampled_from(sorted(parameter_table())), st.text(max_size=8)),
        st.recursive(
            st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
            lambda inner: st.one_of(
                st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=3), inner, max_size=2)
            ),
            max_leaves=5,
        ),
        min_size=1,
        max_size=3,
    )
)
def test_any_values_in_a_configuration(short, predict, tmp_path, values):
    file = tmp_path / "c.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
    predict(short, "--config", file)


@few
@given(st.one_of(st.binary(max_size=60), st.text(max_size=60).map(str.encode)))
def test_any_bytes_as_a_configuration(short, predict, tmp_path, content):
    file = tmp_path / "c.yaml"
    file.write_bytes(content)
    code, _, err = predict(short, "--config", file)
    assert code == 2 and str(file) in err


@few
@given(st.data())
def test_a_configuration_with_a_damaged_line(short, predict, tmp_path, data):
    lines = config_to_yaml(Config()).splitlines()
    index = data.draw(st.integers(0, len(lines) - 1))
    cut = data.draw(st.integers(0, len(lines[index])))
    lines[index] = lines[index][:cut] + data.draw(st.text(max_size=5)) + lines[index][cut + 1 :]
    file = tmp_path / "c.yaml"
    file.write_text("\n".join(lines))
    predict(short, "--config", file)


# --- bags ---


@few
@given(
    st.lists(st.one_of(clock_mutations, value_mutations), min_size=1, max_size=4),
    st.sampled_from(["motor", "topic", "none"]),
    st.booleans(),
)
@example([Mutation("jumps", frozenset({JOINTS}), 0.5, 1.0, -300_000_000)], "motor", False)
def test_bags_of_messages_that_are_spoiled(predict, tmp_path, mutations, source, paper):
    """No traceback (the fixture looks for it), and what is counted adds up."""
    shutil.rmtree(tmp_path / "bag", ignore_errors=True)
    bag = write_bag(tmp_path / "bag", spoil(walk(0.5, 100.0, reference=True), mutations))
    model = ["--set", "model.trunk_rotation=without"] if paper or source == "topic" else []
    code, summary, _ = predict(bag, "--set", f"prediction.reference={source}", *model)
    if code == 0:
        assert summary["samples"] == summary["streams"][JOINTS]["accepted"]
        _check_bounds(tmp_path / "out")


def test_bags_that_are_truncated(tmp_path, predict):
    bag = write_bag(tmp_path / "bag", walk(20.0))
    raw = next(bag.glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(raw[: len(raw) * 6 // 10])
    code, summary, err = predict(cut)
    assert code == 0 and 1500 < summary["samples"] < 3000
    assert re.search(r"warning: .*cut.mcap.*byte \d+ of \d+.* messages, .* s", err)
    assert summary["warnings"]


def test_bags_that_are_empty_of_another_format_or_not_there(tmp_path, predict):
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "other.mcap").write_text("something else")
    (tmp_path / "ros1.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "folder").mkdir()
    with BagWriter(tmp_path / "none", {"/joint_states": "sensor_msgs/msg/JointState"}):
        pass
    for name in ("empty.mcap", "other.mcap", "ros1.bag", "folder", "none", "nowhere"):
        code, _, err = predict(tmp_path / name)
        assert code == 2 and name in err


@pytest.mark.parametrize("missing", [JOINTS, MOTORS, LEFT, RIGHT])
def test_bags_without_a_needed_topic(tmp_path, predict, missing):
    code, _, err = predict(write_bag(tmp_path / "bag", walk(0.2), skip=[missing]))
    assert code == 2 and f"no topic /{missing}" in err
    assert "topics of the bag: " in err
    assert ("`none` does without" in err) == (missing == MOTORS)


@pytest.mark.parametrize("empty", [LEFT, MOTORS])
def test_a_topic_that_is_there_and_empty_is_missing(empty, tmp_path, predict):
    code, _, err = predict(write_bag(tmp_path / "bag", walk(0.2), lambda s, m: None if s == empty else m))
    topic = f"/{INPUT_TOPICS[empty]}"
    assert code == 2 and f"no topic {topic}; topics of the bag: " in err and f"{topic} (no message)" in err


def test_a_topic_of_another_type(tmp_path, predict):
    bag = write_bag(tmp_path / "bag", walk(0.2))
    code, _, err = predict(bag, "--remap", "joint_states:=robot_description")
    assert code == 2 and "std_msgs/msg/String" in err and "sensor_msgs/msg/JointState" in err
    code, _, err = predict(bag, "--remap", "joint_states:=left_foot/wrench")
    assert code == 2 and "--remap" in err and "joint_states and left_foot/wrench" in err


@pytest.mark.parametrize("remap", ["a", "a=b", "a:=", ":=b", "a b:=c", "a:=1x"])
def test_names_that_are_none(short, predict, remap):
    code, _, err = predict(short, "--remap", remap)
    assert code == 2 and remap in err
    assert predict(short, "--namespace", "a b")[0] == 2


@few
@given(data=st.data())
def test_bags_with_damaged_bytes(short, predict, tmp_path, data):
    raw = bytearray(next(short.glob("*.mcap")).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    if data.draw(st.booleans()):
        raw = raw[: data.draw(st.integers(0, len(raw)))]
    (tmp_path / "damaged.mcap").write_bytes(raw)
    predict(tmp_path / "damaged.mcap")


@few
@given(st.randoms(use_true_random=False), st.integers(0, 20))
def test_messages_that_arrive_in_another_order(predict, tmp_path, random, milliseconds):
    """Up to half of streams.max_wait, the order of arrival changes nothing at all."""
    delays = {stream: random.uniform(0.0, milliseconds * 1e6) for stream in (JOINTS, MOTORS, LEFT, RIGHT)}
    messages = walk(0.8)
    late = sorted(messages, key=lambda item: item[1].stamp_ns + delays[item[0]])
    results = []
    for order in (messages, late):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        _, summary, _ = predict(write_bag(tmp_path / "bag", order))
        results.append(
            {key: summary[key] for key in ("samples", "mse_m2", "rmse_rigid_m", "phases_s", "skill", "flags")}
        )
    assert results[0] == results[1]


# --- folders ---


def test_a_report_of_what_is_no_result(tmp_path, capsys):
    for content in (None, "", "[]", "{}", '{"samples": 3}'):
        folder = tmp_path / "folder"
        folder.mkdir(exist_ok=True)
        if content is not None:
            (folder / "summary.json").write_text(content)
        assert run(["report", str(folder)]) == 2
        err = capsys.readouterr().err
        assert str(folder) in err and err.count("\n") == 1
    assert run(["report", str(tmp_path / "nowhere")]) == 2


def test_output_that_cannot_be_written(short, predict, tmp_path, capsys):
    (tmp_path / "file").touch()
    assert run(["predict", str(short), "--out", str(tmp_path / "file" / "x")]) == 2
    assert "file" in capsys.readouterr().err


def test_every_error_of_ours_is_one_line():
    with pytest.raises(ComanError) as caught:
        Bag("/nowhere/at/all")
    assert "\n" not in str(caught.value)
