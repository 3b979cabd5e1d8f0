# SPDX-License-Identifier: BSD-3-Clause
"""Deflections ahead against those that came, and their sigma against what they were off by."""

import numpy as np
import pytest

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.evaluation.deflections import DeflectionJudge
from coman_reduced_model.resources import bag_path

KNEE, ANKLE = 3 + 3, 3 + 4  # after the COM's three: the soft joints of the left leg


@pytest.fixture(scope="module")
def walk():
    """Stamps (n,) [s], whether strides repeat (n,), deflections and sigma (n, 1 + k, 15) of test 1."""
    with Session(bag_path("test1"), load_config()) as session:
        made = [p for p in session.predictions() if p.deflections]
    values = np.array([[np.r_[d.com, d.joints] for d in p.deflections] for p in made])
    sigma = np.array([[np.r_[d.com_sigma, d.joint_sigma] for d in p.deflections] for p in made])
    stamps = np.array([p.stamp_ns for p in made])
    return (stamps - stamps[0]) * 1e-9, np.array([p.repeating for p in made]), values, sigma


@pytest.mark.parametrize(("number", "h"), [(1, 0.1), (2, 0.2), (3, 0.4)])
def test_ahead_in_a_repeated_stride_is_far_better_than_to_hold_what_is_now(walk, number, h):
    t, repeating, values, sigma = walk
    now = values[:, 0]
    came = np.column_stack([np.interp(t + h, t, column) for column in now.T])
    there = repeating & (t + h < t[-1])
    assert there.sum() > 300
    off, held = ((each - came)[there] for each in (values[:, number], now))
    rms, rms_held = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (off, held))
    assert rms[0] < 0.5 * rms_held[0]  # COM, x
    assert (rms[[KNEE, ANKLE]] < 0.35 * rms_held[[KNEE, ANKLE]]).all()
    said = np.sqrt(np.nanmean(np.square(sigma[there, number]), axis=0))
    assert (0.4 * rms[[0, KNEE, ANKLE]] < said[[0, KNEE, ANKLE]]).all()
    assert (said[[0, KNEE, ANKLE]] < 4.0 * rms[[0, KNEE, ANKLE]]).all()


def test_sigma_is_the_rms_of_the_errors_by_kind_and_nan_before():
    judge, rng = DeflectionJudge(np.array([0.1]), np.array([1])), np.random.default_rng(0)
    measured = np.ones(3), np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.5]), np.array([0.0, 0.4])
    now = np.array([0.0, 1.0, 0.0, 0.1])
    first = judge.update(10**9, *measured, np.array([now, now]), False)
    assert np.isnan(first[1]).all()
    sigma = first
    for k in range(1, 4000):
        predicted = np.array([now, now + rng.standard_normal(4) * [0.01, 0.02, 0.03, 0.2]])
        sigma = judge.update(10**9 + 5_000_000 * k, *measured, predicted, True)
    assert sigma[1] == pytest.approx([0.01, 0.02, 0.03, 0.2], rel=0.15)
    held = judge.update(10**9 + 5_000_000 * 4000, *measured, np.array([now, now]), False)
    assert not (held[1] > 1e-9).any()  # such predictions were hardly ever made, and none was wrong


@pytest.mark.parametrize(("rate", "h"), [(200, 2.0), (2000, 2.0), (2600, 0.4)])
def test_sigma_is_known_at_any_rate(rate, h):
    judge, zero = DeflectionJudge(np.array([h]), np.zeros(0, dtype=np.intp)), np.zeros(3)
    for k in range(round((h + 1.0) * rate)):
        sigma = judge.update(10**9 + k * 10**9 // rate, zero, zero, zero, zero, np.full((2, 3), 1e-3), False)
    assert sigma[1, 0] == pytest.approx(1e-3, rel=0.1)


def test_after_a_jump_of_time_nothing_old_is_judged():
    judge, zero = DeflectionJudge(np.array([0.1]), np.zeros(0, dtype=np.intp)), np.zeros(3)
    judge.update(10**9, zero, zero, zero, zero, np.full((2, 3), 5.0), True)
    judge.restart()
    for k in range(100):
        sigma = judge.update(2 * 10**9 + 5_000_000 * k, zero, zero, zero, zero, np.zeros((2, 3)), True)
    assert sigma[1, 0] == 0.0
