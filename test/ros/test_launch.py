# SPDX-License-Identifier: BSD-3-Clause
"""The launch files. No wheel has the package launch: on a machine without it, all but their syntax goes untested."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path

import pytest
from conftest import ROOT
from synthetic import walk, write_bag

FILES = sorted((ROOT / "launch").glob("*.py"))
SHIPPED = str(ROOT / "config/coman.yaml")


@pytest.fixture(name="launching")
def _launching():
    pytest.importorskip("launch_ros", reason="no wheel of Jazzy has launch")
    from coman_reduced_model.ros.runtime import launching

    return launching


@pytest.fixture(name="context")
def _context(launching):
    """With the defaults of all arguments, as far as they are texts."""
    from launch.launch_context import LaunchContext

    context = LaunchContext()
    context.launch_configurations.update(launching.TOPICS)
    context.launch_configurations.update({"config": SHIPPED, "remap": "", "namespace": "", "log_level": "info"})
    context.launch_configurations.update(
        {"urdf": "", "gait": "", "rviz": "false", "repeat": "true", "use_sim_time": "True"}
    )
    return context


def description(path):
    spec = importlib.util.spec_from_file_location("launch_file", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, module.generate_launch_description()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_names_that_are_imported_exist(path):
    """What a launch file takes from the package is there; seen without running it."""
    tree = ast.parse((ROOT / "coman_reduced_model/ros/runtime/launching.py").read_text())
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    defined |= {t.id for node in tree.body if isinstance(node, ast.Assign) for t in node.targets}
    file = ast.parse(path.read_text())
    imports = [node for node in ast.walk(file) if isinstance(node, ast.ImportFrom) and "launching" in node.module]
    assert imports and {alias.name for node in imports for alias in node.names} <= defined


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_arguments_are_declared_and_described(launching, path):
    launched = description(path)[1]
    arguments = [each for each, _ in launched.get_launch_arguments_with_include_launch_description_actions()]
    assert len({each.name for each in arguments}) > 4 and all(each.description for each in arguments)


@pytest.mark.parametrize("name", ["predict", "trajectory", "demo"])
def test_a_configuration_that_does_not_exist_ends_the_launch_in_one_line(launching, context, name):
    from launch.actions import OpaqueFunction

    context.launch_configurations["config"] = "nowhere.yaml"
    entities = description(ROOT / f"launch/{name}.launch.py")[1].entities
    first = next(each for each in entities if isinstance(each, OpaqueFunction))
    with pytest.raises(FileNotFoundError, match=re.escape("config:=nowhere.yaml: there is no such file")):
        first.execute(context)
    context.launch_configurations["config"] = SHIPPED
    assert not first.execute(context)


def test_topics_are_remapped(launching, context):
    assert launching.remappings(context, *launching.TOPICS) == []
    context.launch_configurations.update({"left_wrench": "/ft/left", "remap": "com/prediction:=/p, com/support:=/s"})
    wanted = [("left_foot/wrench", "/ft/left"), ("com/prediction", "/p"), ("com/support", "/s")]
    assert launching.remappings(context, *launching.TOPICS) == wanted
    context.launch_configurations["remap"] = "com/prediction"
    with pytest.raises(ValueError, match=re.escape("remap:=com/prediction: wanted OLD:=NEW")):
        launching.remappings(context)


@pytest.mark.parametrize(("file", "function"), [("predict", "predictor"), ("trajectory", "trajectory")])
def test_use_sim_time_may_be_written_as_python_does(launching, context, file, function):
    module, _ = description(ROOT / f"launch/{file}.launch.py")
    (node,) = getattr(module, function)(context)
    (declared,) = launching.declare("use_sim_time")
    assert {"", "true", "True", "false", "False"} == set(declared.choices)
    assert launching.switch("use_sim_time").evaluate(context) is True and node.node_package == "coman_reduced_model"
    assert len(launching.clock(context)) == 1
    context.launch_configurations["use_sim_time"] = ""  # what the configuration says counts
    assert launching.clock(context) == []


def test_a_bag_is_played_without_what_a_predictor_said(launching, context):
    from launch.utilities import perform_substitutions

    context.launch_configurations.update({"bag": "~/walk1", "rate": "1.0", "joint_states": "/arm/joint_states"})
    (played,) = description(ROOT / "launch/replay.launch.py")[0].player(context)
    words = [perform_substitutions(context, [*each]) for each in played.cmd[1:]]
    assert str(Path("~/walk1").expanduser()) in words and "/arm/joint_states" in words
    left_out = {words[i + 1] for i, word in enumerate(words) if word == "--exclude"}
    assert {"com/prediction", "tf"} <= left_out and not left_out & {"joint_states", "tf_static", "robot_description"}


def test_rviz_comes_with_our_layout_and_the_links_of_the_bag(launching, context, tmp_path):
    predictor = description(ROOT / "launch/predict.launch.py")[0].predictor
    robot_state = description(ROOT / "launch/replay.launch.py")[0].robot_state
    context.launch_configurations["bag"] = str(ROOT / "bags/stand")
    assert len(predictor(context)) == 1 and not robot_state(context)
    context.launch_configurations["rviz"] = "True"
    assert [node.node_package for node in predictor(context)] == ["coman_reduced_model", "rviz2"]
    assert [node.node_package for node in robot_state(context)] == ["robot_state_publisher"]
    # A bag may have no description, or one of another name.
    context.launch_configurations.update({"bag": "no_such_bag", "config": str(tmp_path / "mine.yaml")})
    (tmp_path / "coman.urdf").write_bytes((ROOT / "config/coman.urdf").read_bytes())
    (tmp_path / "mine.yaml").write_text("/**:\n  ros__parameters:\n    robot.urdf: coman.urdf\n")
    assert [node.node_package for node in robot_state(context)] == ["robot_state_publisher"]
    bag = write_bag(tmp_path / "bag", walk(0.2), namespace="/walker")
    context.launch_configurations.update({"bag": str(bag), "config": SHIPPED})
    context.launch_configurations["remap"] = "robot_description:=/walker/robot_description"
    assert [node.node_package for node in robot_state(context)] == ["robot_state_publisher"]


def test_the_robot_of_a_demonstration_describes_itself(launching, context):
    """Links for RViz alone must not tell the predictor of another robot."""
    context.launch_configurations.update({"rviz": "true", "joint_states": "/arm/joint_states"})
    robot, links = description(ROOT / "launch/demo.launch.py")[0].virtual_robot(context)
    assert (robot.node_package, links.node_package) == ("coman_reduced_model", "robot_state_publisher")
