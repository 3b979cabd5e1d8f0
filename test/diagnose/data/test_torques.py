# SPDX-License-Identifier: BSD-3-Clause
"""Torques of a sensor, and torques that are computed from the deflection of the springs."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.diagnose.data.torques import from_deflection

STIFFNESS = np.array([3000.0, 100.0])  # [Nm/rad] of a stiff and of a soft joint
COUNT = 2.0 * np.pi / 4096


def joints(count=COUNT, n=1000):
    """Torques (n, 2), motor side, link side as encoders show it, and its deflection without rounding."""
    t = np.arange(n) / 200.0
    tau = np.column_stack([5.0 * np.sin(6.0 * t), 3.0 * np.sin(6.0 * t + 1.0)])
    motor_q = 0.3 * np.sin(4.0 * t)[:, None] * np.ones(2)
    q = motor_q - tau / STIFFNESS
    return tau, motor_q, count * np.round(q / count) if count else q


def test_torques_that_show_the_rounding_of_the_encoders_are_computed():
    _, motor_q, q = joints()
    computed = STIFFNESS * 1.1 * (motor_q - q)  # with a stiffness that is off
    assert from_deflection(computed, motor_q, q, np.full(2, COUNT))
    assert from_deflection(computed, None, q, np.full(2, COUNT))  # motors that are not recorded


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.5])
def test_torques_of_a_sensor_are_measured(noise):
    tau, motor_q, q = joints()
    tau = tau + noise * np.random.default_rng(0).standard_normal(tau.shape)
    assert not from_deflection(tau, motor_q, q, np.full(2, COUNT))
    assert not from_deflection(tau, None, q, np.full(2, COUNT))


def test_encoders_without_rounding_show_nothing():
    tau, motor_q, q = joints(count=0.0)
    assert not from_deflection(tau, motor_q, q, np.zeros(2))


def test_streams_that_are_missing():
    tau, motor_q, q = joints()
    assert not from_deflection(None, motor_q, q, np.full(2, COUNT))
    assert not from_deflection(tau, motor_q, None, np.full(2, COUNT))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_torques_that_go_with_the_motion_are_no_rounding(sign):
    """Of a joint without motor states: at 100 Hz a motion of 15 rad/s^2 changes as fast as by rounding."""
    t = np.arange(1000) / 100.0
    q = np.column_stack([15.0 / w**2 * np.sin(w * t) for w in (16.0, 18.0)])
    rounded = COUNT * np.round(q / COUNT)
    assert np.std(np.diff(rounded, 2, axis=0)) > 0.9 * COUNT
    tau = sign * 50.0 * q + 0.002 * np.random.default_rng(0).standard_normal(q.shape)
    assert not from_deflection(tau, None, rounded, np.full(2, COUNT))


def test_joints_without_motor_states_among_others():
    _, motor_q, q = joints()
    computed = STIFFNESS * (motor_q - q)
    assert from_deflection(computed, np.full_like(q, np.nan), q, np.full(2, COUNT))
