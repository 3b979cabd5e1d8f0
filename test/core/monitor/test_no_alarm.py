# SPDX-License-Identifier: BSD-3-Clause
"""What is no mismatch: the monitor stays quiet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from monitor_tools import BEGINS, FEET, KNEE, LEVEL, LOADED, mismatches, turned, watched
from scipy.spatial.transform import Rotation
from synthetic import JOINTS, LEFT, MOTORS, names, robot

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.monitor.monitor import Monitor
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.resources import bag_path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["test1", "test2"])
def test_nominal_robot_gives_no_alarm(tmp_path, name):
    assert mismatches(bag_path(name), tmp_path / "out") == []


@pytest.mark.slow
@pytest.mark.parametrize("left", [[20.0, -12.0, 60.0], [20.0, -12.0, -25.0]])
def test_zeros_of_foot_sensors_that_are_still_being_learnt_are_no_mismatch(left):
    """60 and 20 N too much on the feet; and zeros that cancel in the total, which only feet in the air show."""
    zeros = np.array([[*left, 1.0, -2.0, 0.3], [-15.0, 30.0, 20.0, -1.5, 0.5, -0.2]])
    with coman.Session(bag_path("test1")) as session:
        predictor = Predictor(session.robot, session.config)
        monitor = Monitor(session.robot, session.config, predictor.zeros)
        for sample in session.samples():
            if sample.left_wrench is not None and sample.right_wrench is not None:
                wrenches = sample.left_wrench + zeros[0], sample.right_wrench + zeros[1]
                sample = replace(sample, left_wrench=wrenches[0], right_wrench=wrenches[1])
            prediction = predictor.update(sample)
            monitor.update(predictor.sample, predictor.link, prediction)
    assert predictor.zeros.active and monitor.phases > 10
    assert not monitor.first and not monitor.mismatches


@pytest.mark.slow
@pytest.mark.parametrize("until", [6.0, 20.0])
def test_imu_mounting_error_or_loss_is_no_external_force(until):
    tilted = Rotation.from_euler("xyz", [0.03, 0.03, 0.0]).as_quat()
    monitor = watched(lambda stream, t, message: message, 20.0, imu=lambda t: tilted if t < until else None)
    assert monitor.laws.forces.uses_imu == (until > 19.0)
    assert not [channel for channel in monitor.first if channel.split("/")[0] in ("force", "torque", "unsteady")]


def test_single_push_is_no_mismatch():
    def change(stream, t, message):
        shove = stream == LEFT and 9.9 < t < 10.2  # in one left support
        return replace(message, force=message.force + [0.0, 20.0, 0.0]) if shove else message

    assert not watched(change).first


@pytest.mark.slow
def test_sensor_drift_is_no_mismatch():
    """Sensors that drift by 0.15 N a stride, 2 N in all; the same as a step is detected."""
    drift, step = ((lambda t: 0.125 * t), (lambda t: 2.0 * (t >= BEGINS)))

    def detected(off):
        def change(stream, t, message):
            return replace(message, force=message.force + [off(t), 0.0, 0.0]) if stream in FEET.values() else message

        return watched(change, 15.0).first

    assert not detected(drift) and detected(step)


@pytest.mark.slow
def test_laws_of_flat_soles_are_skipped_on_the_edges_of_the_soles():
    """From 7 s on it stands on its toes, and the support foot gets 10 N more from the side."""

    def watch(lever, imu=False):
        def change(stream, t, message):
            if stream not in FEET.values() or t < BEGINS or message.force[2] < LOADED:
                return message
            toes = [0.0, -lever * message.force[2], 0.0]
            return replace(message, force=message.force + [0.0, 10.0, 0.0], torque=message.torque + toes)

        return {name.split("/")[0] for name in watched(change, imu=lambda t: LEVEL if imu else None).first}

    front = float(robot().soles[Foot.LEFT][1])
    assert {"force", "torque"} <= watch(0.5 * front)
    assert not watch(front - 0.001)
    found = watch(front - 0.001, imu=True)  # which holds there too
    assert "force" in found and found <= {"force", "unsteady"}


def test_stumble_is_no_mismatch():
    def change(stream, t, message):
        return turned(message, KNEE, 0.02) if stream == JOINTS and 7.0 < t < 7.6 else message

    assert not watched(change).first


def test_another_gait_is_no_mismatch():
    """From 6 s on it walks with knees more bent, whose springs carry more: 5 % off, as nominal ones are."""
    bend = np.array([-0.1, 0.0, 0.0, 0.2, -0.1, 0.0] * 2)

    def change(stream, t, message):
        if stream not in (JOINTS, MOTORS):
            return message
        if t > 6.0:
            message = replace(message, position=message.position + bend)
            if stream == MOTORS:
                return turned(message, KNEE, 1.05 * 3.0 / 180.0)
            effort = message.effort.copy()
            effort[KNEE] += 3.0
            message = replace(message, effort=effort)
        return message

    monitor = watched(change, 16.0)
    assert not monitor.first and monitor.phases > 40


@pytest.mark.slow
@pytest.mark.parametrize(("slip", "detected"), [(0.00007, False), (0.0015, True)])
def test_noise_floor_prevents_false_alarms_on_noise_free_sensors(slip, detected):
    """The same deflection in 120 strides, then a change far below the nominal sensor noise: no mismatch."""
    still, begins = 0.01 * np.array(Config().robot.left.stiffness + Config().robot.right.stiffness), 144.0

    def change(stream, t, message):
        if stream == JOINTS:
            return replace(message, position=np.zeros(12), velocity=np.zeros(12), effort=still)
        if stream == MOTORS:
            return replace(message, position=np.full(12, 0.01 + slip * (t >= begins)), velocity=np.zeros(12))
        return message

    found = watched(change, begins + 5.0, rate=50.0).first
    assert {channel for channel in found if channel.startswith("spring/")} == (
        {f"spring/{joint}" for joint in names()} if detected else set()
    )
