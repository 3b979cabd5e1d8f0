# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a recorded bag, in the time of the bag (/clock and use_sim_time)."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.session import described_urdf
from coman_reduced_model.ros.runtime.launching import PACKAGE, TOPICS, declare, include, rviz
from coman_reduced_model.topics import TopicNames

SHARED = ("config", "urdf", *TOPICS, "remap", "rviz", "log_level")


def robot_state(context):
    """For RViz: the links of the robot that `urdf` or the bag describes, from its joint states."""
    if given := LaunchConfiguration("urdf").perform(context):
        return rviz(context, urdf=Path(given).read_text(encoding="utf-8"))
    with Bag(LaunchConfiguration("bag").perform(context)) as bag:
        return rviz(context, urdf=described_urdf(bag, TopicNames())[0])


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="recorded bag (a folder, or an .mcap file)"),
            DeclareLaunchArgument("rate", default_value="1.0", description="speed of the replay, 1.0: as recorded"),
            *declare(*SHARED),
            include("predict.launch.py", *SHARED, use_sim_time="true"),
            OpaqueFunction(function=robot_state, condition=IfCondition(LaunchConfiguration("rviz"))),
            ExecuteProcess(
                # What is played before the predictor listens is lost to it. (Displays, too, listen to joint_states.)
                cmd=[ExecutableInPackage("coman", PACKAGE), "replay", LaunchConfiguration("bag")]
                + ["--rate", LaunchConfiguration("rate")]
                + ["--await", LaunchConfiguration("left_wrench"), "--await", LaunchConfiguration("joint_states")],
                output="screen",
                on_exit=Shutdown(reason="the bag has ended"),
            ),
        ]
    )
