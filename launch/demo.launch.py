# SPDX-License-Identifier: BSD-3-Clause
"""Without a robot: the virtual robot walks what the trajectory node plans, and the predictor watches it."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = "coman_reduced_model"


def include(name, *arguments):
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), name])),
        launch_arguments=[(argument, LaunchConfiguration(argument)) for argument in arguments],
    )


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "coman.yaml"]),
                description="ROS 2 parameter file of the robot, for all three nodes",
            ),
            DeclareLaunchArgument(
                "gait", default_value="", description="named gait; empty: the one that the configuration names"
            ),
            DeclareLaunchArgument(
                "repeat",
                default_value="true",
                choices=["true", "false"],
                description="walk the plan again when it ends; a robot that starts late joins it there",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the nodes and their topics"),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="least severe messages that are logged",
            ),
            Node(
                package=PACKAGE,
                executable="virtual_robot",
                name="virtual_robot",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("config")],
                arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
                output="screen",
            ),
            include("predict.launch.py", "config", "namespace", "log_level"),
            include("trajectory.launch.py", "config", "gait", "repeat", "namespace", "log_level"),
        ]
    )
