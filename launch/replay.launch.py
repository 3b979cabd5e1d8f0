# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a recorded bag, in the time of the bag (/clock and use_sim_time)."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.session import described_urdf, read_urdf
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.ros.runtime.launching import PACKAGE, TOPICS, declare, include, remappings, rviz
from coman_reduced_model.topics import OF_PREDICTOR, TopicNames

SHARED = ("config", "urdf", *TOPICS, "remap", "rviz", "log_level")


def robot_state(context):
    """For RViz: the links of the robot that `urdf` or the bag describes, from its joint states."""
    moved = remappings(context, *TOPICS)
    given = LaunchConfiguration("urdf").perform(context)
    named = Path(given) if given else load_config(LaunchConfiguration("config").perform(context)).urdf
    if named:
        return rviz(context, moved, urdf=read_urdf(named))
    names = TopicNames("", (f"{old}:={new}" for old, new in moved))
    with Bag(LaunchConfiguration("bag").perform(context)) as bag:
        return rviz(context, moved, urdf=described_urdf(bag, names)[0])


def player(context):
    """Without what a predictor said while the bag was recorded."""
    bag = Path(LaunchConfiguration("bag").perform(context)).expanduser()
    context.launch_configurations["bag"] = str(bag)
    said = [word for topic in OF_PREDICTOR for word in ("--exclude", topic.lstrip("/"))]
    # What is played before the predictor listens is lost to it. (Displays, too, listen to joint_states.)
    awaited = [LaunchConfiguration(name).perform(context) for name in ("left_wrench", "joint_states")]
    return [
        ExecuteProcess(
            cmd=[ExecutableInPackage("coman", PACKAGE), "replay", str(bag), *said]
            + ["--rate", LaunchConfiguration("rate")]
            + [word for topic in awaited for word in ("--await", topic)],
            output="screen",
            on_exit=Shutdown(reason="the bag has ended"),
        )
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="recorded bag (a folder, or an .mcap file)"),
            DeclareLaunchArgument("rate", default_value="1.0", description="speed of the replay, 1.0: as recorded"),
            *declare(*SHARED),
            include("predict.launch.py", *SHARED, use_sim_time="true"),
            OpaqueFunction(function=player),
            OpaqueFunction(function=robot_state, condition=IfCondition(LaunchConfiguration("rviz"))),
        ]
    )
