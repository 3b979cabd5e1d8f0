# SPDX-License-Identifier: BSD-3-Clause
"""What effects do to the predicted COM: its paired statistics, other stamps and masses, and which effects stay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import bent, robot_of
from synthetic import walk, write_bag

from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.base import EffectConfig
from coman_reduced_model.diagnose.inference import predicted_com
from coman_reduced_model.diagnose.inference.predicted_com import Errors, FreeRun, admitted, change, errors, interval
from coman_reduced_model.resources import bag_path

STEP, N = 40, 400  # samples of a step, of a run; 5 ms apart
VALUES = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=12)
PLAIN = Config().replaced({"effects.active": ["none"]})
OFFSET = EffectConfig("com_offset", "", {"x": 0.01, "y": 0.0, "z": 0.0})


def path(stamps: np.ndarray) -> np.ndarray:
    """(n, 3) A COM that moves evenly, so that interpolation is exact."""
    return np.outer(1e-9 * stamps, [0.3, -0.2, 0.1])


def free_run(error=0.0, late_ns: int = 0, bias=0.0, loads=()) -> FreeRun:
    """Ten steps of a model.

    Args:
        error: of its prediction: a number or (n, 3) [m]; bias: of its measurement [m].
        late_ns: of its stamps: what is measured is past.
    """
    stamps = 5_000_000 * np.arange(1, N + 1) + late_ns
    step = np.arange(N) // STEP
    foot = np.where(step % 2, Foot.LEFT, Foot.RIGHT)
    phase = np.where(np.arange(N) % STEP < 10, Phase.DOUBLE, foot)
    robot = robot_of("coman")
    q = np.tile(bent(robot), (N, 1))
    return FreeRun(stamps, foot, phase, step, path(stamps - late_ns) + bias, path(stamps) - error, q, robot, loads)


# --- the paired interval ---


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_the_interval_of_two_values_is_that_of_cauchy(a, b):
    """With one degree of freedom the t-distribution is Cauchy's, whose quantiles are a formula."""
    (low,), (high,) = interval(np.array([[a], [b]]))
    half = np.tan(np.pi * 0.475) * abs(a - b) / 2.0
    assert (low, high) == pytest.approx(((a + b) / 2.0 - half, (a + b) / 2.0 + half), abs=1e-6)


def test_the_interval_contains_the_mean_in_95_of_100_cases():
    draws = 1.3 + 0.7 * np.random.default_rng(4).standard_normal((9, 4000))
    low, high = interval(draws)
    # Four standard deviations of the share of 4000 cases.
    assert np.mean((low < 1.3) & (high > 1.3)) == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 4000))


@given(VALUES, st.floats(-1e3, 1e3), st.floats(0.1, 10.0))
def test_the_interval_moves_and_grows_with_the_values(values, shift, scale):
    x = np.array(values)[:, None]
    (low,), (high,) = interval(x)
    (other_low,), (other_high,) = interval(shift + scale * x)
    assert (other_low, other_high) == pytest.approx((shift + scale * low, shift + scale * high), abs=1e-6)


@pytest.mark.parametrize("count", [0, 1])
def test_of_less_than_two_steps_nothing_is_known(count):
    low, high = interval(np.ones((count, 3)))
    assert np.all(low == -np.inf) and np.all(high == np.inf)


@given(VALUES, st.integers(1, 30))
def test_samples_of_one_step_count_once(values, times):
    """Neighbouring samples have the same error: more of them say no more."""

    def told(each: int):
        after = np.repeat(np.abs(values), each)[:, None] * np.ones(3)
        step = np.repeat(np.arange(len(values)), each)
        return change([Errors(np.arange(len(step)) * 0.005, step, np.ones_like(after), after)])

    once, often = told(1), told(times)
    assert once.steps == often.steps == len(values)
    np.testing.assert_allclose([often.low, often.high], [once.low, once.high], rtol=1e-6, atol=1e-6)


def test_steps_of_several_bags_count_alike():
    one = errors(free_run(0.001), free_run(0.002))
    both = change([one, one])
    assert both.steps == 2 * change([one]).steps == 2 * len(np.unique(one.step)) == 20
    assert both.before == pytest.approx(np.full(3, 0.001)) and both.after == pytest.approx(np.full(3, 0.002))
    assert both.low == pytest.approx(np.full(3, 3e-6))


# --- one measurement for both models ---


def test_errors_are_those_of_the_predictions():
    found = errors(free_run(0.003), free_run(0.001))
    assert len(found.times) == N and found.times[-1] == pytest.approx(0.005 * (N - 1))
    np.testing.assert_allclose(found.before, 0.003)
    np.testing.assert_allclose(found.after, 0.001)


def test_both_models_are_judged_by_what_the_model_after_measures():
    found = errors(free_run(0.003, bias=0.5), free_run(0.001))
    np.testing.assert_allclose(found.before, 0.003)


@pytest.mark.parametrize("late_ns", [1_000_000, 12_345_678, -7_500_001, 30_000_000])
def test_of_late_joint_states_no_rows_vanish(late_ns):
    """The stamps before are late by no multiple of their distance, so that hardly any agrees with one after."""
    found = errors(free_run(0.003, late_ns), free_run(0.001))
    # Lost are the ends, and at each change of the foot what is between the two models.
    assert len(found.times) > N - 11 * (abs(late_ns) // 5_000_000 + 2)
    np.testing.assert_allclose(found.before, 0.003, atol=1e-12)
    np.testing.assert_allclose(found.after, 0.001, atol=1e-12)


def test_nothing_is_interpolated_across_a_reset_or_in_the_frame_of_another_foot():
    before, after = free_run(late_ns=2_000_000), free_run()
    before.predicted[before.run % 2 == 1] += 5.0  # in the other foot's frame
    before.predicted[before.run % 4 >= 2] += 0.25  # from another reset
    found = errors(before, after)
    assert set(np.unique(np.round(-found.before, 9))) == {0.0, 0.25, 5.0, 5.25}


def test_what_one_of_them_does_not_know_is_not_compared():
    before, after = free_run(0.003), free_run(0.001)
    before.predicted[:50], after.predicted[60:70], after.measured[80] = np.nan, np.nan, np.nan
    assert len(errors(before, after).times) == N - 61
    before.predicted[:] = np.nan
    nothing = change([errors(before, after)])
    assert nothing.steps == 0 and np.isnan(nothing.before).all() and not nothing.worse


def test_of_other_masses_each_model_predicts_its_own_com():
    """A shifted COM is another point of the same robot: to name it differently makes no model better."""
    robot = robot_of("coman")
    posture = robot.posture()
    posture.update(bent(robot), np.zeros(len(robot.joint_names)))
    plain, shifted = free_run(), free_run(loads=(OFFSET,))
    for run, offset in ((plain, 0.0), (shifted, [0.005, 0.0, 0.0])):
        for foot in (Foot.LEFT, Foot.RIGHT):
            mine = run.foot == foot
            run.measured[mine] = posture.com_in_sole(foot)[0] + offset
            run.predicted[mine] = run.measured[mine] - 0.001
    found = errors(plain, shifted)
    np.testing.assert_allclose(found.before, 0.001, atol=1e-12)
    np.testing.assert_allclose(found.after, 0.001, atol=1e-12)


# --- which effects stay ---


def judged(sizes: dict[tuple[int, ...], float], count: int):
    """`admitted` where the models' errors along y are as given [mm], with the same chance in each step."""
    asked = []
    chance = 1.0 + 0.1 * np.random.default_rng(7).standard_normal(N // STEP).repeat(STEP)

    def runs(which: tuple[int, ...]) -> list[FreeRun]:
        asked.append(which)
        return [free_run(1e-3 * np.outer(chance, [1.0, sizes[which], 1.0]))]

    kept, changes = admitted(count, runs)
    assert len(asked) == len(set(asked)), "a model was run twice"
    return kept, changes


def test_an_effect_that_makes_one_axis_worse_is_left_out():
    kept, changes = judged({(): 0.30, (0,): 0.48}, 1)
    assert kept == () and changes[0].worse
    assert changes[0].low[0] <= 0.0 < changes[0].low[1] and changes[0].low[2] <= 0.0
    assert str(changes[0]).startswith("y 0.295 to 0.471") and "x" not in str(changes[0])
    assert judged({(): 0.30, (0,): 0.12}, 1)[0] == (0,)
    assert judged({(): 0.30, (0,): 0.30}, 1)[0] == (0,)


def test_worse_by_chance_is_not_worse():
    step = np.arange(N) // STEP
    better = np.where(step % 3 == 0, 0.8, 1.1)[:, None] * np.ones(3)  # worse in two of three steps
    found = change([errors(free_run(1e-3), free_run(1e-3 * better))])
    assert (found.after > 0.0).all() and not found.worse and (found.high > 0.0).all()


def test_each_effect_is_judged_beside_the_others():
    # The second alone does nothing, beside the first it helps; the third makes everything worse.
    sizes = {
        (): 1.0, (0,): 0.6, (1,): 1.0, (2,): 1.5, (0, 1): 0.3, (0, 2): 1.2, (1, 2): 1.6, (0, 1, 2): 0.9,
    }  # fmt: skip
    kept, changes = judged(sizes, 3)
    assert kept == (0, 1) and changes[2].worse and not changes[0].worse and not changes[1].worse
    assert changes[1].before[1] / changes[1].after[1] == pytest.approx(2.0)
    assert changes[2].after[1] / changes[2].before[1] == pytest.approx(3.0)


def test_effects_that_only_together_are_worse_than_none_do_not_all_stay():
    kept, _ = judged({(): 0.5, (0,): 0.9, (1,): 0.8, (0, 1): 0.7}, 2)
    assert kept == ()


def test_without_effects_nothing_is_predicted():
    assert admitted(0, lambda which: pytest.fail("a model was run")) == ((), {})


def test_positions_are_those_that_effects_have_corrected():
    """The masses of another model are placed by the joints as this model believes they are."""
    biased = PLAIN.replaced(
        {
            "effects.active": ["encoder_bias"],
            "effects.encoder_bias.where": ["LKneeSag"],
            "effects.encoder_bias.bias": [0.02],
        }
    )
    before, after = (predicted_com.free_run(bag_path("test1"), config) for config in (PLAIN, biased))
    bias = np.zeros(before.q.shape[1])
    bias[before.robot.joint_names.index("LKneeSag")] = 0.02
    np.testing.assert_allclose(before.q - after.q, np.tile(bias, (len(before.q), 1)), atol=1e-12)


def test_of_a_bag_that_starts_again_the_run_that_is_diagnosed_is_predicted(tmp_path):
    """The longest one: the first is no part of it, though time is later in neither."""
    alone = predicted_com.free_run(write_bag(tmp_path / "alone", walk(4.0)), PLAIN)
    both = predicted_com.free_run(write_bag(tmp_path / "both", [*walk(3.0), *walk(4.0)]), PLAIN)
    assert both.stamps[0] == alone.stamps[0] and abs(len(both.stamps) - len(alone.stamps)) < 5
