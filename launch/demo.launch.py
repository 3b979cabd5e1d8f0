# SPDX-License-Identifier: BSD-3-Clause
"""Without a robot: the virtual robot walks what the trajectory node plans, and the predictor watches it."""

from launch import LaunchDescription
from launch.actions import OpaqueFunction

from coman_reduced_model.resources import config_path
from coman_reduced_model.ros.runtime.launching import (
    TOPICS,
    declare,
    find_files,
    include,
    node,
    remappings,
    rviz,
    switch,
)

SHARED = ("config", "namespace", "remap", "log_level")


def virtual_robot(context):
    links = rviz(context, urdf=config_path("coman.urdf").read_text())  # of the robot of all worlds but other bodies
    clock = {"use_sim_time": switch("use_sim_time")}
    return [node("virtual_robot", clock, remap=remappings(context, *TOPICS)), *links]


def generate_launch_description():
    return LaunchDescription(
        [
            *declare(*SHARED, "gait", "rviz", "use_sim_time", *TOPICS, repeat="true"),
            find_files("config"),
            OpaqueFunction(function=virtual_robot),
            include("predict.launch.py", *SHARED, "rviz", *TOPICS),
            include("trajectory.launch.py", *SHARED, "gait", "repeat", "reference"),
        ]
    )
