# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a recorded bag, in the time of the bag (`ros2 bag play --clock` and use_sim_time)."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.substitutions import FindPackageShare

PACKAGE = "coman_reduced_model"


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="recorded bag (a folder, or an .mcap file)"),
            DeclareLaunchArgument("rate", default_value="1.0", description="speed of the replay, 1.0: as recorded"),
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "coman.yaml"]),
                description="ROS 2 parameter file of the recorded robot",
            ),
            DeclareLaunchArgument(
                "urdf",
                default_value="",
                description="URDF file; empty: what the configuration names, or the one recorded in the bag",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="least severe messages that are logged",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), "predict.launch.py"])),
                launch_arguments={
                    "config": LaunchConfiguration("config"),
                    "urdf": LaunchConfiguration("urdf"),
                    "log_level": LaunchConfiguration("log_level"),
                    "use_sim_time": "true",
                }.items(),
            ),
            ExecuteProcess(
                # The delay lets the predictor find the topics: what is played before is lost to it.
                cmd=["ros2", "bag", "play", LaunchConfiguration("bag"), "--clock", "200"]
                + ["--rate", LaunchConfiguration("rate"), "--delay", "3"],
                output="screen",
                on_exit=Shutdown(reason="the bag has ended"),
            ),
        ]
    )
