# SPDX-License-Identifier: BSD-3-Clause
"""How sure predictions ahead are, from the first estimate on: by the estimate, then by their errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from predictor_tools import CONFIG, run, sample

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Prediction, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.horizons import HELD, REPEATED, HorizonJudge
from coman_reduced_model.resources import bag_path

HORIZONS = (0.1, 0.2, 0.4)
EVERY = 0.005  # [s]
SIZES = np.array([1e-3, 2e-3, 4e-3])  # [m] of errors


def spread_of(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A covariance of COM and velocity, and what is constant in it."""
    rng = np.random.default_rng(seed)
    root, constant = rng.normal(size=(6, 8)) * 1e-3, rng.normal(size=(3, 3)) * 1e-2
    P, constants = root @ root.T, constant @ constant.T
    P[:3, :3] += constants
    return P, constants


def judged(seconds: float, spread: tuple[np.ndarray, np.ndarray] | None, sizes: np.ndarray = SIZES) -> np.ndarray:
    """Published covariances (samples, n, 3, 3) of a COM that stays, by predictors that are off by as much."""
    judge, rng, made = HorizonJudge(HORIZONS), np.random.default_rng(2), []
    for i in range(round(seconds / EVERY)):
        ahead = np.full((6, len(HORIZONS), 3), np.nan)
        ahead[0] = sizes * rng.normal(size=3)
        ahead[2], ahead[4] = 1.0, 1.0
        options = {} if spread is None else {"spread": spread}
        out = judge.update(10**9 + round(1e9 * EVERY) * i, np.eye(4), np.zeros(3), np.zeros(3), ahead, **options)
        made.append(out[:, 1:4])
    return np.array(made)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=20)
def test_before_any_error_it_is_that_of_the_estimate_at_constant_velocity(seed):
    P, constants = spread_of(seed)
    found = judged(EVERY, (P, constants))[0]
    for h, each in zip(HORIZONS, found, strict=True):
        F = np.hstack((np.eye(3), h * np.eye(3)))
        np.testing.assert_allclose(each, F @ P @ F.T - constants, rtol=1e-9, atol=1e-12)
        assert np.linalg.eigvalsh(each).min() > 0.0


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_it_goes_over_to_that_of_the_errors(factor):
    """Whether the estimate was too sure or not sure enough."""
    P = np.diag(np.concatenate(((factor * SIZES) ** 2, np.zeros(3))))
    found = np.sqrt(np.diagonal(judged(25.0, (P, np.zeros((3, 3)))), axis1=2, axis2=3))
    np.testing.assert_allclose(found[0], np.tile(factor * SIZES, (3, 1)), rtol=1e-6)
    off = np.abs(np.log(found / SIZES)).max(axis=(1, 2))
    assert off[0] > off[round(1.0 / EVERY)] > off[-1]
    np.testing.assert_allclose(found[-1], np.tile(SIZES, (3, 1)), rtol=0.2)


def test_once_the_memory_is_full_the_estimate_counts_for_nothing():
    """A landing makes the estimate less sure, not the prediction."""
    unsure = 0.05**2 * np.eye(6), np.zeros((3, 3))
    with_it, without = (np.sqrt(np.trace(judged(60.0, each)[-1, 0])) for each in (unsure, None))
    assert without <= with_it < 1.05 * without


@pytest.mark.slow
@pytest.mark.parametrize(("first", "then"), [((HELD, 0.0002), (REPEATED, 0.004)), ((REPEATED, 0.004), (HELD, 0.0002))])
def test_it_follows_a_robot_that_sets_off_or_stops(first, then):
    """Each kind of prediction has errors of its own; what is published has those of the last seconds."""
    judge, rng, stamp = HorizonJudge((0.1,)), np.random.default_rng(0), 10**9
    for seconds, (kind, size) in ((20.0, first), (60.0, then)):
        for _ in range(round(seconds / 0.02)):
            stamp += 20_000_000
            ahead = np.broadcast_to(rng.normal(0.0, size, 3), (6, 1, 3))
            out = judge.update(stamp, np.eye(4), np.zeros(3), np.zeros(3), np.array(ahead, order="C"), kind)
    assert np.sqrt(np.diag(out[0, 1:4])) == pytest.approx(then[1], rel=0.35)


def test_without_an_estimate_it_is_not_known_before_there_are_errors():
    found = judged(2.0, None)
    known = np.isfinite(found).all(axis=(2, 3))
    for h, each in zip(HORIZONS, known.T, strict=True):
        first = EVERY * int(each.argmax())
        assert h < first < h + 0.3 and each[each.argmax() :].all()


def beginning(name: str, seconds: float, **changes: object) -> tuple[list[Prediction], HorizonJudge]:
    settings = Config().replaced({key.replace("__", "."): value for key, value in changes.items()})
    with Session(bag_path(name), settings) as session:
        made: list[Prediction] = []
        for prediction in session.predictions():
            if prediction.horizons:
                made.append(prediction)
            if made and prediction.stamp_ns - made[0].stamp_ns > 1e9 * seconds:
                return made, session.pipeline.judge
    raise AssertionError("too short")


@pytest.mark.parametrize("name", ["test1", "stand"])
def test_it_is_known_as_soon_as_there_is_an_estimate(name):
    found, judge = beginning(name, 2.5)
    sigma = np.sqrt([[np.diag(h.covariance) for h in each.horizons] for each in found])
    estimated = np.array([np.isfinite(each.estimate.com[0]) for each in found])
    assert estimated[:5].any() and np.isfinite(sigma[estimated]).all()
    first = sigma[: round(0.1 / 0.005)]  # until the first one is judged
    assert (np.diff(first, axis=1) >= 0.0).all()
    for share in judge.within().values():  # it was half to three quarters, from 0.3 s on
        assert (share > 0.75).all()


def test_without_measured_wrenches_it_is_as_before():
    """There is no estimate then."""
    found, _ = beginning("test1", 0.2, streams__wrench_source="torques")
    assert all(np.isnan(h.covariance).all() for each in found[:15] for h in each.horizons)


def test_a_wrench_that_is_missing_leaves_what_errors_say():
    """There is no estimate for a moment, and it begins again."""

    def make(t: float) -> Sample:
        return sample(t, **({"left_wrench": None} if 0.6 < t < 0.65 else {}))

    found = run(CONFIG.replaced({"prediction.horizons": [0.1]}), end=1.0, make=make)
    assert sum(np.isnan(each.estimate.com[0]) for each in found) > 5
    assert all(np.isfinite(each.horizons[0].covariance).all() for each in found if each.horizons)
