# SPDX-License-Identifier: BSD-3-Clause
"""What the launch files share: their arguments, and how they start a node or another launch file."""

from __future__ import annotations

from pathlib import Path

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_context import LaunchContext
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from ...core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ...core.base.types import Foot
from ...resources import share_path
from ...topics import DESCRIPTION, INPUT_TOPICS

PACKAGE = "coman_reduced_model"
_SWITCH = ["true", "false", "True", "False"]
# Topics that have an argument each, by its name.
TOPICS = {
    "joint_states": JOINTS,
    "motor_states": MOTORS,
    "left_wrench": WRENCHES[Foot.LEFT],
    "right_wrench": WRENCHES[Foot.RIGHT],
    "contacts": CONTACTS,
    "imu": INPUT_TOPICS[IMU],
    "reference": REFERENCE,
}
# Name: default, description, what is allowed (None: anything).
_ARGUMENTS = {
    "config": (
        PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "coman.yaml"]),
        "ROS 2 parameter file of the robot; the one that `coman predict --config` takes",
        None,
    ),
    "urdf": ("", "URDF file; empty: what the configuration names, or the topic robot_description", None),
    "gait": ("", "named gait; empty: the one that the configuration names", None),
    "repeat": (
        "",
        "walk the plan again when it ends; a robot that starts late joins it there; empty: as the configuration says",
        ["", *_SWITCH],
    ),
    "namespace": ("", "namespace of the nodes and their topics", None),
    "use_sim_time": (
        "",
        "take the time from /clock (simulation, bag); empty: as the configuration says, or not",
        ["", *_SWITCH],
    ),
    "remap": ("", "other topics, as OLD:=NEW with commas between several", None),
    **{name: (topic, f"topic instead of {topic}", None) for name, topic in TOPICS.items()},
    "rviz": ("false", "show robot, COM and predictions in RViz", _SWITCH),
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


def clock(context: LaunchContext) -> list[dict]:
    """`use_sim_time` as a parameter, if it is given: an empty text would hide what the configuration says."""
    given = LaunchConfiguration("use_sim_time").perform(context)
    return [{"use_sim_time": switch("use_sim_time")}] if given else []


def find_files(*names: str) -> OpaqueFunction:
    """Make the files of arguments absolute; stop in one line where one does not exist: ROS 2 would go on without it."""

    def find(context: LaunchContext) -> None:
        for name in names:
            given = LaunchConfiguration(name).perform(context)
            path = Path(given).expanduser().absolute()
            if given and not path.is_file():
                raise FileNotFoundError(f"{name}:={given}: there is no such file")
            context.launch_configurations[name] = str(path) if given else ""

    return OpaqueFunction(function=find)


def remappings(context: LaunchContext, *names: str) -> list[tuple[str, str]]:
    """Those of arguments in `TOPICS`, and of `remap`.

    Raises:
        ValueError: `remap` is not a list of OLD:=NEW.
    """
    found = [(TOPICS[name], LaunchConfiguration(name).perform(context)) for name in names]
    for each in filter(None, LaunchConfiguration("remap").perform(context).replace(" ", "").split(",")):
        old, separator, new = each.partition(":=")
        if not (old and separator and new):
            raise ValueError(f"remap:={each}: wanted OLD:=NEW, with commas between several")
        found.append((old, new))
    return [(old, new) for old, new in found if old != new]


def node(executable: str, *parameters: dict, remap: list[tuple[str, str]] | None = None) -> Node:
    """A node of ours with the configuration, and parameters that go before it; wants config, namespace, log_level."""
    return Node(
        package=PACKAGE,
        executable=executable,
        name=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("config"), *parameters],
        remappings=remap,
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
    )


def rviz(context: LaunchContext, remap: list[tuple[str, str]] | None = None, **urdf: str) -> list[Node]:
    """If the argument of that name says so, RViz with our layout; with `urdf=` (text) robot_state_publisher instead."""
    if LaunchConfiguration("rviz").perform(context).lower() != "true":
        return []
    parameters = clock(context)
    arguments = None if urdf else ["-d", str(share_path() / "rviz" / "coman.rviz")]
    if urdf:
        parameters.append({DESCRIPTION: ParameterValue(urdf["urdf"], value_type=str)})
    name = "robot_state_publisher" if urdf else "rviz2"
    namespace = LaunchConfiguration("namespace")
    return [
        Node(
            package=name,
            executable=name,
            namespace=namespace,
            parameters=parameters,
            remappings=remap,
            arguments=arguments,
        )
    ]


def include(file: str, *handed_on: str, **fixed: str) -> IncludeLaunchDescription:
    """Another launch file of ours, with arguments handed on or fixed."""
    arguments = [(name, LaunchConfiguration(name)) for name in handed_on]
    source = PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), file]))
    return IncludeLaunchDescription(source, launch_arguments=[*arguments, *fixed.items()])
