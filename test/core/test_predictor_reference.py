# SPDX-License-Identifier: BSD-3-Clause
"""Where the predictor takes the reference from: motors, a plan, or none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from predictor_tools import CONFIG, ROBOT, T0, WEIGHT, column, motor, run, sample
from robots import bent

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Flags, Foot, Phase, Reference, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.resources import bag_path

# --- sources of the reference ---


def test_motor_reference_is_the_kinematics_of_the_motor_side():
    posture = ROBOT.posture()
    for i, p in enumerate(run(end=1.0)):
        posture.update(*motor(i / 200.0))
        com, com_vel = posture.com_in_sole(p.support.support_foot)
        np.testing.assert_allclose(p.reference_com, com, atol=1e-12)
        np.testing.assert_allclose(p.reference_com_vel, com_vel, atol=1e-12)


def plan(t: float, preview=0, turn=0.3) -> Reference:
    """A planned COM that moves in odom, both planned soles turned and shifted against odom."""
    c, s = np.cos(turn), np.sin(turn)
    left = np.array([[c, -s, 0, 1.0], [s, c, 0, 2.0], [0, 0, 1, 0], [0, 0, 0, 1]])
    right = left.copy()
    right[:3, 3] += left[:3, :3] @ [0.0, -0.15, 0.0]

    def com(at):
        return left[:3, 3] + left[:3, :3] @ [0.02 * np.sin(4 * at), -0.07, 0.4]

    def com_vel(at):
        return left[:3, :3] @ [0.08 * np.cos(4 * at), 0.0, 0.0]

    ahead = t + 0.02 * np.arange(1, preview + 1)
    return Reference(
        T0 + round(t * 1e9), com(t), com_vel(t), np.zeros(3), np.zeros(3), left, right, Phase.DOUBLE, 0,
        0.02 if preview else 0.0,
        np.array([com(at) for at in ahead]).reshape(-1, 3), np.array([com_vel(at) for at in ahead]).reshape(-1, 3),
    )  # fmt: skip


TOPIC = CONFIG.replaced({"prediction.reference": "topic"})


def test_planned_reference_is_told_in_the_planned_sole():
    """Where odom thinks the robot is does not matter."""
    for p in run(TOPIC, end=1.5, make=lambda t: sample(t, reference=plan(t), motor_q=None)):
        t = (p.stamp_ns - T0) * 1e-9
        y = -0.07 if p.support.support_foot == Foot.LEFT else 0.08
        np.testing.assert_allclose(p.reference_com, [0.02 * np.sin(4 * t), y, 0.4], atol=1e-9)
        np.testing.assert_allclose(p.reference_com_vel, [0.08 * np.cos(4 * t), 0, 0], atol=1e-9)
    missing = Predictor(ROBOT, TOPIC).update(sample(0.0))
    assert Flags.NO_REFERENCE in missing.flags and np.isnan(missing.reference_com).all()


def test_preview_is_used():
    """What follows the reference without being felt shows the plan itself: y, and x within the springs."""
    for preview in (0, 30):
        (p,) = [Predictor(ROBOT, TOPIC).update(sample(0.4, reference=plan(0.4, preview)))]
        for horizon in p.horizons:
            ahead = 0.4 + horizon.h
            known = 0.02 * np.sin(4 * ahead)
            guess = 0.02 * np.sin(1.6) + 0.08 * np.cos(1.6) * horizon.h
            a, b = abs(horizon.com[0] - known), abs(horizon.com[0] - guess)
            if horizon.h > 0.3:
                assert (a < b) == (preview > 0)
            assert horizon.com[1] == pytest.approx(-0.07)


def test_horizons_are_those_of_the_configuration_in_ascending_order():
    config = CONFIG.replaced({"prediction.horizons": [0.4, 0.05]})
    assert [h.h for h in run(config, end=0.1)[-1].horizons] == [0.05, 0.4]
    assert run(CONFIG.replaced({"prediction.horizons": []}), end=0.1)[-1].horizons == []


def test_without_reference_the_free_run_is_the_pendulum_on_the_measured_zmp():
    """Constant ZMP and height: cosh and sinh, to the last digits; the height stays."""
    config = CONFIG.replaced({"prediction.reference": "none"})
    still = bent(ROBOT, 0.6)
    zmp = np.array([0.01, -0.02])
    wrench = np.array([0.0, 0.0, WEIGHT, zmp[1] * WEIGHT, -zmp[0] * WEIGHT, 0.0])
    make = lambda t: Sample(T0 + round(t * 1e9), still, np.zeros(12), None, None, None, wrench, np.zeros(6))  # noqa: E731
    predictions = run(config, end=0.3, make=make)
    start = predictions[0].measured_com
    omega = np.sqrt(9.81 / start[2])
    for i, p in enumerate(predictions):
        wanted = zmp + (start[:2] - zmp) * np.cosh(omega * i / 200.0)
        np.testing.assert_allclose(p.predicted_com, [*wanted, start[2]], atol=1e-10)
        assert np.isnan(p.reference_com).all() and Flags.NO_REFERENCE not in p.flags
    lost = Predictor(ROBOT, config)
    lost.update(make(0.0))
    p = lost.update(replace(make(0.005), left_wrench=None))
    assert p.flags == Flags.STALE_WRENCH | Flags.NO_REFERENCE | Flags.NOT_INITIALISED
    assert np.isnan(p.predicted_com).all()


def test_the_rate_does_not_matter_for_the_pendulum_either():
    """The ZMP goes linearly from sample to sample."""
    config = CONFIG.replaced({"prediction.reference": "none", "prediction.horizons": []})
    still = bent(ROBOT, 0.6)

    def make(t):
        wrench = WEIGHT * np.array([0.0, 0.0, 1.0, 0.02 * np.sin(9 * t), -0.03 * np.sin(7 * t), 0.0])
        return Sample(T0 + round(t * 1e9), still, np.zeros(12), None, None, None, wrench, np.zeros(6))

    fine = column(run(config, end=0.4, rate=1000.0, make=make)[::10], "predicted_com")
    coarse = column(run(config, end=0.4, rate=100.0, make=make), "predicted_com")
    moved = np.abs(fine - fine[0]).max(axis=0)[:2]
    assert (np.abs(coarse - fine).max(axis=0)[:2] < 0.02 * moved).all()


def test_predictions_own_their_arrays():
    """A prediction that is kept does not change when the next sample comes."""
    predictor = Predictor(ROBOT, CONFIG)
    kept = [predictor.update(sample(i / 200.0)) for i in range(10)]
    copies = [(p.measured_com.copy(), p.predicted_com.copy(), p.reference_com.copy()) for p in kept]
    for i in range(10, 30):
        predictor.update(sample(i / 200.0))
    for p, (measured, predicted, reference) in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(p.measured_com, measured)
        np.testing.assert_array_equal(p.predicted_com, predicted)
        np.testing.assert_array_equal(p.reference_com, reference)


def test_predictions_ahead_start_from_the_estimate():
    """A COM that keeps its velocity: that of the estimate is nearer to what comes than that of the encoders."""
    h, ahead, errors = 0.1, 20, []
    with Session(bag_path("test1"), Config().replaced({"prediction.horizons": [h]})) as session:
        made = list(session.predictions())
    for now, then in zip(made, made[ahead:], strict=False):
        if now.frame_id == then.frame_id and abs(then.stamp_ns - now.stamp_ns - h * 1e9) < 1e6:
            errors.append(now.measured_com + h * now.measured_com_vel - then.measured_com)
    from_encoders = np.sqrt(np.nanmean(np.square(errors), axis=0))
    from_the_estimate = session.pipeline.judge.rmse()["0.1"]["persistence"]
    assert (from_the_estimate < 0.9 * from_encoders).all()
