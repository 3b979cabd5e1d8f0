# SPDX-License-Identifier: BSD-3-Clause
"""Steps that are upset: told at once when pushed or pulled, and only then."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coman_reduced_model.core.types import Foot
from coman_reduced_model.core.upset import Step, Upset

HEIGHT = 0.45  # [m] of the COM
BEGINS = 12  # step
REACH = np.array([[-0.3, 0.1], [0.2, 0.9]])  # [rad] of two motors


def walk(off, seed=0, scatter=0.0005, reach=lambda i: REACH, edge=lambda i: 0.0, steps=24):
    """Upset after every step of a gait of 0.7 s a step; `off`: by step, how far its pressure is from its place [m]."""
    rng, upset, told = np.random.default_rng(seed), Upset(HEIGHT), []
    for i in range(steps):
        foot = Foot.LEFT if i % 2 else Foot.RIGHT
        place = np.array([0.023, 0.004 if foot == Foot.LEFT else -0.004])
        upset.take(Step(foot, 0.7 * i, place + off(i) + scatter * rng.normal(size=2), edge(i), reach(i)))
        told.append(upset.told)
    return upset, told


def pulled(i, by=(0.0, -0.012)):
    return np.array(by) * (i >= BEGINS)


def pushed(i):
    """Once a second, against the steps' 0.7 s."""
    return np.array([0.015 * np.sin(2.0 * np.pi * 0.7 * i + 1.0), 0.0]) * (i >= BEGINS)


@pytest.mark.parametrize(("off", "axis"), [(pulled, 1), (pushed, 0)])
@pytest.mark.parametrize("seed", range(5))
def test_pulls_and_pushes_are_told_within_five_steps(off, axis, seed):
    upset, told = walk(off, seed)
    assert not any(told[: BEGINS + 2]) and any(told[: BEGINS + 6]) and upset.told is not None
    assert abs(upset.told.off[axis]) == pytest.approx(0.012 if axis else 0.015, abs=0.004)
    assert abs(upset.told.off[1 - axis]) < 0.002
    assert 0.7 * BEGINS <= upset.told.since <= 0.7 * (BEGINS + 1) and upset.seen > 0.7 * 20


@given(
    seed=st.integers(0, 10_000),
    scatter=st.floats(0.0, 0.003),
    sway=st.floats(-0.02, 0.02),
    strides=st.floats(1.0, 6.0),
)
def test_a_gait_that_scatters_and_sways_itself_in_is_not_told_of(seed, scatter, sway, strides):
    """Whose pressure comes near its place over the first strides."""
    _, told = walk(lambda i: np.array([sway * np.exp(-i / (2.0 * strides)), 0.0]), seed, scatter, steps=60)
    assert not any(told)


@pytest.mark.parametrize("lasts", [1, 2])
def test_a_stumble_is_not_told_of(lasts):
    _, told = walk(lambda i: np.array([0.04, 0.02]) * (BEGINS <= i < BEGINS + lasts))
    assert not any(told)


@pytest.mark.parametrize("growth", [1.3, 2.0])
def test_a_gait_that_loses_its_balance_by_itself_is_not_told_of(growth):
    """What it is off by doubles from stride to stride; a robot that rocks on the edges of its soles was never calm."""
    _, told = walk(lambda i: np.array([0.001 * growth ** (0.5 * (i - 8.0)), 0.0]) * (i > 8), steps=18)
    assert not any(told)
    assert not any(walk(pulled, edge=lambda i: 0.6)[1])


def test_another_way_to_go_is_not_told_of():
    """The trunk leans on command: motors reach elsewhere, and the pressure moves. By a tenth of that it would not."""
    assert not any(walk(pulled, reach=lambda i: REACH + 0.05 * (i >= BEGINS))[1])
    assert any(walk(pulled, reach=lambda i: REACH + 0.005 * (i >= BEGINS))[1])


def test_it_is_told_while_it_lasts_and_again_when_it_comes_again():
    upset, told = walk(lambda i: np.array([0.0, 0.015]) * (12 <= i < 20 or i >= 36), steps=44)
    on = [i for i, each in enumerate(told) if each]
    assert on[0] < 16 and 20 <= max(i for i in on if i < 36) < 26 and min(i for i in on if i >= 36) < 40
    assert upset.told is not None and upset.told.since >= 0.7 * 36


def test_missing_pressure_is_passed_over():
    _, told = walk(lambda i: np.full(2, np.nan) if i % 7 == 0 else pulled(i))
    assert not any(told[:BEGINS]) and any(told)
