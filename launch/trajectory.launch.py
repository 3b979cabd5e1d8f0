# SPDX-License-Identifier: BSD-3-Clause
"""The trajectory node: the planned motion of the COM on com/reference, with ~/start, ~/stop and ~/reset."""

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration

from coman_reduced_model.ros.runtime.launching import clock, declare, find_files, node, remappings, switch


def trajectory(context):
    parameters = clock(context)
    gait = LaunchConfiguration("gait").perform(context)
    if gait:  # an empty text would hide what the configuration names
        parameters.append({"gait.name": gait})
    if LaunchConfiguration("repeat").perform(context):
        parameters.append({"gait.repeat": switch("repeat")})
    return [node("trajectory", *parameters, remap=remappings(context, "reference"))]


def generate_launch_description():
    arguments = declare("config", "gait", "repeat", "namespace", "use_sim_time", "reference", "remap", "log_level")
    return LaunchDescription([*arguments, find_files("config"), OpaqueFunction(function=trajectory)])
