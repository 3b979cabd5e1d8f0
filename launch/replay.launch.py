# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a recorded bag, in the time of the bag (/clock and use_sim_time)."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, Shutdown
from launch.substitutions import LaunchConfiguration

from coman_reduced_model.ros.launching import PACKAGE, declare, include


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="recorded bag (a folder, or an .mcap file)"),
            DeclareLaunchArgument("rate", default_value="1.0", description="speed of the replay, 1.0: as recorded"),
            *declare("config", "urdf", "log_level"),
            include("predict.launch.py", "config", "urdf", "log_level", use_sim_time="true"),
            ExecuteProcess(
                # Waiting lets the predictor find the topics: what is played before is lost to it.
                cmd=["ros2", "run", PACKAGE, "coman", "replay", LaunchConfiguration("bag")]
                + ["--rate", LaunchConfiguration("rate"), "--wait", "5"],
                output="screen",
                on_exit=Shutdown(reason="the bag has ended"),
            ),
        ]
    )
