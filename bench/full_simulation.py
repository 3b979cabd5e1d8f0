# SPDX-License-Identifier: BSD-3-Clause
"""The very robot of a world, simulated again with the recorded motors: what a perfect model of it would be off by.

Its springs, play, friction, masses, soles and floor are those of the world, a file beside the bag (BAG.world.yaml); its
motors follow what the bag recorded of them, and it starts where the plan says. It is judged as the models are: the COM
by its joints and the masses of the data sheet, in the frame of the support sole, against the measured one. So zeros and
steps of encoders are in the error, and what an open-loop walk does not repeat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array, Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.sim.disturbances import Disturbance, Imperfections
from coman_reduced_model.sim.motion import Posture
from coman_reduced_model.sim.virtual_robot import VirtualRobot
from coman_reduced_model.sim.worlds.run import clean_variations, planned
from coman_reduced_model.sim.worlds.world import World, read_world

NONE = np.full(3, np.nan)


class Recorded:
    """Motor positions (n, nj) [rad] and velocities of a bag over time, as a motion of the virtual robot."""

    def __init__(self, t: Array, q: Array, qd: Array, start: Posture) -> None:
        self._t, self._q, self._qd, self.start = t, q, qd, start

    def __call__(self, t: Array) -> tuple[Array, Array]:
        q, qd = (np.stack([np.interp(t, self._t, joint) for joint in part.T], axis=1) for part in (self._q, self._qd))
        return q, qd


class MovedMotors(Imperfections):
    """Imperfections of joints and floor, without those of the motors, which the recorded positions hold."""

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        return theta, theta_rate


def full_simulation(bag: Path, config: Config) -> Array:
    """RMS of measured minus simulated COM (3,) [m]; NaN where the engine is another, motors are not known, or it falls.

    Args:
        bag: with its world beside it.
        config: the data sheet.
    """
    path = Path(f"{bag}.world.yaml")
    if not path.is_file() or (world := read_world(path)).engine != "mujoco":
        return NONE
    stamps, motors, measured = [], [], []
    with coman.Session(bag, config) as session:
        robot = session.robot
        for sample, prediction in session.predicted():
            if sample.motor_q is not None and sample.motor_qd is not None:
                stamps.append(sample.stamp_ns)
                motors.append((sample.motor_q, sample.motor_qd))
                measured.append((prediction.support.support_foot, prediction.measured_com))
    if not stamps:
        return NONE
    virtual = VirtualRobot(
        world.table, replace(world.sensors, motor_source="measured"), _variations(world),
        contact=world.contact, floor=world.floor,
    )  # fmt: skip
    t = (np.array(stamps) - virtual.start_ns) * 1e-9
    order = [robot.joint_names.index(name) for name in world.table.joint_names]
    q, qd = np.array(motors).transpose(1, 0, 2)[:, :, order]
    virtual.reset(Recorded(t, q, qd, planned(world)[0].start))
    simulated, at = _joints(virtual, float(t[-1]))
    if virtual.fallen:
        return NONE
    posture, errors = robot.posture(), []
    joints = np.zeros(len(robot.joint_names))
    for stamp, (foot, com) in zip(t, measured, strict=True):
        if foot == Foot.NONE:
            continue
        joints[order] = [np.interp(stamp, at, each) for each in simulated.T]
        posture.update(joints, np.zeros_like(joints))
        errors.append(com - posture.com_in_sole(foot)[0])
    rms: Array = np.sqrt(np.nanmean(np.square(errors), axis=0))
    return rms


def _variations(world: World) -> Sequence[Disturbance]:
    """Those of the robot. What motors make of a command is in the recorded positions, if these are no commands."""
    if world.sensors.motor_source == "commanded":
        return clean_variations(world)
    return [
        MovedMotors(each.seed, each.amount) if isinstance(each, Imperfections) else each
        for each in clean_variations(world)
    ]


def _joints(virtual: VirtualRobot, end: float) -> tuple[Array, Array]:
    """Joint positions (n, nj) [rad] until `end` [s], and their times (n,)."""
    joints, times = [], []
    while virtual.t < end and not virtual.fallen:
        virtual.step()
        assert virtual.truth is not None
        joints.append(virtual.truth.q)
        times.append(virtual.truth.t)
    return np.array(joints), np.array(times)
