# SPDX-License-Identifier: BSD-3-Clause
"""`coman init` writes a configuration that the other commands take; `coman config` opens the robot of one."""

from __future__ import annotations

import json

import pytest
from conftest import recording
from synthetic import description, walk, write_bag

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.resources import bag_path, config_path


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(description(), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_urdf_is_enough(tmp_path, urdf, capsys):
    out = tmp_path / "robot.yaml"
    assert run(["init", "--urdf", str(urdf), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "17.3 kg" in printed and "guess: robot.left.stiffness" in printed
    text = out.read_text()
    assert "urdf: robot.urdf" in text and "# guess: stiff drives" in text
    settings, coman = load_config(out).robot, load_config(None).robot
    assert settings.left.joints == coman.left.joints and settings.right.sole_frame == coman.right.sole_frame
    assert (settings.foot_length, settings.foot_width) == pytest.approx((0.2, 0.1))
    assert run(["config", str(out)]) == 0
    assert "# robot: coman, 17.30 kg" in capsys.readouterr().out
    assert run(["predict", str(bag_path("stand")), "--config", str(out), "--out", str(tmp_path / "out")]) == 0
    assert run(["config", str(tmp_path / "out" / "config.yaml")]) == 0  # it finds the URDF from its folder as well
    assert run(["init", "--urdf", str(urdf), "--out", str(out)]) == 2  # not over what is there


def test_a_bag_shows_topics_and_springs(tmp_path, capsys):
    out = tmp_path / "robot.yaml"
    assert run(["init", "--bag", str(bag_path("test1")), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["topics"]["joint_states"] == "/joint_states" and result["remaps"] == []
    assert load_config(out).prediction.reference == "motor"
    for side in ("left", "right"):
        known = getattr(load_config(None).robot, side).stiffness
        assert result[f"robot.{side}.stiffness"] == pytest.approx(known, rel=0.05)
        assert f"robot.{side}.damping" in result["guesses"]  # a walk does not show it


def test_topics_of_other_names_are_said(tmp_path, urdf, capsys):
    bag = write_bag(tmp_path / "bag", walk(2.0), namespace="/walker")
    out = tmp_path / "robot.yaml"
    assert run(["init", "--urdf", str(urdf), "--bag", str(bag), "--out", str(out), "--json"]) == 0
    remaps = json.loads(capsys.readouterr().out)["remaps"]
    assert "--remap joint_states:=/walker/joint_states" in remaps and "--remap" in out.read_text()
    arguments = [word for remap in remaps for word in remap.split()]
    assert run(["predict", str(bag), "--config", str(out), "--out", str(tmp_path / "out"), *arguments]) == 0


def test_topics_that_are_named_are_taken(tmp_path, urdf, capsys):
    """Several would do, and none has the nominal name."""
    bag = write_bag(tmp_path / "bag", walk(2.0), namespace="/walker")
    arguments = ["init", "--urdf", str(urdf), "--bag", str(bag), "--out", str(tmp_path / "robot.yaml"), "--json"]
    assert run([*arguments, "--namespace", "walker"]) == 0
    named = json.loads(capsys.readouterr().out)
    assert named["topics"]["joint_states"] == "/walker/joint_states"
    assert run([*arguments, "--force", "--remap", "joint_states:=/walker/motor_states"]) == 0
    assert json.loads(capsys.readouterr().out)["topics"]["joint_states"] == "/walker/motor_states"


def test_a_description_in_a_namespace_is_among_what_is_said(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", walk(2.0), namespace="/walker")
    out = tmp_path / "robot.yaml"
    assert run(["init", "--bag", str(bag), "--namespace", "walker", "--out", str(out), "--json"]) == 0
    arguments = [word for remap in json.loads(capsys.readouterr().out)["remaps"] for word in remap.split()]
    assert "robot_description:=/walker/robot_description" in arguments
    assert "robot_description:=/walker/robot_description" in out.read_text()
    assert run(["check", str(bag), "--config", str(out), *arguments]) == 0


@pytest.mark.slow
def test_a_real_robot(tmp_path, capsys):
    """An iCub: other names, wrenches in the frames of its feet, no shapes but meshes that are not there."""
    out = tmp_path / "icub.yaml"
    bag = recording("real/icub_yoga/zeroed")
    assert run(["init", "--bag", str(bag), "--out", str(out)]) == 0
    assert "foot_length" in capsys.readouterr().out
    found, known = load_config(out).robot, load_config(config_path("icub")).robot
    assert found.left.joints == known.left.joints and found.right.sole_frame == known.right.sole_frame


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "{tmp}/o.yaml"], "--urdf"),
        (["--urdf", "{tmp}/gone.urdf", "--out", "{tmp}/o.yaml"], "gone.urdf"),
        (["--urdf", "{tmp}/robot.urdf", "--left", "l_sole", "--out", "{tmp}/o.yaml"], "--right"),
        (["--bag", "{tmp}/gone", "--out", "{tmp}/o.yaml"], "gone"),
    ],
)
def test_what_is_missing_is_said_in_one_line(tmp_path, urdf, capsys, arguments, words):
    assert run(["init", *(argument.format(tmp=tmp_path) for argument in arguments)]) == 2
    text, err = capsys.readouterr()
    assert text == "" and words in err and len(err.strip().splitlines()) == 1
    assert not (tmp_path / "o.yaml").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("robot.urdf=gone.urdf", "cannot be read"),
        ("robot.left.sole_frame=nowhere", "no frame 'nowhere'"),
        ("robot.left.joints=[a, b, c, d, e, f]", "robot.left.joints"),
        ("robot.base_frame=l_foot", "is on the left leg"),
    ],
)
def test_config_refuses_a_robot_that_predict_would_refuse(tmp_path, urdf, capsys, change, words):
    out = tmp_path / "robot.yaml"
    assert run(["init", "--urdf", str(urdf), "--out", str(out)]) == 0
    capsys.readouterr()
    assert run(["config", str(out), "--set", change]) == 2
    text, err = capsys.readouterr()
    assert text == "" and words in err and len(err.strip().splitlines()) == 1


def test_joints_may_be_left_out_where_the_chain_gives_them(tmp_path, urdf, capsys):
    out = tmp_path / "robot.yaml"
    assert run(["init", "--urdf", str(urdf), "--out", str(out)]) == 0
    named = load_config(out)
    text = "".join(line for line in out.read_text().splitlines(True) if " joints: [" not in line)
    out.write_text(text)
    assert load_config(out).robot.left.joints == ()
    capsys.readouterr()
    assert run(["config", str(out), "--json"]) == 0
    assert tuple(json.loads(capsys.readouterr().out)["robot.right.joints"]) == named.robot.right.joints
    bag = write_bag(tmp_path / "bag", walk(1.0))
    results = []
    for name, changes in (("without", []), ("with", [f"robot.left.joints={[*named.robot.left.joints]}"])):
        sets = [word for change in changes for word in ("--set", change)]
        assert run(["predict", str(bag), "--config", str(out), "--out", str(tmp_path / name), "--json", *sets]) == 0
        results.append(json.loads(capsys.readouterr().out)["rmse_m"])
    assert results[0] == results[1]
