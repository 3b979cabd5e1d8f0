# SPDX-License-Identifier: BSD-3-Clause
"""Between two restarts the free run follows from plan or motors, support phase and switching times alone."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from effect_tools import PAPER, values
from effect_tools import config as with_effect

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Phase, Prediction, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.resources import bag_path

SECONDS = 4.0
TOPIC = PAPER.replaced({"prediction.reference": "topic"})


@cache
def recorded() -> tuple[list[Sample], object]:
    """Samples of a walk with motor states and plan, and the robot."""
    samples: list[Sample] = []
    with Session(bag_path("test1")) as session:
        for sample in session.samples():
            samples.append(sample)
            if sample.stamp_ns - samples[0].stamp_ns > SECONDS * 1e9:
                break
        return samples, session.robot


def predict(config: Config, samples: list[Sample]) -> list[Prediction]:
    """Of the whole walk in one free run."""
    config = config.replaced({"prediction.reset_every_steps": 0, "prediction.horizons": []})
    predictor = Predictor(recorded()[1], config)
    return [predictor.update(sample) for sample in deepcopy(samples)]


def perturbed(samples: list[Sample], predictions: list[Prediction], robot) -> list[Sample]:
    """Other link joints, but at the first sample and at changes of support, and other loads of loaded feet."""
    rng = np.random.default_rng(0)
    samples, weight = deepcopy(samples), robot.mass * 9.81
    supports = [(p.support.phase, p.support.support_foot) for p in predictions]
    for i in range(1, len(samples)):
        sample, nearby = samples[i], supports[max(0, i - 12) : i + 12]
        if supports[i] == supports[i - 1]:
            sample.q += rng.normal(0.003, 0.002, len(sample.q))
            sample.qd += rng.normal(0.0, 0.1, len(sample.qd))
        left, right = sample.left_wrench, sample.right_wrench
        left[[0, 1, 3, 4, 5]] += rng.normal(0.0, 2.0, 5)
        right[[0, 1, 3, 4, 5]] += rng.normal(0.0, 2.0, 5)
        if len(set(nearby)) > 1:
            continue
        if supports[i][0] == Phase.DOUBLE:
            more, less = (left, right) if left[2] > right[2] else (right, left)
            if less[2] > 0.3 * weight and more[2] > 0.55 * weight:
                moved = 0.1 * weight * rng.random()
                more[2] += moved
                less[2] -= moved
        else:
            (left if supports[i][0] == Phase.LEFT else right)[2] *= 1.0 + 0.2 * rng.random()
    return samples


@pytest.mark.slow
@pytest.mark.parametrize(
    "config",
    [
        Config(),
        Config().replaced(
            {f"model.{o}": "without" for o in ("gravity_stiffness", "swing_momentum", "lateral_compliance")}
        ),
        with_effect("ground_compliance", "", Config(), vertical=2e-6, rotational=1e-4),
        with_effect("external_force", "", Config(), x=4.0),
        with_effect("backlash", "LKneeSag", Config(), width=0.01),
        PAPER,
        PAPER.replaced({"model.double_support": "both_legs", "model.gravity_stiffness": "with"}),
        with_effect("joint_friction", "LKneeSag", PAPER, coulomb=1.0),
        TOPIC,
    ],
    ids="default trunk_alone soft_ground pull play paper both_legs paper_friction topic".split(),
)
def test_what_is_measured_between_restarts_changes_nothing(config):
    samples, robot = recorded()
    expected = predict(config, samples)
    found = predict(config, perturbed(samples, expected, robot))
    supports = [[replace(p.support, left_share=0.0, total_force=0.0) for p in side] for side in (expected, found)]
    assert supports[0] == supports[1], "the support phase is an input"
    shares = [np.array([p.support.left_share for p in side]) for side in (expected, found)]
    assert (np.abs(shares[0] - shares[1]) > 0.01).mean() > 0.02
    moved = np.abs(values(found, "measured_com") - values(expected, "measured_com")).max()
    assert moved > 1e-3
    first = 1 if not config.turning else 0
    for name in ("predicted_com", "predicted_com_vel", "reference_com", "predicted_tilt"):
        np.testing.assert_allclose(values(found, name)[first:], values(expected, name)[first:], rtol=0, atol=1e-9)
    assert np.isfinite(values(found, "predicted_com")).all(axis=1).mean() > 0.9
    assert len({p.support.phase for p in found}) == 3


def test_measured_shares_are_measured():
    """The option that says so is exempt."""
    config = PAPER.replaced({"model.shares": "measured"})
    samples, robot = recorded()
    expected = predict(config, samples)
    found = predict(config, perturbed(samples, expected, robot))
    assert np.abs(values(found, "predicted_com") - values(expected, "predicted_com")).max() > 1e-5
