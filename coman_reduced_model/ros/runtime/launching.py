# SPDX-License-Identifier: BSD-3-Clause
"""What the launch files share: their arguments, and how they start a node or another launch file."""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "coman_reduced_model"
_SWITCH = ["true", "false"]
# Name: default, description, what is allowed (None: anything).
_ARGUMENTS = {
    "config": (
        PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "coman.yaml"]),
        "ROS 2 parameter file of the robot; the one that `coman predict --config` takes",
        None,
    ),
    "urdf": ("", "URDF file; empty: what the configuration names, or the topic robot_description", None),
    "gait": ("", "named gait; empty: the one that the configuration names", None),
    "repeat": ("false", "walk the plan again when it ends; a robot that starts late joins it there", _SWITCH),
    "namespace": ("", "namespace of the nodes and their topics", None),
    "use_sim_time": ("false", "take the time from /clock (simulation, bag)", _SWITCH),
    "log_level": ("info", "least severe messages that are logged", ["debug", "info", "warn", "error", "fatal"]),
}


def declare(*names: str, **defaults: str) -> list[DeclareLaunchArgument]:
    """Launch arguments by name; `defaults` are those with another default than usual."""
    declared = []
    for name in (*names, *defaults):
        usual, description, choices = _ARGUMENTS[name]
        default = defaults.get(name, usual)
        declared.append(DeclareLaunchArgument(name, default_value=default, description=description, choices=choices))
    return declared


def switch(name: str) -> ParameterValue:
    """The launch argument of that name as a parameter that is true or false."""
    return ParameterValue(LaunchConfiguration(name), value_type=bool)


def node(executable: str, *parameters: dict) -> Node:
    """A node of ours with the configuration, and parameters that go before it; wants config, namespace, log_level."""
    return Node(
        package=PACKAGE,
        executable=executable,
        name=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("config"), *parameters],
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
    )


def include(file: str, *handed_on: str, **fixed: str) -> IncludeLaunchDescription:
    """Another launch file of ours, with arguments handed on or fixed."""
    arguments = [(name, LaunchConfiguration(name)) for name in handed_on]
    source = PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), file]))
    return IncludeLaunchDescription(source, launch_arguments=[*arguments, *fixed.items()])
