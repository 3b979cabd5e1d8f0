# SPDX-License-Identifier: BSD-3-Clause
"""Velocity of the COM against the ground: a stiff robot that rocks about the edge of its sole, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from rotation_tools import BENT, NOMINAL, RATE, imu, now, robot
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import Estimate
from coman_reduced_model.core.observer.observer import Observer

EDGE = np.array([0.06, 0.0, 0.0])  # about which the sole turns [m]
GRAVITY = 9.81


def angle(t: float) -> np.ndarray:
    """Pitch of the robot, its rate and its acceleration [rad], [rad/s], [rad/s^2]."""
    w, a = 2.0 * np.pi * 0.8, 0.03
    return a * np.array([1.0 - np.cos(w * t), w * np.sin(w * t), w * w * np.cos(w * t)])


def rocked(with_imu: bool, seconds: float = 5.0) -> tuple[list[Estimate], np.ndarray]:
    """Estimates of the last two seconds, and the true velocities in the axes of the sole."""
    observer, mass = Observer(robot(), GRAVITY, NOMINAL), robot().mass
    found, true = [], []
    for k in range(round(seconds * RATE)):
        t = k / RATE
        pitch, rate, faster = angle(t)
        turn = Rotation.from_euler("y", pitch)
        stamp = 10**9 + round(t * 1e9)
        each = now(stamp, BENT, imu(stamp, turn, np.array([0.0, rate, 0.0])) if with_imu else None)
        arm = each.com - EDGE
        spin = np.array([0.0, rate, 0.0])
        acceleration = np.cross([0.0, faster, 0.0], arm) + np.cross(spin, np.cross(spin, arm))
        force = mass * (acceleration - turn.inv().apply([0.0, 0.0, -GRAVITY]))
        each.sample.left_wrench = np.concatenate([force, np.cross(EDGE, force)])
        each.sample.right_wrench = np.zeros(6)
        estimate = observer.update(each)
        if t > seconds - 2.0:
            found.append(estimate)
            true.append(np.cross(spin, arm))
    return found, np.array(true)


def test_with_an_imu_it_is_that_of_the_rolling_sole():
    found, true = rocked(True)
    errors = np.array([each.ground_vel for each in found]) - true
    assert np.abs(true).max() > 0.05
    assert np.sqrt((errors**2).mean(axis=0)).max() < 0.15 * np.abs(true).max()
    for each in found[::20]:
        assert np.linalg.eigvalsh(each.ground_vel_covariance).min() > 0.0
        np.testing.assert_allclose(each.ground_vel_covariance, each.ground_vel_covariance.T, rtol=1e-9)


def test_the_velocity_in_the_sole_is_not():
    """The joints do not move: in the frame of the sole, the COM is at rest."""
    found, true = rocked(True)
    assert np.abs([each.com_vel[0] for each in found]).max() < 0.5 * np.abs(true[:, 0]).max()


def test_without_an_imu_nobody_knows_it():
    for each in rocked(False, 3.0)[0]:
        assert np.isnan(each.ground_vel).all() and np.isnan(each.ground_vel_covariance).all()
        assert np.isfinite(each.com_vel).all()


def test_it_begins_again_where_the_imu_is_lost():
    observer = Observer(robot(), GRAVITY, NOMINAL)
    weight = np.array([0.0, 0.0, robot().mass * GRAVITY, 0.0, 0.0, 0.0])
    for k in range(300):
        stamp = 10**9 + 5_000_000 * k
        message = None if 100 <= k < 200 else imu(stamp, Rotation.from_euler("y", 0.02), np.zeros(3))
        each = now(stamp, BENT, message)
        each.sample.left_wrench, each.sample.right_wrench = weight, np.zeros(6)
        estimate = observer.update(each)
        if not 100 <= k < 160:  # its next message may come
            assert np.isfinite(estimate.ground_vel).all() == (message is not None)
        if k > 20 and message is not None:
            assert estimate.ground_vel == pytest.approx(np.zeros(3), abs=0.1)
