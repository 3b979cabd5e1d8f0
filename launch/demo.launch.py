# SPDX-License-Identifier: BSD-3-Clause
"""Without a robot: the virtual robot walks what the trajectory node plans, and the predictor watches it."""

from launch import LaunchDescription
from launch.actions import OpaqueFunction

from coman_reduced_model.resources import config_path
from coman_reduced_model.ros.runtime.launching import (
    TOPICS,
    clock,
    declare,
    find_files,
    include,
    node,
    remappings,
    rviz,
)
from coman_reduced_model.topics import DESCRIPTION

SHARED = ("config", "namespace", "remap", "log_level")


def virtual_robot(context):
    moved = remappings(context, *TOPICS)
    # Links of the robot of all worlds but other bodies; the predictor takes the description that the robot publishes.
    own = [*moved, (DESCRIPTION, f"~/{DESCRIPTION}")]
    links = rviz(context, own, urdf=config_path("coman.urdf").read_text())
    return [node("virtual_robot", *clock(context), remap=moved), *links]


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
