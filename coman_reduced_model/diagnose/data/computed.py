# SPDX-License-Identifier: BSD-3-Clause
"""Recordings whose foot wrenches are computed (`streams.wrench_source`): they find the phases and show nothing else.

Computed wrenches hold the balance of forces by construction, with whatever masses and torques they are computed from.
So laws that contain them say nothing of the robot, and effects that only these laws show cannot be found.
"""

from __future__ import annotations

from collections.abc import Iterable

from ...core.base.types import Foot, Sample
from ...core.config.schema import Config
from ...core.measured.computed_wrenches import ComputedWrenches
from ...core.measured.support import SupportDetector
from ...core.robot.robot import Robot

LAWS = ("force", "moment", "torque", "landing", "unloaded")  # that contain wrenches
SPRINGS = (
    "joint_stiffness", "stiffness_drift", "joint_damping", "spring_nonlinearity", "backlash", "hysteresis",
    "motor_compliance",
)  # fmt: skip
OTHERS = (
    "body_mass", "payload", "com_offset", "external_force", "joint_friction", "wrench_bias", "wrench_scale",
    "wrench_delay", "sensor_rotation", "touchdown_impact", "ground_compliance",
)  # fmt: skip
NOT_SHOWN = (
    "they hold the balance of forces by construction, so that masses, external forces, friction, landings, soft ground "
    "and foot sensors cannot be judged, and springs only where joint torques are measured"
)


def not_shown(torques: bool) -> tuple[str, ...]:
    """Effects that a recording with computed wrenches cannot show; springs show by measured torques."""
    return OTHERS if torques else (*OTHERS, *SPRINGS)


def owing_to_wrenches(channels: Iterable[str]) -> list[str]:
    """Those of all channels that contain wrenches; a spring does where its joint's torque is not measured."""
    names = list(channels)
    measured = {name.replace("torque", "spring", 1) for name in names if name.startswith("torque/")}
    springs = {name for name in names if name.startswith("spring/")} - measured
    return [name for name in names if name.partition("/")[0] in LAWS or name in springs]


def with_computed_wrenches(
    samples: list[Sample], computed: ComputedWrenches, robot: Robot, config: Config
) -> list[Sample]:
    """Samples with wrenches, the sole of the support foot being at rest, on level ground."""
    detector = SupportDetector(config.support, robot.mass * config.robot.gravity)
    link, foot, out = robot.posture(), Foot.NONE, []
    for sample in samples:
        link.update(sample.q, sample.qd)
        filled = computed.filled(sample, link, foot)
        out.append(filled)
        if filled.left_wrench is not None and filled.right_wrench is not None:
            loads = float(filled.left_wrench[2]), float(filled.right_wrench[2])
            foot = detector.update(sample.stamp_ns, *loads).support_foot
    return out
