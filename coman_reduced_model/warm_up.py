# SPDX-License-Identifier: BSD-3-Clause
"""Everything that is slow the first time, before real messages come: numba compiles, caches fill."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha1
from pathlib import Path

import numpy as np

from .core.base.stream_names import IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from .core.base.types import Foot, ImuMessage, JointMessage, Phase, Reference, WrenchMessage
from .core.config.schema import Config
from .core.pipeline import Pipeline
from .core.robot.robot import Robot
from .messages import FROM, MessageTypes, imu_to, joint_to, reference_to, wrench_to

_PERIOD_NS = 5_000_000
_SAMPLES = 100
_APART_NS = 1_000_000  # from joint states: so that streams are interpolated, and the plan goes on by its preview


@contextmanager
def _one_at_a_time() -> Iterator[None]:
    """Processes that compile the same sources at the same time would mix up numba's cache: the others wait."""
    with ExitStack() as stack:
        with suppress(ImportError, OSError):  # without locks (Windows), or without a place for one
            import fcntl

            name = sha1(f"{os.getuid()} {Path(__file__).parent}".encode()).hexdigest()[:16]
            lock = Path(tempfile.gettempdir(), f"coman_reduced_model_{name}.lock")
            # The system takes it back when the process ends, however it ends.
            fcntl.flock(stack.enter_context(lock.open("w")), fcntl.LOCK_EX)
        yield


def warm_up(robot: Robot, config: Config, types: MessageTypes) -> None:
    """Walk on the spot for half a second in a pipeline that is thrown away: every phase, every stream.

    The messages take the way of real ones, because compiled code is made for the very types of its arguments.
    """
    with _one_at_a_time():
        _walk(robot, config, types)


def _walk(robot: Robot, config: Config, types: MessageTypes) -> None:
    pipeline = Pipeline(robot, config)
    soles = {Foot.LEFT: config.robot.left.sole_frame, Foot.RIGHT: config.robot.right.sole_frame}
    weight = robot.mass * config.robot.gravity
    names = robot.joint_names
    for index in range(_SAMPLES):
        stamp = 1_000_000_000 + index * _PERIOD_NS
        q = np.full(len(names), 0.1 + 0.001 * index)
        zero = np.zeros(len(names))
        share = (0.5, 1.0, 0.5, 0.0)[index * 8 // _SAMPLES % 4]
        for foot, part in ((Foot.LEFT, share), (Foot.RIGHT, 1.0 - share)):
            wrench = WrenchMessage(stamp + _APART_NS, soles[foot], np.array((0.0, 0.0, part * weight)), np.zeros(3))
            pipeline.feed(WRENCHES[foot], wrench_to(types, wrench), FROM[WRENCHES[foot]])
        if 2 * index > _SAMPLES:  # with an IMU, and without
            level = np.array((0.0, 0.0, 0.0, 1.0))
            imu = ImuMessage(stamp + _APART_NS, config.robot.base_frame, level, np.full(3, 0.01), np.full(3, 0.1))
            pipeline.feed(IMU, imu_to(types, imu), FROM[IMU])
        apart = _APART_NS if 2 * index < _SAMPLES else -_APART_NS
        reference = reference_to(types, _reference(stamp + apart))
        pipeline.feed(REFERENCE, reference, FROM[REFERENCE])
        motor = joint_to(types, JointMessage(stamp, names, q + 0.01, zero, None))
        pipeline.feed(MOTORS, motor, FROM[MOTORS])
        joint = joint_to(types, JointMessage(stamp, names, q, zero, zero))
        pipeline.feed(JOINTS, joint, FROM[JOINTS])


def _reference(stamp: int) -> Reference:
    com = np.array((0.0, 0.0, 0.4))
    preview = np.tile(com, (25, 1))
    zero = np.zeros(3)
    sole = np.eye(4)
    return Reference(stamp, com, zero, zero, zero, sole, sole, Phase.DOUBLE, 0, 0.02, preview, np.zeros((25, 3)))


if __name__ == "__main__":  # `make setup`: the default robot's model, and all that can be added to it
    from .bag.types import bag_types
    from .core.effects.catalogue import CATALOGUE
    from .resources import config_path

    default = Config()
    coman = Robot(config_path("coman.urdf").read_text(encoding="utf-8"), default.robot)
    of_the_robot = tuple(name for name, effect in CATALOGUE.items() if effect.place == "robot")
    for changes in ({"model.trunk_rotation": "without"}, {"effects.active": of_the_robot}):
        warm_up(coman, default.replaced(changes), bag_types())
