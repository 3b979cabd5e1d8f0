# SPDX-License-Identifier: BSD-3-Clause
"""Without a robot: the virtual robot walks what the trajectory node plans, and the predictor watches it."""

from launch import LaunchDescription

from coman_reduced_model.ros.runtime.launching import declare, include, node


def generate_launch_description():
    return LaunchDescription(
        [
            *declare("config", "gait", "namespace", "log_level", repeat="true"),
            node("virtual_robot"),
            include("predict.launch.py", "config", "namespace", "log_level"),
            include("trajectory.launch.py", "config", "gait", "repeat", "namespace", "log_level"),
        ]
    )
