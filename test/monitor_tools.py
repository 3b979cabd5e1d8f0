# SPDX-License-Identifier: BSD-3-Clause
"""The monitor on synthetic walks."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from synthetic import JOINTS, LEFT, MOTORS, RIGHT, T0, description, names, walk

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.types import Foot, ImuMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.robot import Robot

BEGINS, WITHIN = 7.0, 5.0  # [s]
LOADED = 15.0  # [N] from which a foot bears load: just before and after, it is as good as in the air
FEET = {Foot.LEFT: LEFT, Foot.RIGHT: RIGHT}
KNEE = names().index("LKneeSag")


def mismatches(bag, out, *arguments):
    """Mismatches that `coman predict` reports for a bag."""
    assert run(["predict", str(bag), "--out", str(out), *arguments]) == 0
    summary = json.loads((out / "summary.json").read_text())
    for each in summary["mismatches"]:
        assert each["text"] in summary["warnings"] and each["channel"] in each["text"]
    return summary["mismatches"]


def turned(message, joint, angle):
    position = message.position.copy()
    position[joint] += angle
    return replace(message, position=position)


LEVEL = np.array([0.0, 0.0, 0.0, 1.0])  # orientation of the synthetic robot's trunk


def watched(change, seconds=13.0, **options):
    """The monitor after a synthetic walk; options as of `watching`."""
    for _, each in watching(change, seconds, **options):
        monitor = each
    return monitor


def watching(change, seconds=13.0, skip=(), imu=lambda t: None, reset=np.inf, rate=200.0, mounted=None, **changes):
    """Seconds and the monitor, message by message of a synthetic walk.

    Args:
        change: of each message: stream, seconds, message; None: it is lost.
        seconds: of the walk.
        skip: streams that are left out.
        imu: orientation of the trunk by seconds, as a quaternion x, y, z, w; None: no message.
        reset: when the monitor is reset [s].
        rate: of the streams [1/s].
        mounted: rotation of the IMU in the trunk; None: it is aligned.
        changes: of the configuration.
    """
    frame = "base_link" if mounted is None else "imu"
    mounting = Rotation.identity() if mounted is None else mounted
    pipeline = Pipeline(robot_with_imu(mounting), Config().replaced({"prediction.horizons": [], **changes}))
    take = {
        JOINTS: pipeline.on_joint,
        MOTORS: pipeline.on_motor,
        **{stream: lambda message, foot=foot: pipeline.on_wrench(foot, message) for foot, stream in FEET.items()},
    }
    for stream, message in walk(seconds, rate):
        t = (message.stamp_ns - T0) * 1e-9
        if t >= reset:
            pipeline.monitor.reset()
            reset = np.inf
        if stream == JOINTS and (trunk := imu(t)) is not None:
            orientation = Rotation.from_quat(trunk) * mounting
            up = orientation.inv().apply([0.0, 0.0, 9.81])
            pipeline.on_imu(ImuMessage(message.stamp_ns, frame, orientation.as_quat(), np.zeros(3), up))
        if stream not in skip and (changed := change(stream, t, message)) is not None:
            take[stream](changed)
        yield t, pipeline.monitor


def robot_with_imu(mounting):
    """The synthetic robot with an IMU, a link without mass that is turned by a rotation against the trunk."""
    rpy = " ".join(f"{angle:.9f}" for angle in mounting.as_euler("xyz"))
    link = f"""
        <link name="imu"/>
        <joint name="imu_mount" type="fixed">
          <parent link="base_link"/><child link="imu"/><origin xyz="0 0 0" rpy="{rpy}"/>
        </joint>"""
    return Robot(description().replace("</robot>", f"{link}</robot>"), Config().robot)


def detected_in_time(found, channel):
    first = next(each for each in found if each.channel == channel)
    after = (first.detected_ns - T0) * 1e-9 - BEGINS
    assert 0.0 < after <= WITHIN
    assert first.changed and (first.onset_ns - T0) * 1e-9 >= BEGINS - 0.6  # the phase in which it began
    return first
