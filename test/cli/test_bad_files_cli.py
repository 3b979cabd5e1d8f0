# SPDX-License-Identifier: BSD-3-Clause
"""Robot descriptions, configurations, bags and folders that are damaged, foreign or not there."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace

import pytest
import yaml
from bad_input_tools import check_bounds, few
from hypothesis import example, given
from hypothesis import strategies as st
from mutations import Mutation, clock_mutations, spoil, value_mutations
from synthetic import JOINTS, LEFT, MOTORS, RIGHT, T0, description, walk, write_bag

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import config_to_yaml
from coman_reduced_model.core.config.schema import Config, parameter_table
from coman_reduced_model.errors import ComanError
from coman_reduced_model.topics import INPUT_TOPICS

# --- robot ---


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
        check_bounds(tmp_path / "out")


@pytest.mark.slow
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
    code, _, err = predict(bag, "--remap", "imu/data:=robot_description")  # nothing needs it
    assert code == 0 and "/robot_description: of type std_msgs/msg/String" in err and "left out" in err


def test_a_urdf_in_the_home_of_the_user(tmp_path, predict, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.urdf").write_text(description())
    bag = write_bag(tmp_path / "bag", walk(0.5), urdf_text="")
    code, _, err = predict(bag, "--set", "robot.urdf=~nobody_of_this_name/mine.urdf")
    assert code == 2 and "the URDF cannot be read" in err
    code, _, err = predict(bag, "--set", "robot.urdf=~/mine.urdf")
    assert code == 0, err


def test_why_most_wrenches_are_refused_is_why_nothing_is_predicted(tmp_path, predict):
    def elsewhere(stream, message):
        return (
            replace(message, frame_id="nowhere") if stream == LEFT and message.stamp_ns > T0 + 50_000_000 else message
        )

    code, _, err = predict(write_bag(tmp_path / "bag", walk(1.0), elsewhere), "--set", "support.weight=20000")
    assert code == 2 and "nothing could be predicted" in err and "nowhere" in err


def test_log_times_of_another_clock_change_nothing_but_the_log_times(tmp_path, predict):
    """A simulator stamps from zero on, its recorder logs by the clock of the machine."""
    shifted = write_bag(tmp_path / "bag", walk(2.0), lambda _, m: replace(m, stamp_ns=m.stamp_ns - T0 + 10**10))
    code, _, err = predict(shifted)
    assert code == 0, err
    with Bag(tmp_path / "out" / "predictions") as predictions:
        assert abs(predictions.start_ns - 10**10) < 10**8 and predictions.duration_s < 3.0


@pytest.mark.parametrize("remap", ["a", "a=b", "a:=", ":=b", "a b:=c", "a:=1x"])
def test_names_that_are_none(short, predict, remap):
    code, _, err = predict(short, "--remap", remap)
    assert code == 2 and remap in err
    assert predict(short, "--namespace", "a b")[0] == 2


@pytest.mark.slow
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


@pytest.fixture
def figures(tmp_path, predict):
    """What is predicted of messages in their order of arrival."""

    def call(messages):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        _, summary, _ = predict(write_bag(tmp_path / "bag", messages))
        return {key: summary[key] for key in ("samples", "mse_m2", "rmse_rigid_m", "phases_s", "skill", "flags")}

    return call


@pytest.fixture
def in_order(figures):
    return figures(walk(0.8))


@pytest.mark.slow
@few
@given(st.randoms(use_true_random=False), st.integers(0, 20))
def test_messages_that_arrive_in_another_order(figures, in_order, random, milliseconds):
    """Up to half of streams.max_wait, the order of arrival changes nothing at all."""
    delays = {stream: random.uniform(0.0, milliseconds * 1e6) for stream in (JOINTS, MOTORS, LEFT, RIGHT)}
    assert figures(sorted(walk(0.8), key=lambda item: item[1].stamp_ns + delays[item[0]])) == in_order


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
