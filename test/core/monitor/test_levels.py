# SPDX-License-Identifier: BSD-3-Clause
"""Level and noise of a channel: what is learnt, and how sure the monitor is of a deviation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import polygamma
from scipy.stats import norm, t

from coman_reduced_model.core.monitor.channels import Row
from coman_reduced_model.core.monitor.laws import PhaseMean
from coman_reduced_model.core.monitor.levels import (
    CHANNEL,
    as_normal,
    degrees_of_freedom,
    noise_by_law,
    update_channels,
)

CHANNELS, THRESHOLD = 12, 5.0
ROW = Row(
    "rad",
    1.0,
    1.0,
    by_robot=0.8,
    by_channel=0.5,
    drift=0.0,
    robots=0.0,
    by_load=0.0,
    usual=0.0,
    usual_load=0.0,
    usual_slope=0.0,
)


def followed(values, row=ROW):
    """States of 12 channels of one law after each phase, by their values (phases, 12); usual noise: 1."""
    channels = np.zeros(CHANNELS, dtype=CHANNEL)
    channels["error_sigma"] = np.nan
    laws, law_of = noise_by_law(SimpleNamespace(nominal={"spring": row}, rows=["spring"] * CHANNELS))
    nothing, all_of_them = np.zeros(CHANNELS), np.ones(CHANNELS, dtype=bool)
    out = []
    for k, value in enumerate(values):
        mean = PhaseMean(value, nothing, nothing, nothing)
        update_channels(
            channels, laws, law_of, mean, all_of_them, np.ones(CHANNELS), nothing, nothing, THRESHOLD, float(k)
        )
        out.append(channels.copy())
    return np.array(out)


@given(st.floats(2.0, 60.0), st.floats(0.5, 6.0))
@settings(max_examples=50, deadline=None)
def test_a_deviation_is_as_unlikely_as_the_normal_one_that_it_is_converted_to(freedom, deviation):
    expected = norm.isf(t.sf(deviation, freedom))
    assert as_normal(deviation, freedom) == pytest.approx(expected, abs=0.05)
    assert as_normal(-deviation, freedom) == -as_normal(deviation, freedom)


@given(st.floats(0.1, 1.5))
def test_degrees_of_freedom_give_the_scatter_of_the_logarithm_that_they_are_taken_from(scatter):
    freedom = float(degrees_of_freedom(np.array(scatter)))
    assert 0.5 * np.sqrt(polygamma(1, 0.5 * freedom)) == pytest.approx(scatter, rel=0.2)


@given(st.floats(-1.5, 3.0), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_any_noise_is_learnt(logarithm, seed):
    """From a quarter of the usual noise to twenty times as much: of 360 values after 10 phases few are beyond 3.

    And none is an alarm; of thirty examples with 360 values each, one in fourteen has a value beyond 4.5 by chance.
    """
    rng = np.random.default_rng(seed)
    states = followed(rng.normal(0.0, np.exp(logarithm), (40, CHANNELS)))
    sigma = np.abs(states["error_sigma"][10:])
    assert 0.5 < np.sqrt(np.mean(np.minimum(sigma, 4.0) ** 2)) < 1.25 or np.exp(logarithm) < 0.3
    assert np.mean(sigma > 3.0) < 0.02 and states["change_sigma"].max() < 6.0


def test_a_noisy_law_is_known_from_its_other_channels():
    """A channel that is seen for the third time: a deviation counts less where the other channels are noisy."""
    rng = np.random.default_rng(1)

    def third(noise):
        values = rng.normal(0.0, noise, (12, CHANNELS))
        values[:8, 0], values[8:, 0] = np.nan, [0.0, 0.0, 0.0, 5.0]
        return followed(values)["error_sigma"][-1, 0]

    assert third(5.0) < 1.5 < 2.5 < third(0.3)


@pytest.mark.parametrize("noise", [0.3, 1.0, 5.0])
def test_a_step_of_six_deviations_is_seen_after_two_phases_whatever_the_noise(noise):
    rng = np.random.default_rng(2)
    values = rng.normal(0.0, noise, (16, CHANNELS))
    values[14:, 3] += 6.0 * noise
    states = followed(values)
    assert states["change_sigma"][15, 3] > 3.0 > np.abs(states["change_sigma"][13]).max()
    assert states["change_sigma"][14, 3] < 2.5  # a single one is noise
    assert states["change_onset"][15, 3] == 14.0


def test_where_the_noise_of_the_robot_is_known_a_step_is_seen_in_its_first_strides():
    values = np.random.default_rng(4).normal(0.0, 1.0, (6, CHANNELS))
    values[4:, 3] += 7.0
    own = ROW._replace(by_robot=0.1, by_channel=0.1)
    any_robot, this_robot = (followed(values, row)["change_sigma"][-1, 3] for row in (ROW, own))
    assert this_robot > THRESHOLD > any_robot


def test_a_stumble_does_not_hide_what_follows():
    rng = np.random.default_rng(3)
    values = rng.normal(0.0, 1.0, (30, CHANNELS))
    values[12] += 1000.0
    values[28:, 5] += 8.0
    states = followed(values)
    assert np.abs(states["change_sigma"][:28]).max() < 4.5 and states["change_sigma"][29, 5] > 3.0
