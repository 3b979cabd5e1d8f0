# SPDX-License-Identifier: BSD-3-Clause
"""Worlds: drawn by seed, printed, stored, set by hand, recorded."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from coman_reduced_model.bag.session import Session
from coman_reduced_model.cli.main import run as coman
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.offline import predict_bag
from coman_reduced_model.sim.contact import Contact
from coman_reduced_model.sim.controller import Controller
from coman_reduced_model.sim.record import load_truth
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.worlds import AXES, World, draw_world, read_world, record_world, world_of, world_yaml
from coman_reduced_model.sim.worlds.draw import plain_kinds, world_for
from coman_reduced_model.sim.worlds.world import world_from_yaml

KINDS = [(axis, kind) for axis, kinds in AXES.items() for kind in kinds]
WORLDS = max(map(len, AXES.values()))
SHORT = 3.2  # [s] two steps


@given(st.integers(0, 2**31))
@settings(max_examples=80, deadline=None)
def test_a_world_survives_its_yaml(seed):
    world = draw_world(seed)
    assert world_from_yaml(world_yaml(world)) == world
    assert draw_world(seed) == world


@given(st.integers(0, 2**31), st.sampled_from(KINDS))
@settings(max_examples=60, deadline=None)
def test_to_fix_one_axis_leaves_the_others_as_they_were(seed, axis_and_kind):
    axis, kind = axis_and_kind
    free, fixed = draw_world(seed), draw_world(seed, {axis: kind})
    assert fixed.kinds[axis] == kind and fixed.robot == free.robot
    depends = {"contact"} if axis == "engine" else set()  # not each engine has each contact
    if free.engine != (AXES[axis][kind].only_engine or free.engine):
        depends = {"engine", "contact"}
    for other in set(AXES) - {axis} - depends:
        assert fixed.kinds[other] == free.kinds[other]


@pytest.mark.parametrize(("axis", "kind"), [pair for pair in KINDS if AXES[pair[0]][pair[1]].only_engine])
def test_a_kind_that_one_engine_has_takes_that_engine(axis, kind):
    engine = AXES[axis][kind].only_engine
    worlds = [draw_world(seed, {axis: kind}) for seed in range(20)]
    assert {world.engine for world in worlds} == {world.kinds["engine"] for world in worlds} == {engine}
    for fixed in ({"engine": "drake", axis: kind}, {axis: kind, "engine": "drake"}):
        with pytest.raises(ConfigError, match=f"(drake and {kind}|{kind} and drake) exclude each other: they need"):
            draw_world(0, fixed)
    assert draw_world(2, {"engine": engine, axis: kind}) == draw_world(2, {axis: kind})


def test_no_world_has_a_kind_that_its_engine_does_not_have():
    worlds = [draw_world(seed, fixed) for seed in range(100) for fixed in ({}, {"engine": "drake"})]
    for world in worlds:
        assert {AXES[axis][kind].only_engine for axis, kind in world.kinds.items()} <= {"", world.engine}


def test_kinds_come_up_as_often_as_their_weights_say():
    worlds = [draw_world(seed) for seed in range(600)]
    for axis in set(AXES) - {"contact"}:
        total = sum(kind.weight for kind in AXES[axis].values())
        for name, kind in AXES[axis].items():
            share = np.mean([world.kinds[axis] == name for world in worlds])
            assert share == pytest.approx(kind.weight / total, abs=0.07), (axis, name)


def test_the_plain_world_is_the_virtual_robot_with_foot_sensors_that_average():
    plain = world_of("plain")
    averaging = SensorOptions(wrench_average=True)
    assert plain == World(kinds=plain_kinds(), robot=plain.robot, sensors=averaging) and plain.robot == "coman"


def test_the_population_is_as_wide_as_it_is_said_to_be():
    worlds = [draw_world(seed) for seed in range(600)]
    sensors = [world.sensors for world in worlds]
    assert {world.engine for world in worlds} == {"mujoco", "drake"}
    assert {world.controller.kind for world in worlds} == {"none", "imu", "feet"}
    assert min(s.encoder_bits for s in sensors) == 10 and max(s.encoder_bits for s in sensors) == 19
    assert max(s.wrench_zero for s in sensors) > 250.0
    assert {world.reference for world in worlds} == {True, False}
    assert {len(world.table.joint_names) for world in worlds} == {12, *range(20, 31)}
    assert {world.sensors.encoder_bits for world in worlds} == set(range(10, 20))
    for kind, low, high in (("imu", 0.08, 0.2), ("feet", 0.04, 0.09)):
        gains = [world.controller.ankle for world in worlds if world.controller.kind == kind]
        assert low <= min(gains) < 1.2 * low and 0.9 * high < max(gains) <= high
    assert min(world.duration_s for world in worlds) < 6.0 and max(world.duration_s for world in worlds) > 50.0
    frictions = [world.contact.friction or world.table.friction for world in worlds]
    assert min(frictions) < 0.35 and max(frictions) > 1.1


def mixed(number: int) -> dict[str, str]:
    """Kinds of a world; in as many worlds as the longest axis has kinds, every kind that is drawn comes up."""
    drawn = {axis: [name for name, kind in kinds.items() if kind.weight] for axis, kinds in AXES.items()}
    chosen = {axis: kinds[number % len(kinds)] for axis, kinds in drawn.items()}
    return {**chosen, "engine": "drake" if number == 2 else "mujoco"}  # slow


def test_mixed_worlds_hold_every_kind():
    assert {(axis, kind) for number in range(WORLDS) for axis, kind in mixed(number).items()} == {
        (axis, kind) for axis, kind in KINDS if AXES[axis][kind].weight
    }


@pytest.mark.slow
@pytest.mark.parametrize("number", range(WORLDS))
def test_every_kind_walks_two_steps_and_is_recorded_as_it_says(tmp_path, number):
    kinds = mixed(number)
    if kinds["engine"] == "drake" and importlib.util.find_spec("pydrake") is None:
        pytest.skip("drake is not installed")
    world = replace(draw_world(3, kinds), duration_s=SHORT)
    result = record_world(world, tmp_path / "walk")
    assert result.fallen_s is None
    assert read_world(tmp_path / "walk.world.yaml") == world
    counts = result.messages
    assert ("/com/reference" in counts) == world.reference
    assert (counts["/imu/data"] > 0) == world.sensors.imu
    assert (counts["/motor_states"] > 0) == world.sensors.motor_states
    assert counts["/joint_states"] > 0.98 * result.duration_s * world.sensors.rate_hz / world.sensors.joints_every
    with AnyReader([tmp_path / "walk"]) as reader:
        joints = [c for c in reader.connections if c.topic == "/joint_states"]
        connection, _, raw = next(reader.messages(joints))
        message = reader.deserialize(raw, connection.msgtype)
        assert list(message.name) == list(world.table.joint_names)
        assert bool(len(message.effort)) == world.sensors.effort


@pytest.mark.slow
def test_the_same_world_and_seed_are_the_same_bag(tmp_path):
    world = replace(draw_world(8, {"engine": "mujoco"}), duration_s=SHORT)
    truths = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        (tmp_path / name).mkdir()
        record_world(world, tmp_path / name / "walk", seed=seed)
        truths.append(load_truth(tmp_path / name / "walk.truth.npz"))
    bags = [(tmp_path / name / "walk" / "walk.mcap").read_bytes() for name in "abc"]
    assert bags[0] == bags[1] != bags[2]
    assert np.array_equal(truths[0]["q"], truths[1]["q"])


@pytest.mark.slow
@pytest.mark.parametrize("gait", ["test1", "test2"])
@pytest.mark.parametrize("seed", range(2))
def test_clean_robots_walk_the_papers_gaits(tmp_path, seed, gait):
    world = draw_world(100 + seed, {"gait": gait, "engine": "mujoco"})
    assert record_world(replace(world, duration_s=8.0), tmp_path / "walk").fallen_s is None


# --- set by hand ---


def test_a_file_may_hold_only_what_differs(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("robot: tall\ncontact: {friction: 0.4}\nsensors: {rate_hz: 500}\ncontroller: {kind: imu}\n")
    world = read_world(path)
    assert world.robot == "tall" and world.contact == Contact(friction=0.4)
    assert world.sensors == SensorOptions(rate_hz=500.0) and world.controller == Controller(kind="imu")
    assert world_of(str(path)) == world


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot: asimo", "world: robot = 'asimo': allowed: coman"),
        ("engine: bullet", "world: engine = 'bullet': allowed: mujoco, drake"),
        ("colour: red", "world.colour: unknown key"),
        ("contact: {slime: 1}", "world.contact.slime: unknown key"),
        ("contact: hard", "world.contact = 'hard': allowed: a mapping"),
        ("contact: {friction: wet}", "world.contact.friction = 'wet'"),
        ("sensors: {imu: 1}", "world.sensors.imu = 1"),
        ("imu_turn: [1, 2]", "world.imu_turn"),
        ("- a\n- b", "world = "),
        ("{", "no YAML"),
        ("contact: {impratio: -1}", "impratio"),
    ],
)
def test_a_file_that_is_not_a_world_is_refused_in_one_line(tmp_path, capsys, text, words):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    assert coman(["worlds", str(path)]) == 2
    message = capsys.readouterr().err
    assert words in message and "bad.yaml" in message and message.count("\n") == 1


VALUES = st.none() | st.booleans() | st.floats() | st.text(max_size=5)
KEYS = st.sampled_from(["robot", "contact", "friction", "sensors", "gait_changes", "kinds", "x"])


@given(st.recursive(VALUES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner), max_leaves=8))
@settings(max_examples=100, deadline=None)
def test_any_yaml_is_a_world_or_refused(value):
    try:
        assert isinstance(world_from_yaml(yaml.safe_dump(value)), World)
    except ConfigError as error:
        assert "\n" not in str(error)


def test_what_is_no_world_is_said_with_what_is(capsys):
    assert coman(["worlds", "moon"]) == 2
    message = capsys.readouterr().err
    assert "'moon': no file, no seed and no kind" in message and "creeping" in message and message.count("\n") == 1


def test_the_world_of_another_robot_is_refused():
    with pytest.raises(ConfigError, match="its robot is tall, and robot.name is coman"):
        world_for("coman", str(next(seed for seed in range(100) if draw_world(seed).robot == "tall")))
    assert world_for("my_robot", "creeping") == world_of("creeping")


def test_a_turned_imu_is_turned_in_the_urdf_and_in_its_messages(tmp_path):
    """Where the URDF says that it hangs, level ground is level, and its orientation and acceleration agree."""
    world = world_from_yaml("imu_turn: [0.3, -0.4, 2.0]\nduration_s: 3.2\n")
    record_world(world, tmp_path / "walk")
    with Session(tmp_path / "walk", Config()) as session:
        imus = [sample.imu for sample in session.samples() if sample.imu is not None]
        upward = np.array([Rotation.from_quat(imu.orientation).inv().apply([0.0, 0.0, 1.0]) for imu in imus])
        felt = np.mean([imu.linear_acceleration for imu in imus], axis=0)
        ground = predict_bag(session, tmp_path / "out")["ground"]
    assert felt / np.linalg.norm(felt) == pytest.approx(upward.mean(axis=0), abs=0.03)
    assert np.arccos(upward[:, 2]).min() > 0.3
    level = {"roll_rad": pytest.approx(0.0), "pitch_rad": pytest.approx(0.0)}
    assert ground == {"source": "imu", **level, "aslant_landings": 0}


# --- the commands ---


def test_the_command_lists_all_kinds_and_prints_a_world(tmp_path, capsys):
    assert coman(["worlds"]) == 0
    printed = capsys.readouterr().out
    assert all(kind in printed for _, kind in KINDS)
    assert coman(["worlds", "--json"]) == 0
    assert {axis: set(kinds) for axis, kinds in json.loads(capsys.readouterr().out).items()} == {
        axis: set(kinds) for axis, kinds in AXES.items()
    }
    assert coman(["worlds", "7"]) == 0
    assert world_from_yaml(capsys.readouterr().out) == draw_world(7)


def test_a_world_is_recorded_by_the_command_and_can_be_recorded_again(tmp_path, capsys):
    for name in "ab":
        (tmp_path / name).mkdir()
    assert coman(["record", "--out", str(tmp_path / "a" / "walk"), "--world", "creeping", "--duration", "3"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("world: ")]
    assert "mujoco, creeping, level" in line and "robot " in line and line.endswith("walk.world.yaml")
    again = ["record", "--out", str(tmp_path / "b" / "walk"), "--world", str(tmp_path / "a" / "walk.world.yaml")]
    assert coman(again) == 0
    bags = [(tmp_path / name / "walk" / "walk.mcap").read_bytes() for name in "ab"]
    assert bags[0] == bags[1]
    for option in (["--exact"], ["--config", "x.yaml"], ["--set", "gait.steps=3"]):
        assert coman([*again, *option]) == 2
        assert f"{option[0]}: not with --world" in capsys.readouterr().err
    assert coman(["record", "--out", str(tmp_path / "c"), "--set", "robot.gravity=3.7"]) == 2
    assert (
        "--set robot.gravity=3.7: only gait.* counts here" in capsys.readouterr().err and not (tmp_path / "c").exists()
    )
