# SPDX-License-Identifier: BSD-3-Clause
"""Intermittent forces are detected while they last; noise, steady pulls and single hits are not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coman_reduced_model.core.monitor.unsteady import INTERVAL_NS, IntermittentForces

LEAST, THRESHOLD = np.full(2, 0.9), 6.0  # [N]; standard deviations
EVERY = 1e-9 * INTERVAL_NS
BEGINS, ENDS = 8.0, 16.0  # [s]


def watch(force, seconds=24.0, seed=0, noise=0.4, detector=None):
    """Forces detected after each window of a force [N] (by time) with noise [N], by time."""
    rng, detector, found = np.random.default_rng(seed), detector or IntermittentForces(LEAST, THRESHOLD), {}
    for when in np.arange(0.0, seconds, EVERY):
        detector.update(when, np.array([0.0, 0.0, 0.0]) + force(when) + noise * rng.normal(size=3))
        found[when] = detector.forces
    return found


@given(
    seed=st.integers(0, 10_000),
    amplitude=st.floats(10.0, 30.0),
    frequency=st.floats(1.0, 2.3),
    shift=st.floats(0.0, 6.0),
    axis=st.sampled_from([0, 1]),
)
def test_intermittent_force_is_detected_within_four_seconds_while_it_lasts(seed, amplitude, frequency, shift, axis):
    def push(when):
        there = BEGINS <= when < ENDS
        return np.eye(3)[axis] * amplitude * there * np.sin(2.0 * np.pi * frequency * when + shift)

    found = watch(push, seed=seed)
    assert not any(each for when, each in found.items() if when < BEGINS or when > ENDS + 3.0)
    assert all([force.axis for force in each] == [axis] for when, each in found.items() if BEGINS + 4.0 < when < ENDS)
    (last,) = found[max(when for when in found if when < ENDS)]
    assert last.size == pytest.approx(amplitude / np.sqrt(2.0), rel=0.35) and last.ratio > THRESHOLD
    assert BEGINS - 2.0 * EVERY < last.onset < BEGINS + 2.0


@pytest.mark.slow
@given(
    seed=st.integers(0, 10_000), noise=st.floats(0.0, 3.0), pull=st.floats(-50.0, 50.0), hit=st.floats(-100.0, 100.0)
)
def test_noise_pulls_and_hits_are_not_detected(seed, noise, pull, hit):
    """A pull that begins; a foot that hits an obstacle at every third step."""

    def force(when):
        return np.array([pull * (when > BEGINS), hit * (round(when / EVERY) % 10 == 0), 0.0])

    assert not any(watch(force, 60.0, seed, noise).values())


def test_unknown_windows_are_left_out():
    def push(when):
        return np.array([20.0 * np.sin(8.0 * when) * (when > BEGINS), 0.0, 0.0])

    def seldom(when):
        return push(when) if round(when / EVERY) % 4 else np.full(3, np.nan)

    assert any(watch(seldom).values())
    detector = IntermittentForces(LEAST, THRESHOLD)
    assert any(watch(push, detector=detector).values()) and detector.last == pytest.approx(24.0 - EVERY)
    detector.reset()
    assert not detector.forces and not detector.last
    assert not any(watch(lambda when: push(BEGINS + when), detector=detector).values())  # no calm time before it


def test_pull_on_feet_that_are_turned_out_is_steady():
    """Given in the axes of the support foot, 40 degrees from those of the other."""
    detector, rng = IntermittentForces(LEAST, THRESHOLD), np.random.default_rng(0)
    for k in range(120):
        heading = 0.35 * (1 if k // 2 % 2 else -1)
        pull = 20.0 * (k * EVERY > BEGINS)
        force = pull * np.array([-np.sin(heading), np.cos(heading), 0.0]) + 0.4 * rng.normal(size=3)
        detector.update(k * EVERY, force, heading)
        assert not detector.forces
