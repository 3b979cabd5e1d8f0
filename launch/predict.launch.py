# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a robot (or a bag, or a simulation) that publishes the sensor topics."""

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration

from coman_reduced_model.ros.runtime.launching import TOPICS, clock, declare, find_files, node, remappings, rviz


def predictor(context):
    parameters = clock(context)
    urdf = LaunchConfiguration("urdf").perform(context)
    if urdf:  # an empty text would hide what the configuration names
        parameters.append({"robot.urdf": urdf})
    return [node("predictor", *parameters, remap=remappings(context, *TOPICS)), *rviz(context)]


def generate_launch_description():
    arguments = declare("config", "urdf", "namespace", "use_sim_time", *TOPICS, "remap", "rviz", "log_level")
    return LaunchDescription([*arguments, find_files("config", "urdf"), OpaqueFunction(function=predictor)])
