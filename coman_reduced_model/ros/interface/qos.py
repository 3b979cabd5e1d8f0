# SPDX-License-Identifier: BSD-3-Clause
"""Quality of service of every topic, in one place.

Every profile but those of what is displayed alone can be overridden from the parameter file, as ROS 2 has it:
`qos_overrides./joint_states.subscription.reliability: reliable`.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions


def _profile(depth: int, reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


def sensor_input() -> QoSProfile:
    """What sensors and com/reference are received with.

    Best effort receives from both kinds of publishers; reliable would silently refuse the best-effort ones that most
    drivers are. What makes best effort lose messages is a short queue: this one holds a second at 2 kHz, and was
    measured to lose nothing at 4 kHz. On a lossy network, override it with `reliable`.
    """
    return _profile(2000, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)


def sensor_output() -> QoSProfile:
    """What sensor topics and com/reference are sent with (virtual robot, trajectory, replay): suits any subscriber."""
    return _profile(1000, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def prediction_output() -> QoSProfile:
    """com/prediction: reliable and deep, so that a recorder has every one of them."""
    return _profile(1000, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def display_output() -> QoSProfile:
    """Points, markers, com/support and /diagnostics: for people and plots, who want the newest."""
    return _profile(10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def latched(depth: int = 1) -> QoSProfile:
    """robot_description, com/reference_path and tf_static: a late subscriber gets the last one, or the last `depth`."""
    return _profile(depth, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)


def clock_output() -> QoSProfile:
    """/clock, as rclpy subscribes to it."""
    return _profile(10, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def overridable() -> QoSOverridingOptions:
    """History, depth, reliability and durability may be overridden by parameters."""
    return QoSOverridingOptions(
        (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
    )
