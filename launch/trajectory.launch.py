# SPDX-License-Identifier: BSD-3-Clause
"""The trajectory node: the planned motion of the COM on com/reference, with ~/start, ~/stop and ~/reset."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "coman_reduced_model"


def trajectory(context):
    parameters = [
        LaunchConfiguration("config"),
        {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)},
        {"gait.repeat": ParameterValue(LaunchConfiguration("repeat"), value_type=bool)},
    ]
    gait = LaunchConfiguration("gait").perform(context)
    if gait:  # an empty text would hide what the configuration names
        parameters.append({"gait.name": gait})
    return [
        Node(
            package=PACKAGE,
            executable="trajectory",
            name="trajectory",
            namespace=LaunchConfiguration("namespace"),
            parameters=parameters,
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "coman.yaml"]),
                description="ROS 2 parameter file of the robot; its `gait` part is the walk",
            ),
            DeclareLaunchArgument(
                "gait", default_value="", description="named gait; empty: the one that the configuration names"
            ),
            DeclareLaunchArgument(
                "repeat",
                default_value="false",
                choices=["true", "false"],
                description="walk the plan again when it ends",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node and its topics"),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                choices=["true", "false"],
                description="take the time from /clock (simulation, bag)",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="least severe messages that are logged",
            ),
            OpaqueFunction(function=trajectory),
        ]
    )
