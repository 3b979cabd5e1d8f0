# SPDX-License-Identifier: BSD-3-Clause
"""A robot that steps in place, made of formulas: streams and bags that take no time to make, and to spoil."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from coman_reduced_model.bag.types import bag_types
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.core.base.stream_names import IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from coman_reduced_model.core.base.types import Foot, JointMessage, Phase, Reference, WrenchMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.messages import INPUT_TYPES, STRING, imu_to, joint_to, reference_to, wrench_to
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.topics import DESCRIPTION, INPUT_TOPICS

T0 = 1_700_000_000_000_000_000
LEFT, RIGHT = WRENCHES[Foot.LEFT], WRENCHES[Foot.RIGHT]
CYCLE = 1.2  # [s] double, left, double, right support, each a quarter
Message = tuple[str, Any]  # stream and message, in the order of arrival


@cache
def description() -> str:
    return urdf(COMAN)


@cache
def robot() -> Robot:
    return Robot(description(), Config().robot)


@cache
def robot_with_arm() -> Robot:
    """The same with one more joint, of no leg."""
    arm = """
        <link name="arm">
          <inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
        </link>
        <joint name="Arm" type="revolute">
          <parent link="base_link"/><child link="arm"/><axis xyz="0 1 0"/>
          <limit lower="-1" upper="1" effort="1" velocity="1"/>
        </joint>"""
    return Robot(description().replace("</robot>", f"{arm}</robot>"), Config().robot)


def names() -> tuple[str, ...]:
    legs = Config().robot
    return legs.left.joints + legs.right.joints


Times = float | np.ndarray  # one, or several (n,) [s]


def loads(t: Times) -> tuple[Times, Times]:
    """Share of the weight on each foot."""
    quarter = (t / CYCLE) % 1.0 * 4.0
    left = np.interp(quarter, [0.0, 0.6, 1.0, 2.0, 2.4, 3.0, 4.0], [0.0, 0.5, 1.0, 1.0, 0.5, 0.0, 0.0])
    return left, 1.0 - left


def posture(t: Times) -> np.ndarray:
    """Joint positions (12,) or (n, 12) [rad] in the order of `names`: the foot without load is lifted."""
    q = 0.002 * np.sin(5.0 * np.asarray(t)[..., None] + np.arange(12))
    for first, load in zip((0, 6), loads(t), strict=True):
        u = np.maximum(0.0, 1.0 - load / 0.3)
        bend = np.asarray(0.35 + 0.13 * (3.0 - 2.0 * u) * u * u)
        q[..., first + np.array([0, 3, 4])] += bend[..., None] * [-1.0, 2.0, -1.0]
    return q


def velocity(t: Times) -> np.ndarray:
    return (posture(t + 1e-5) - posture(t - 1e-5)) / 2e-5


def walk(seconds: float = 3.0, rate: float = 200.0, offset_s: float = 0.0003, reference: bool = False) -> list[Message]:
    """All streams in the order of their stamps; each is `offset_s` later than the one before."""
    weight, legs, joints = robot().mass * 9.81, Config().robot, names()
    messages: list[tuple[int, str, Any]] = []
    times = np.arange(round(seconds * rate)) / rate
    u = times + offset_s
    # What stretches the springs by 10 mrad, and a little that does not go with it.
    efforts = 0.01 * np.array(legs.left.stiffness + legs.right.stiffness) + 0.1 * np.cos(times[:, None] + np.arange(12))
    at, motor_at = list(zip(posture(times), velocity(times), efforts, strict=True)), [posture(u) + 0.01, velocity(u)]
    load = [loads(times + i * offset_s)[i - 2] for i in (2, 3)]
    for k, t in enumerate(times.tolist()):
        stamps = [T0 + round((t + i * offset_s) * 1e9) for i in range(5)]
        messages.append((stamps[0], JOINTS, JointMessage(stamps[0], joints, *(each.copy() for each in at[k]))))
        motor = JointMessage(stamps[1], joints, *(each[k].copy() for each in motor_at), None)
        messages.append((stamps[1], MOTORS, motor))
        for i, (foot, frame) in enumerate(((Foot.LEFT, "l_sole"), (Foot.RIGHT, "r_sole")), start=2):
            force = np.array([1.0, -0.5, weight * load[i - 2][k]])
            wrench = WrenchMessage(stamps[i], frame, force, np.array([0.1, -0.2, 0.0]))
            messages.append((stamps[i], WRENCHES[foot], wrench))
        if reference:
            com = np.array([0.03, 0.0, 0.4])
            feet = [np.eye(4), np.eye(4)]
            feet[0][1, 3], feet[1][1, 3] = 0.07, -0.07
            point = Reference(stamps[4], com, np.zeros(3), np.zeros(3), com * [1, 1, 0], *feet, Phase.DOUBLE, 0)
            messages.append((stamps[4], REFERENCE, point))
    return [(stream, message) for _, stream, message in sorted(messages, key=lambda item: item[0])]


def write_bag(
    path: Path,
    messages: Iterable[Message] | None = None,
    change: Callable[[str, Any], Any] | None = None,
    urdf_text: str | None = None,
    skip: Iterable[str] = (),
    namespace: str = "",
    imu: bool = False,
) -> Path:
    """A bag of messages; `change` may replace, drop (None) or multiply (list) each; `skip` leaves streams out."""
    to = {INPUT_TYPES[JOINTS]: joint_to, INPUT_TYPES[LEFT]: wrench_to, INPUT_TYPES[REFERENCE]: reference_to}
    to[INPUT_TYPES[IMU]] = imu_to
    streams = [each for each in (JOINTS, MOTORS, LEFT, RIGHT, REFERENCE, *([IMU] if imu else [])) if each not in skip]
    text = description() if urdf_text is None else urdf_text
    topics = {f"{namespace}/{INPUT_TOPICS[stream]}": INPUT_TYPES[stream] for stream in streams}
    latched = f"{namespace}/{DESCRIPTION}"
    types = bag_types()
    with BagWriter(path, {**({latched: STRING} if text else {}), **topics}, (latched,)) as bag:
        if text:
            bag.write(latched, T0, types.String(data=text))
        log_time = T0
        for stream, message in walk() if messages is None else messages:
            if stream in skip:
                continue
            changed = message if change is None else change(stream, message)
            for each in changed if isinstance(changed, list) else [] if changed is None else [changed]:
                log_time += 200_000  # of arrival, which nothing may depend on
                bag.write(f"{namespace}/{INPUT_TOPICS[stream]}", log_time, to[INPUT_TYPES[stream]](types, each))
    return path


def rooted(rpy: str = "0 0 3.141592653589793", xyz: str = "0.05 0.02 -0.1", kind: str = "fixed") -> str:
    """The robot with a root link above its trunk that points elsewhere, as iCub's does; it weighs nothing."""
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>' if kind != "fixed" else ""
    root = f"""
        <link name="root_link"/>
        <joint name="Waist" type="{kind}">
          <parent link="root_link"/><child link="base_link"/><origin rpy="{rpy}" xyz="{xyz}"/>{limit}
        </joint>"""
    return description().replace("</robot>", f"{root}</robot>")
