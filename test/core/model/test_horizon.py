# SPDX-License-Identifier: BSD-3-Clause
"""Predictions some tenths of a second ahead: against dense integration, closed forms and a judge of brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from coman_reduced_model.core.base.types import Array
from coman_reduced_model.core.evaluation.baselines import BASELINES, predict_baselines
from coman_reduced_model.core.evaluation.horizons import HELD, PREDICTORS, REPEATED, WITH_REFERENCE, HorizonJudge
from coman_reduced_model.core.model.horizon import drop_impossible, predict_horizons
from coman_reduced_model.core.model.reference import look

JUDGED = [name for name in PREDICTORS if name != "corrected"]
MASS = 17.3
M = MASS * np.eye(3)
K = MASS * np.array([[1400.0, 0.0, 2000.0], [0.0, 2500.0, 0.0], [2000.0, 0.0, 5300.0]])
D = 0.02 * K
HORIZONS = np.array([0.1, 0.25, 0.4])
NO_PLAN = (np.empty((0, 3)), np.empty((0, 3)), 0.0)
GRAVITY = np.array([0.0, 0.0, -9.81 * MASS])
COM, COM_VEL = np.array([0.012, -0.05, 0.41]), np.array([0.08, 0.1, -0.05])
REFERENCE, REFERENCE_VEL = np.array([0.015, -0.052, 0.413]), np.array([0.1, 0.12, 0.01])


def dense(axes, moved, faster, end):
    """COM at `end` by a numerical integration of its own, with moved(t), faster(t) the motion of the reference."""
    axes = np.array(axes)

    def at(t: float, free: Array) -> Array:
        p = REFERENCE + moved(t)
        p[axes] = free
        return p

    def motion(t, z):
        p, v = at(t, z[: len(axes)]), REFERENCE_VEL + faster(t)
        v[axes] = z[len(axes) :]
        pull = K @ (REFERENCE + moved(t) - p) + D @ (REFERENCE_VEL + faster(t) - v) + GRAVITY
        return np.concatenate((z[len(axes) :], pull[axes] / MASS))

    start = np.concatenate((COM[axes], COM_VEL[axes]))
    z = solve_ivp(motion, (0.0, end), start, rtol=1e-10, atol=1e-13, max_step=0.005).y[:, -1]
    return at(end, z[: len(axes)])


def predicted(axes, plan=NO_PLAN, horizons=HORIZONS):
    keep = np.zeros((3, 3))
    keep[:, axes] = 1.0  # as the model does: what is not integrated is not felt
    force = (K * keep) @ REFERENCE + (D * keep) @ REFERENCE_VEL + GRAVITY
    return predict_horizons(
        COM, COM_VEL, horizons, M, K * keep, D * keep, np.array(axes), force, REFERENCE, REFERENCE_VEL, *plan
    )


@pytest.mark.parametrize("axes", [[0, 2], [0, 1, 2]])
def test_without_a_plan_the_reference_goes_on_at_its_velocity(axes):
    found = predicted(axes)
    for h, end in enumerate(HORIZONS):
        wanted = dense(axes, lambda t: REFERENCE_VEL * t, lambda t: np.zeros(3), end)
        np.testing.assert_allclose(found[h], wanted, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("axes", [[0, 2], [0, 1, 2]])
@pytest.mark.parametrize("points", [30, 12])
def test_a_plan_is_followed_and_continued_beyond_its_end(axes, points):
    """12 points of 20 ms end at 0.24 s: the reference then keeps its last velocity."""
    dt = 0.02
    t = dt * np.arange(points + 1)[:, None]
    plan = 0.03 * np.sin(4.0 * t + np.arange(3)) - 0.03 * np.sin(np.arange(3))
    plan_vel = 0.12 * np.cos(4.0 * t + np.arange(3)) - 0.12 * np.cos(np.arange(3))

    def along(values, slope=0.0):
        def f(time):
            inside = [np.interp(time, t[:, 0], values[:, i]) for i in range(3)]
            return np.array(inside) + max(0.0, time - t[-1, 0]) * slope

        return f

    # Steps that end at the points of the plan are exact; a horizon between two of them costs some micrometres.
    for horizons, tolerance in (([0.1, 0.26, 0.4], 1e-8), ([0.1, 0.25, 0.4], 1e-4)):
        found = predicted(axes, (plan, plan_vel, dt), np.array(horizons))
        for h, end in enumerate(horizons):
            wanted = dense(axes, along(plan, REFERENCE_VEL + plan_vel[-1]), along(plan_vel), end)
            np.testing.assert_allclose(found[h], wanted, atol=tolerance)
    assert np.abs(found - predicted(axes)).max() > 1e-3


def test_look_ahead_goes_through_the_points_of_the_plan():
    plan, plan_vel = np.array([[0.0, 0, 0], [1, 2, 3], [3, 3, 3]]), np.array([[0.0, 0, 0], [10, 0, 0], [20, 0, 0]])
    velocity = np.array([1.0, 0.0, 0.0])
    position, speed = np.empty((2, 3))
    for t, moved, faster in ((0.0, [0, 0, 0], 0), (0.05, [0.5, 1, 1.5], 5), (0.1, [1, 2, 3], 10), (0.2, [3, 3, 3], 20)):
        look(plan, plan_vel, 0.1, velocity, t, position, speed)
        np.testing.assert_allclose(position, moved, atol=1e-12)
        np.testing.assert_allclose(speed, [faster, 0, 0], atol=1e-12)
    look(plan, plan_vel, 0.1, velocity, 0.3, position, speed)
    np.testing.assert_allclose(position, [3 + 0.1 * 21, 3, 3])
    look(*NO_PLAN, velocity, 0.3, position, speed)
    np.testing.assert_allclose(position, [0.3, 0, 0])


def closed_form_lipm(zmp, h):
    omega = np.sqrt(9.81 / COM[2])
    return zmp + (COM - zmp) * np.cosh(omega * h) + COM_VEL / omega * np.sinh(omega * h)


def test_baselines():
    zmp = np.array([0.01, -0.03, 0.0])
    planned, deflected, persistence, still, lipm = baselines(zmp)
    for i, h in enumerate(HORIZONS):
        np.testing.assert_allclose(persistence[i], COM + COM_VEL * h)
        np.testing.assert_allclose(lipm[i, :2], closed_form_lipm(zmp, h)[:2])
        assert lipm[i, 2] == COM[2]
        np.testing.assert_allclose(planned[i], REFERENCE + REFERENCE_VEL * h)
        np.testing.assert_allclose(deflected[i], COM + REFERENCE_VEL * h)
        np.testing.assert_array_equal(still[i], COM)
    assert np.isnan(baselines(np.full(3, np.nan))[4]).all()


def test_baselines_know_an_announced_motion():
    plan = np.array([[0.0, 0.0, 0.0], [0.01, 0.02, 0.03], [0.02, 0.04, 0.06]])
    planned, deflected, *_ = baselines(np.zeros(3), plan, np.zeros((3, 3)), 0.2)
    np.testing.assert_allclose(planned[2], REFERENCE + plan[2], atol=1e-12)
    np.testing.assert_allclose(deflected[0], COM + 0.5 * plan[1], atol=1e-12)


def baselines(zmp, *plan):
    out = np.empty((len(BASELINES), len(HORIZONS), 3))
    predict_baselines(out, COM, COM_VEL, zmp, 9.81, HORIZONS, REFERENCE, REFERENCE_VEL, plan or NO_PLAN)
    return out


def test_without_reference_the_model_is_the_lipm():
    zmp = np.array([0.01, -0.03, 0.0])
    k = -MASS * 9.81 / COM[2] * np.eye(3)
    nan = np.full(3, np.nan)
    found = predict_horizons(
        COM, COM_VEL, HORIZONS, M, k, np.zeros((3, 3)), np.array([0, 1]), k @ zmp, nan, nan, *NO_PLAN
    )
    for i, h in enumerate(HORIZONS):
        np.testing.assert_allclose(found[i, :2], closed_form_lipm(zmp, h)[:2], rtol=1e-10)
        assert found[i, 2] == COM[2]


# --- the judge ---


def random_walk(seed, count):
    """Stamps with jitter and a gap, sole poses that change from time to time, COM, reference and predictions."""
    rng = np.random.default_rng(seed)
    stamps = 10**9 + np.cumsum(rng.integers(2_000_000, 12_000_000, count))
    T, pose = [], np.eye(4)
    for _ in range(count):
        if rng.random() < 0.1:
            yaw = rng.uniform(-1.0, 1.0)
            pose = np.eye(4)
            pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
            pose[:3, 3] = [*rng.normal(size=2), 0.0]
        T.append(pose)
    measured, reference = rng.normal(size=(2, count, 3))
    predictions = rng.normal(size=(count, 6, 3, 3))  # sample, predictor, horizon, axis
    for hole, values in ((0.05, predictions[:, 0]), (0.05, predictions[:, 3])):
        values[rng.random(count) < hole] = np.nan
    reference[rng.random(count) < 0.05] = np.nan
    return stamps, np.array(T), measured, reference, predictions


def brute_force(stamps, T, measured, reference, predictions, horizons, rigid, restarts):
    """RMSE and counts by looking each prediction up in the whole record."""

    def world(i, p):
        return T[i, :3, :3] @ p + T[i, :3, 3]

    squares = {h: [] for h in horizons}
    for i in range(len(stamps)):
        for k, h in enumerate(horizons):
            target = stamps[i] + round(h * 1e9)
            j = int(np.searchsorted(stamps, target))  # first sample at or after the target
            if j == len(stamps) or j == i or any(i < r <= j for r in restarts):
                continue
            w = (target - stamps[j - 1]) / (stamps[j] - stamps[j - 1])
            truth, rigid_com = (
                (1 - w) * world(j - 1, values[j - 1]) + w * world(j, values[j]) for values in (measured, reference)
            )
            causal = [world(i, predictions[i, n, k]) for n in range(6)]
            errors = np.array([causal[0], *causal, rigid_com]) - truth  # the model is published as it is
            errors = errors @ T[i, :3, :3]  # axes of the sole that predicted
            needed = errors if rigid else errors[[n for n, name in enumerate(JUDGED) if name not in WITH_REFERENCE]]
            if not np.isnan(needed).any():
                squares[h].append(errors**2)
    return squares


@given(st.integers(0, 2**32 - 1), st.booleans(), st.lists(st.integers(1, 79), max_size=2))
@settings(deadline=None, max_examples=40)
def test_judge_agrees_with_brute_force(seed, rigid, restarts):
    """Across changes of support, lost predictions and restarts: all predictors on the same samples."""
    stamps, T, measured, reference, predictions = record = random_walk(seed, 80)
    horizons = (0.013, 0.05, 0.1)
    if not rigid:
        reference[:] = np.nan
    judge = HorizonJudge(horizons, rigid, blended=False)
    for i, stamp in enumerate(stamps):
        if i in restarts:
            judge.restart()
        judge.update(int(stamp), T[i], measured[i], reference[i], predictions[i])
    squares = brute_force(*record, horizons, rigid, restarts)
    for h in horizons:
        found = np.array(squares[h])
        assert judge.judged[f"{h:g}"].tolist() == [len(found)] * 3
        if not len(found):
            continue
        rmse = np.sqrt(found.mean(axis=0))
        for n, name in enumerate(JUDGED):
            np.testing.assert_allclose(judge.rmse()[f"{h:g}"][name], rmse[n], rtol=1e-9)
        best = np.nanmin(rmse[2:-1], axis=0)
        np.testing.assert_allclose(judge.skill()[f"{h:g}"], 1.0 - rmse[0] / best, rtol=1e-9)


def repeated_errors(kind: int, lag_error: float = 0.0, seconds: float = 9.0, begins: int = 1) -> np.ndarray:
    """Errors (n,) in x of what is published 0.1 s ahead, while the model errs in each stride of 1.4 s as in the last.

    Simpler predictions are off by more; one sample in 5 ms. The judge is given the stride `lag_error` [s] too long. The
    recording is played `begins` times, each with other errors; what is returned is of the last time.
    """
    judge, stride = HorizonJudge((0.1,)), 1.4
    rng = np.random.default_rng(5)
    for begin in range(begins):
        errors = []
        for i in range(round(seconds / 0.005)):
            t = 0.005 * i + 0.6 * begin
            ahead = np.full((6, 1, 3), np.nan)
            off = (
                3e-3 * np.sin(2.0 * np.pi * t / stride) + 1e-3 * np.cos(6.0 * np.pi * t / stride) + 1e-5 * rng.normal()
            )
            ahead[0], ahead[2], ahead[4] = off, 4e-3 * rng.normal(), 4e-3 * rng.normal()
            lag = round(1e9 * (stride + lag_error))
            made = judge.update(10**9 + 5_000_000 * i, np.eye(4), np.zeros(3), np.full(3, np.nan), ahead, kind, lag)
            errors.append(made[0, 0, 0])
            assert made[0, 4, 0] <= 1.0 + 1e-12
        judge.restart()
    return np.array(errors)


def test_what_the_model_misses_in_each_stride_is_taken_off():
    off = repeated_errors(REPEATED)
    first, later = slice(40, 300), slice(1200, None)
    assert np.std(off[later]) < 0.1 * np.std(off[first])
    assert np.std(repeated_errors(HELD)[later]) > 0.7 * np.std(off[first])  # it repeats nothing
    assert np.std(repeated_errors(REPEATED, begins=2)[later]) < 0.1 * np.std(off[first])  # as a bag that plays again


def test_a_stride_that_is_found_wrong_does_no_harm():
    """A correction at the wrong time is as wrong as it is right: the blend hardly takes it."""
    wrong, none = (np.std(repeated_errors(*each)[1200:]) for each in ((REPEATED, 0.35), (HELD,)))
    assert wrong < 1.05 * none


def test_nothing_judged_is_nan_not_zero():
    judge = HorizonJudge((0.1,))
    assert np.isnan(judge.skill()["0.1"]).all()
    assert np.isnan(judge.rmse()["0.1"]["model"]).all()
    assert judge.judged["0.1"].tolist() == [0, 0, 0]


def test_what_is_not_published_is_not_judged_as_published():
    """While motor states are missing, nobody gets a prediction; the simpler ones go on to be judged."""
    judge, ahead = HorizonJudge((0.1,)), np.zeros((6, 1, 3))
    ahead[0] = np.nan
    for i in range(400):
        made = judge.update(10**9 + i * 5_000_000, np.eye(4), np.zeros(3), np.zeros(3), ahead, ready=False)
    assert np.isnan(made[0, 0]).all() and np.isnan(judge.within()["0.1"]).all() and np.isnan(judge.covariance(0)).all()
    assert np.isnan(judge.simpler_share()["0.1"]).all()


def test_what_was_predicted_of_a_time_in_the_air_is_not_judged():
    judge, ahead = HorizonJudge((0.1,), blended=False), np.zeros((6, 1, 3))
    for i in range(200):
        judge.update(10**9 + i * 5_000_000, np.eye(4), np.zeros(3), np.zeros(3), ahead)
    before = judge.judged["0.1"].tolist()
    landed = 10**9 + 199 * 5_000_000 + 1_000_000_000
    judge.update(landed, np.eye(4), np.array([0.3, 0.0, 0.0]), np.zeros(3), ahead)
    assert judge.judged["0.1"].tolist() == before and judge.rmse()["0.1"]["model"].tolist() == [0.0] * 3
    for i in range(40):
        judge.update(landed + (i + 1) * 5_000_000, np.eye(4), np.zeros(3), np.zeros(3), ahead)
    assert judge.judged["0.1"][0] > before[0]


def test_more_samples_than_can_wait_are_dropped_not_mixed_up():
    """At 10 kHz and two seconds ahead the buffer is full: what is judged is still right."""
    judge = HorizonJudge((2.0,), blended=False)
    ahead = np.zeros((6, 1, 3))
    for i in range(30000):
        t = i * 1e-4
        now = np.array([t, 0.0, 0.0])
        ahead[0] = now + [2.0, 0.0, 0.5]
        judge.update(10**9 + i * 100_000, np.eye(4), now, now, ahead)
    np.testing.assert_allclose(judge.rmse()["2"]["model"], [0.0, 0.0, 0.5], atol=1e-6)
    assert judge.judged["2"][0] > 4000


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e200, 4.0])
def test_predictions_that_no_robot_gets_to_are_nan(value):
    """1 m/s for 0.4 s and a fall of 0.8 m, with half a metre to spare, are possible; 4 m are not."""
    ahead = np.array([[[0.1, 0.0, 0.4], [0.2, value, 0.4], [1.6, 0.0, 0.4]]])
    kept = ahead.copy()
    assert drop_impossible(ahead, np.array([0.0, 0.0, 0.4]), np.array([1.0, 0.0, 0.0]), HORIZONS, 9.81, 0.5)
    assert np.isnan(ahead[0, 1]).all()
    np.testing.assert_array_equal(ahead[0, [0, 2]], kept[0, [0, 2]])
    assert not drop_impossible(kept[:, :1], COM, COM_VEL, HORIZONS[:1], 9.81, 0.5)
