# SPDX-License-Identifier: BSD-3-Clause
"""Predictions ahead of a robot without reference: the filtered pendulum in closed form, and on a real robot."""

import numpy as np
import pytest
from conftest import recording
from robots import config_of

from coman_reduced_model.core.measured.odometry import pose
from coman_reduced_model.core.model.zmp_filter import CONSTANTS, ZmpFilter
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.tuning.recording import read_recording

HORIZONS = np.array([0.1, 0.2, 0.4])


def drift(rate: float, noise: float = 0.0, turned: bool = False) -> np.ndarray:
    """COM ahead (k, 3) after 2 s at 0.1 m/s along x of odom, ZMP where it was; the sole may change after 1 s."""
    follow, rng = ZmpFilter(), np.random.default_rng(3)
    T = np.eye(4)
    for i in range(round(2.0 * rate)):
        if turned and i >= rate:
            c, s = np.cos(0.1), np.sin(0.1)
            T = pose(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([0.05, -0.15, 0.0]))
        com = T[:3, :3].T @ (np.array([0.1 * i / rate, 0.02, 0.5]) - T[:3, 3])
        below = (com - T[0, :3] * 0.1 * CONSTANTS[0, 4]) * (1.0, 1.0, 0.0)
        follow.update(10**9 + round(i / rate * 1e9), T, com + noise * rng.standard_normal(3), below, 9.81)
    end = follow.ahead(com, HORIZONS, 9.81)
    return end @ T[:3, :3].T + T[:3, 3]


@pytest.mark.parametrize("turned", [False, True])
def test_a_robot_that_glides_on_goes_on(turned):
    for rate in (100.0, 1000.0):
        wanted = 0.1 * (2.0 - 1.0 / rate + HORIZONS)
        np.testing.assert_allclose(drift(rate, turned=turned)[:, 0], wanted, atol=8e-3)
        np.testing.assert_allclose(drift(rate, turned=turned)[:, 1:], [[0.02, 0.5]] * 3, atol=8e-3)


def test_noise_of_the_com_is_smoothed():
    """0.4 s ahead a velocity from two samples would be off by 60 mm and more."""
    assert abs(drift(200.0, 0.0005)[2, 0] - drift(200.0)[2, 0]) < 0.01


def test_a_gap_starts_again_and_nothing_is_kept_after_a_reset():
    follow = ZmpFilter()
    for stamp, x in ((10**9, 0.0), (10**9 + 5_000_000, 0.001), (3 * 10**9, 0.4)):
        follow.update(stamp, np.eye(4), np.array([x, 0.0, 0.5]), np.array([x, 0.0, 0.0]), 9.81)
    np.testing.assert_allclose(follow.ahead(np.array([0.4, 0.0, 0.5]), HORIZONS, 9.81)[:, 0], 0.4, atol=1e-9)


@pytest.mark.slow
def test_on_the_half_of_a_real_walk_that_no_constant_has_seen_it_beats_both_baselines():
    walk = read_recording(recording("real/icub_walk"), config_of("icub"))
    predictor = Predictor(walk.robot, config_of("icub"))
    samples = list(walk.copies())
    for sample in samples[len(samples) // 2 :]:
        predictor.update(sample)
    for h, skill in predictor.judge.skill().items():
        assert predictor.judge.judged[h].min() > 2000
        assert (skill[:2] > 0.1).all(), (h, skill)
