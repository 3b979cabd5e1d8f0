# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a robot (or a bag, or a simulation) that publishes the sensor topics."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "coman_reduced_model"


def predictor(context):
    parameters = [
        LaunchConfiguration("config"),
        {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)},
    ]
    urdf = LaunchConfiguration("urdf").perform(context)
    if urdf:  # an empty text would hide what the configuration names
        parameters.append({"robot.urdf": str(Path(urdf).expanduser().resolve())})
    return [
        Node(
            package=PACKAGE,
            executable="predictor",
            name="predictor",
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
                description="ROS 2 parameter file of the robot; the one that `coman predict --config` takes",
            ),
            DeclareLaunchArgument(
                "urdf",
                default_value="",
                description="URDF file; empty: what the configuration names, or the topic robot_description",
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
            OpaqueFunction(function=predictor),
        ]
    )
