# SPDX-License-Identifier: BSD-3-Clause
"""Pushes that come and go: told while they last; noise, pulls and knocks are not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coman_reduced_model.core.monitor.unsteady import EVERY_NS, Unsteady

WEIGHT, THRESHOLD = 300.0, 6.0
EVERY = 1e-9 * EVERY_NS
BEGINS, ENDS = 8.0, 16.0  # [s]


def watch(force, seconds=24.0, seed=0, noise=0.4, unsteady=None):
    """What is told after every window of a force [N] (by time) beside noise [N]."""
    rng, unsteady, told = np.random.default_rng(seed), unsteady or Unsteady(WEIGHT, THRESHOLD), {}
    for when in np.arange(0.0, seconds, EVERY):
        unsteady.take(when, np.array([0.0, 0.0, 0.0]) + force(when) + noise * rng.normal(size=3))
        told[when] = unsteady.told
    return told


@given(
    seed=st.integers(0, 10_000),
    amplitude=st.floats(10.0, 30.0),
    frequency=st.floats(1.0, 2.3),
    shift=st.floats(0.0, 6.0),
    axis=st.sampled_from([0, 1]),
)
def test_pushes_are_told_within_four_seconds_while_they_last(seed, amplitude, frequency, shift, axis):
    def push(when):
        there = BEGINS <= when < ENDS
        return np.eye(3)[axis] * amplitude * there * np.sin(2.0 * np.pi * frequency * when + shift)

    told = watch(push, seed=seed)
    assert not any(each for when, each in told.items() if when < BEGINS or when > ENDS + 3.0)
    assert all(
        [scatter.axis for scatter in each] == [axis] for when, each in told.items() if BEGINS + 4.0 < when < ENDS
    )
    (last,) = told[max(when for when in told if when < ENDS)]
    assert last.size == pytest.approx(amplitude / np.sqrt(2.0), rel=0.35) and last.sigma > THRESHOLD
    assert BEGINS - 2.0 * EVERY < last.since < BEGINS + 2.0


@given(
    seed=st.integers(0, 10_000), noise=st.floats(0.0, 3.0), pull=st.floats(-50.0, 50.0), knock=st.floats(-100.0, 100.0)
)
def test_noise_and_pulls_and_knocks_are_not_told_of(seed, noise, pull, knock):
    """A pull that begins; a foot that knocks against something at every third step."""

    def force(when):
        return np.array([pull * (when > BEGINS), knock * (round(when / EVERY) % 10 == 0), 0.0])

    assert not any(watch(force, 60.0, seed, noise).values())


def test_windows_of_which_nothing_is_known_are_left_out():
    def push(when):
        return np.array([20.0 * np.sin(8.0 * when) * (when > BEGINS), 0.0, 0.0])

    def seldom(when):
        return push(when) if round(when / EVERY) % 4 else np.full(3, np.nan)

    assert any(watch(seldom).values())
    unsteady = Unsteady(WEIGHT, THRESHOLD)
    assert any(watch(push, unsteady=unsteady).values()) and unsteady.seen == pytest.approx(24.0 - EVERY)
    unsteady.reset()
    assert not unsteady.told and not unsteady.seen
    assert not any(watch(lambda when: push(BEGINS + when), unsteady=unsteady).values())  # it was never calm


def test_a_pull_on_feet_that_are_turned_out_is_steady():
    """Told in the axes of the foot that bears, 40 degrees from those of the other."""
    unsteady, rng = Unsteady(WEIGHT, THRESHOLD), np.random.default_rng(0)
    for k in range(120):
        heading = 0.35 * (1 if k // 2 % 2 else -1)
        pull = 20.0 * (k * EVERY > BEGINS)
        force = pull * np.array([-np.sin(heading), np.cos(heading), 0.0]) + 0.4 * rng.normal(size=3)
        unsteady.take(k * EVERY, force, heading)
        assert not unsteady.told
