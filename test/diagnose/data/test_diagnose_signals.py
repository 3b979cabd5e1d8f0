# SPDX-License-Identifier: BSD-3-Clause
"""Lags, and springs that are bent, against formulas and an integrator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_tools import index, standing, t
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from coman_reduced_model.diagnose.data.recording import RATE
from coman_reduced_model.diagnose.data.signals import (
    Smoothed,
    _lost_stretch,
    believed,
    bent_stretch,
    beyond_noise,
    lagged,
    rate_of,
    smooth,
    spring_stretch,
)

few = settings(max_examples=20)


@settings(max_examples=8)
@given(st.floats(-0.9, 0.9), st.floats(0.5, 8.0), st.floats(5.0, 20.0))
def test_a_bent_spring_is_what_an_integrator_says(bend, d, amplitude):
    k, dt = 130.0, 0.005
    cubic = bend / 3.0 / (1.5 * amplitude / k) ** 2
    torque = amplitude * np.sin(2.0 * np.pi * t[:400])

    def rate(at, x):
        return (np.interp(at, t, amplitude * np.sin(2.0 * np.pi * t)) - k * x * (1.0 + cubic * x**2)) / d

    exact = solve_ivp(rate, (0.0, t[399]), [0.0], t_eval=t[:400], max_step=dt, rtol=1e-8, atol=1e-10).y[0]
    found = bent_stretch(np.ascontiguousarray(torque), k, d, cubic, dt)
    assert found == pytest.approx(exact, abs=3e-3 * amplitude / k)


def test_lost_motion_takes_its_time_and_stays_where_it_slipped():
    """The damper holds it back: width d / (torque - friction); then it stays."""
    k, d, width, friction, dt = 600.0, 12.0, 0.014, 0.5, 0.002
    times = np.arange(0.0, 1.6, dt)
    torque = np.where(times < 0.4, -5.0, np.where(times < 1.0, 3.0, 0.3))
    slipped = _lost_stretch(torque, k, d, width / 2.0, friction, dt) - _lost_stretch(torque, k, d, 0.0, friction, dt)
    at = np.interp([0.39, 0.99, 1.59], times, slipped)
    assert at == pytest.approx([-width / 2.0, width / 2.0, width / 2.0], rel=1e-2)
    lasts = width * d / (3.0 - friction)
    crosses = times[(times > 0.4) & (slipped > 0.0)][0] - 0.4
    assert 0.5 * lasts < crosses < 0.5 * lasts + 3.0 * d / k  # the spring has to turn round first


def test_a_straight_spring_is_the_same_bent_by_nothing():
    """Else the difference between two ways to compute the same would speak for an effect."""
    world, torque, j = standing()[1], 10.0 * np.sin(3.0 * t), index()
    straight, bent, backwards = (
        spring_stretch(replace(world, cubic=np.full_like(world.cubic, cubic)), j, torque)
        for cubic in (0.0, 1e-9, -1e-9)
    )
    assert bent == pytest.approx(straight, abs=1e-12) and backwards == pytest.approx(straight, abs=1e-12)
    for k, d in ((130.0, 3.0), (130.0, 0.0)):
        assert bent_stretch(torque, k, d, 0.0, 1.0 / RATE) == pytest.approx(lagged(torque, d / k) / k, abs=1e-12)


@settings(max_examples=20)
@example(bend=-0.9, d=0.0, dt=0.04)
@given(st.floats(-0.9, -0.4), st.floats(0.0, 0.6), st.sampled_from([1.0 / RATE, 0.04]))
def test_a_spring_that_softens_far_is_still_a_spring(bend, d, dt):
    """Where its tangent has fallen to a fifth it goes on straight; torques that turn round within a sample too."""
    k, amplitude = 130.0, 20.0
    cubic = bend / (amplitude / k) ** 2
    torque = amplitude * np.sign(np.sin(40.0 * t)) * np.abs(np.sin(40.0 * t)) ** 0.3
    x = bent_stretch(torque, k, d, cubic, dt)
    straight = np.sqrt(0.8 / (-3.0 * cubic))
    at = np.clip(x, -straight, straight)
    borne = k * (at + cubic * at**3 + (1.0 + 3.0 * cubic * at**2) * (x - at))
    if d == 0.0:  # the spring bears it all
        assert borne == pytest.approx(torque, abs=1e-9)
    assert np.abs(x).max() <= amplitude / (0.2 * k) + straight
    assert np.all(np.sign(x[np.abs(x) > straight]) == np.sign(borne[np.abs(x) > straight]))


def test_friction_acts_before_it_is_smoothed():
    """The joint turns round within the smoothing: friction of its smoothed speed would be sharper, and lasts longer."""
    q = np.column_stack([0.2 * np.abs((t * f) % 2.0 - 1.0) / f for f in (1.0, 3.0)])
    turns = smooth(np.sign(rate_of(q)))
    inside = slice(40, -40)
    found = Smoothed().rubbing(q, np.full(2, 0.01))[inside]
    assert np.abs(found - turns[inside]).max() < 0.1
    assert np.mean(found * turns[inside]) == pytest.approx(np.mean(turns[inside] ** 2), rel=0.02)


def test_friction_is_remembered_for_one_motion_and_one_law():
    smoothed, q = Smoothed(), 0.1 * np.sin(6.0 * t)[:, None]
    first, slow = np.full(1, 0.05), np.full(1, 0.5)
    known = smoothed.rubbing(q, first)
    assert smoothed.rubbing(q, first) is known
    for other in (smoothed.rubbing(q, slow), smoothed.rubbing(q.copy() * 0.1, first)):
        assert np.abs(other).max() < 0.9 * np.abs(known).max()


@few
@given(st.integers(0, 2**31), st.floats(0.02, 1.0), st.sampled_from([1, 2, 4]))
def test_a_sensor_is_believed_but_for_what_its_noise_makes(seed, noise, stride):
    samples = noise * np.random.default_rng(seed).standard_normal((len(t[::stride]), 1))
    white = np.interp(t, t[::stride], samples[:, 0])[:, None]
    wave = 20.0 * np.sin(2.0 * np.pi * 4.0 * t)[:, None]
    inside, sigma = slice(60, -60), np.array([noise])
    alone = smooth(believed(white, sigma, stride))[inside]
    slow = smooth(believed(white, 100.0 * sigma, stride))[inside]
    assert np.std(alone - slow) < 0.7 * np.std(smooth(white)[inside] - slow)  # most of what is fast in it is gone
    assert smooth(believed(wave + white, sigma, stride))[inside] == pytest.approx(
        smooth(wave)[inside], abs=0.1 + 2.0 * noise
    )
    beside = noise * np.sqrt(stride) * np.sin(2.0 * np.pi * 5.0 * t)[:, None]  # well above what smoothed noise leaves
    kept = smooth(believed(beside + white, sigma, stride) - believed(white, sigma, stride))[inside]
    assert np.sum(kept * smooth(beside)[inside]) > 0.6 * np.sum(smooth(beside)[inside] ** 2)


def test_a_lag_is_exact_on_a_ramp_and_leads_the_other_way():
    ramp = 2.0 * t[:, None]
    assert lagged(ramp, 0.05)[-100:] == pytest.approx(ramp[-100:] - 2.0 * 0.05, abs=1e-9)
    assert lagged(ramp, -0.05)[50:-50] == pytest.approx(ramp[50:-50] + 2.0 * 0.05, abs=1e-9)
    step = np.where(t > 1.0, 1.0, 0.0)[:, None]
    assert lagged(step, 0.2)[240 + 1, 0] == pytest.approx(1.0 - np.exp(-1.0), abs=0.02)


def test_a_sensor_is_believed_as_far_as_its_noise_does_not_explain_the_gap():
    """A swing of 1 Hz between sensor and law, and the sensor's noise."""
    swing, noise = np.sin(2.0 * np.pi * t), np.random.default_rng(0).normal(size=len(t))
    within = slice(100, -100)
    found = beyond_noise(0.01 * swing + 1e-3 * noise, 1e-3)[within]
    assert found == pytest.approx(0.01 * swing[within], abs=1.5e-3)  # all of it, without the noise
    found = beyond_noise(2e-4 * swing + 1e-3 * noise, 1e-3)[within]
    assert np.abs(found).max() < 1e-4  # the law
    found = beyond_noise(3e-3 + 2e-4 * swing, 1e-3)[within]
    assert found == pytest.approx(3e-3, abs=1e-4)  # what is slow is the sensor's
