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
STEP_S = 0.7
WALKED = np.array([[-0.3, 0.1], [0.2, 0.9], [0.5, 0.8]])  # [rad] of two motors in a step
PLACE = {Foot.LEFT: np.array([0.023, 0.004]), Foot.RIGHT: np.array([0.023, -0.004])}


def walk(off, seed=0, scatter=0.0005, walked=lambda i: WALKED, edge=lambda i: 0.0, steps=24, upset=None):
    """An `Upset`, and what it told after every step; `off`: by step, how far its pressure is from its place [m]."""
    rng, upset, told = np.random.default_rng(seed), upset or Upset(HEIGHT), []
    for i in range(steps):
        foot = Foot.LEFT if i % 2 else Foot.RIGHT
        pressure = PLACE[foot] + off(i) + scatter * rng.normal(size=2)
        upset.take(Step(foot, STEP_S * i, pressure, edge(i), walked(i), STEP_S))
        told.append(upset.told)
    return upset, told


def pulled(i, by=(0.0, -0.012)):
    return np.array(by) * (i >= BEGINS)


def pushed(i):
    """Once a second, against the steps' 0.7 s."""
    return np.array([0.015 * np.sin(2.0 * np.pi * STEP_S * i + 1.0), 0.0]) * (i >= BEGINS)


@pytest.mark.parametrize(("off", "axis"), [(pulled, 1), (pushed, 0)])
@pytest.mark.parametrize("seed", range(5))
def test_pulls_and_pushes_are_told_within_six_steps(off, axis, seed):
    upset, told = walk(off, seed)
    assert not any(told[: BEGINS + 3]) and any(told[: BEGINS + 7]) and upset.told is not None
    assert abs(upset.told.off[axis]) == pytest.approx(0.012 if axis else 0.015, abs=0.004)
    assert abs(upset.told.off[1 - axis]) < 0.002
    assert STEP_S * BEGINS <= upset.told.since <= STEP_S * (BEGINS + 1) and upset.seen > STEP_S * 18


@given(
    seed=st.integers(0, 10_000),
    scatter=st.floats(0.0, 0.0015),
    sway=st.floats(-0.02, 0.02),
    strides=st.floats(1.0, 6.0),
)
def test_a_gait_that_scatters_and_sways_itself_in_is_not_told_of(seed, scatter, sway, strides):
    """Whose pressure comes near its place over the first strides."""
    _, told = walk(lambda i: np.array([sway * np.exp(-i / (2.0 * strides)), 0.0]), seed, scatter, steps=60)
    assert not any(told)


@pytest.mark.parametrize("lasts", [1, 2])
def test_a_stumble_is_not_told_of_and_a_pull_after_it_is(lasts):
    def stumble(i):
        return np.array([0.04, 0.02]) * (BEGINS <= i < BEGINS + lasts)

    assert not any(walk(stumble)[1])
    assert any(walk(lambda i: stumble(i) + pulled(i - 14), steps=36)[1])


@pytest.mark.parametrize("growth", [1.3, 2.0])
def test_a_gait_that_loses_its_balance_by_itself_is_not_told_of(growth):
    """What it is off by grows so from stride to stride; a robot that rocks on the edges of its soles was never calm."""
    _, told = walk(lambda i: np.array([0.001 * growth ** (0.5 * (i - 8.0)), 0.0]) * (i > 8), steps=18)
    assert not any(told)
    assert not any(walk(pulled, edge=lambda i: 0.6)[1])


@pytest.mark.parametrize("other", [[[0.05], [0.05], [0.0]], WALKED * [[0.0], [0.0], [0.06]]])
def test_another_way_to_go_is_not_told_of_and_learnt(other):
    """The trunk leans on command, or the gait is quicker: the pressure moves. By a tenth of that it would not."""
    assert any(walk(pulled, walked=lambda i: WALKED + 0.1 * np.array(other) * (i >= BEGINS))[1])
    upset, told = walk(pulled, walked=lambda i: WALKED + np.array(other) * (i >= BEGINS))
    assert not any(told)
    _, told = walk(lambda i: pulled(12) + pulled(i), walked=lambda i: WALKED + np.array(other), upset=upset)
    assert any(told[BEGINS:]) and not any(told[:BEGINS])


def test_halves_of_a_step_are_no_steps():
    """The pressure rolls from heel to toe; for three strides the foot in the air touches the ground in between."""
    upset = Upset(HEIGHT)
    for i in range(24):
        foot, began = Foot.LEFT if i % 2 else Foot.RIGHT, STEP_S * i
        for part in (-0.015, 0.015) if 12 <= i < 18 else (0.0,):
            upset.take(Step(foot, began + max(0.0, 10.0 * part), PLACE[foot] + [part, 0.0], 0.0, WALKED, STEP_S))
            assert upset.told is None


def test_it_is_told_while_it_lasts_and_again_when_it_comes_again():
    upset, told = walk(lambda i: np.array([0.0, 0.015]) * (12 <= i < 20 or i >= 36), steps=46)
    on = [i for i, each in enumerate(told) if each]
    assert on[0] < 17 and 20 <= max(i for i in on if i < 36) < 27 and min(i for i in on if i >= 36) < 42
    assert upset.told is not None and upset.told.since >= STEP_S * 36


def test_missing_pressure_is_passed_over():
    _, told = walk(lambda i: np.full(2, np.nan) if i == 5 else pulled(i), steps=30)
    assert not any(told[:BEGINS]) and any(told)
