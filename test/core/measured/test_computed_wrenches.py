# SPDX-License-Identifier: BSD-3-Clause
"""Foot wrenches by the equation of motion: closed forms, and recordings whose sensors are not looked at."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from coman_reduced_model import Config, Predictor, Session, bag_path
from coman_reduced_model.core.base.types import ContactMessage, Flags, Foot, ImuMessage, Phase, Prediction, Sample
from coman_reduced_model.core.measured.computed_wrenches import ComputedWrenches
from coman_reduced_model.core.robot.robot import Posture, Robot
from coman_reduced_model.resources import config_path

STILL = np.zeros(12)
BENT = np.array([-0.4, 0.0, 0.0, 0.8, -0.4, 0.0] * 2)
FEET = (Foot.LEFT, Foot.RIGHT)


def by(source: str) -> Config:
    return Config().replaced({"streams.wrench_source": source, "prediction.horizons": [0.2]})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "words"), [(1.0, None), (0.0, "no torques"), (1e-2, "another unit"), (-1.0, "wrong sign")]
)
def test_torques_that_do_not_bear_the_robot_are_said(factor, words):
    """Nothing else would: what is computed of them explains them."""
    with Session(bag_path("test1"), by("torques")) as session:
        samples = islice(session.samples(), 1500)
        for _ in session.pipeline.predict([replace(each, tau=factor * each.tau) for each in samples]):
            pass
        found = [str(each) for each in session.pipeline.status().warnings]
    assert (words in found[0] and len(found) == 1) if words else not found


@cache
def robot() -> Robot:
    return Robot(config_path("coman.urdf").read_text(encoding="utf-8"), Config().robot)


def standing(q: np.ndarray) -> tuple[Posture, np.ndarray, pin.Data]:
    """The posture at rest, soles level, and the generalised forces that its weight needs."""
    posture = robot().posture()
    posture.update(q, STILL)
    model, data = robot().model.copy(), robot().model.createData()
    model.gravity.linear = -9.81 * posture.R[Foot.LEFT][:, 2]
    configuration = pin.neutral(model)
    robot().scatter(q, configuration)
    return posture, pin.rnea(model, data, configuration, np.zeros(model.nv), np.zeros(model.nv)), data


def sole_jacobian(q: np.ndarray, foot: Foot) -> np.ndarray:
    configuration = pin.neutral(robot().model)
    robot().scatter(q, configuration)
    data = robot().model.createData()
    return pin.computeFrameJacobian(
        robot().model, data, configuration, robot().sole_ids[foot], pin.ReferenceFrame.LOCAL
    )


def test_torques_give_back_the_wrenches_that_cause_them():
    """Any split of the weight, with an inner force between the feet that no balance shows."""
    posture, needed, _ = standing(BENT)
    J = {foot: sole_jacobian(BENT, foot) for foot in FEET}
    right = np.array([3.0, -4.0, 60.0, 0.4, -0.6, 0.1])
    left = np.linalg.solve(J[Foot.LEFT][:, :6].T, needed[:6] - J[Foot.RIGHT][:, :6].T @ right)
    tau = (needed - J[Foot.LEFT].T @ left - J[Foot.RIGHT].T @ right)[robot().idx_v]
    computed = ComputedWrenches(robot(), by("torques")).filled(Sample(10**9, BENT, STILL, tau), posture, Foot.LEFT)
    np.testing.assert_allclose(computed.left_wrench, left, atol=0.5)
    np.testing.assert_allclose(computed.right_wrench, right, atol=0.5)


@pytest.mark.parametrize("foot", FEET)
def test_the_one_foot_on_the_ground_bears_the_weight_below_the_com(foot):
    posture, _, _ = standing(BENT)
    contacts = ContactMessage(10**9, foot == Foot.LEFT, foot == Foot.RIGHT)
    computed = ComputedWrenches(robot(), by("contacts")).filled(
        Sample(10**9, BENT, STILL, contacts=contacts), posture, Foot.NONE
    )
    own, other = computed.left_wrench, computed.right_wrench
    if foot == Foot.RIGHT:
        own, other = other, own
    com, _ = posture.com_in_sole(foot)
    assert own[2] == pytest.approx(robot().mass * 9.81, rel=1e-2)
    assert -own[4] / own[2] == pytest.approx(com[0], abs=2e-3)
    assert own[3] / own[2] == pytest.approx(com[1], abs=5e-3)
    assert not other.any()


def on_a_slope(pitch: float, seconds: float, imu: bool, **changes) -> list[Prediction]:
    """Predictions, by its ZMP alone, of a robot without foot sensors that stands on a slope."""
    plain = by("contacts").replaced({"prediction.reference": "none", "prediction.blend": False})
    predictor = Predictor(robot(), plain.replaced(changes))
    leaning, made = Rotation.from_euler("y", pitch).as_quat(), []
    for k in range(round(seconds / 0.02)):
        stamp = 10**9 + 20_000_000 * k
        sample = Sample(stamp, BENT, STILL, contacts=ContactMessage(stamp, True, True))
        sample.imu = ImuMessage(stamp, "imu_link", leaning, np.zeros(3), np.zeros(3)) if imu else None
        made.append(predictor.update(sample))
    return made


@pytest.mark.parametrize("foot", FEET)
def test_weight_pulls_down_the_slope(foot):
    posture, _, _ = standing(BENT)
    down = Rotation.from_euler("y", 0.1).inv().apply([0.0, 0.0, -1.0])
    sample = Sample(10**9, BENT, STILL, contacts=ContactMessage(10**9, foot == Foot.LEFT, foot == Foot.RIGHT))
    computed = ComputedWrenches(robot(), by("contacts")).filled(sample, posture, foot, down)
    own = computed.left_wrench if foot == Foot.LEFT else computed.right_wrench
    np.testing.assert_allclose(own[:3], -robot().mass * 9.81 * down, atol=1.0)
    com, _ = posture.com_in_sole(foot)
    assert -own[4] / own[2] == pytest.approx(com[0] - com[2] * down[0] / down[2], abs=2e-3)


def test_on_a_slope_that_the_imu_knows_a_standing_robot_is_predicted_to_stand():
    last = on_a_slope(0.1, 0.5, True)[-1]
    np.testing.assert_allclose(last.horizons[0].com, last.measured_com, atol=5e-4)


def test_a_slope_that_nobody_knows_is_said():
    made = on_a_slope(0.1, 3.0, False)
    assert not made[10].flags & Flags.UNKNOWN_GROUND and made[-1].flags & Flags.UNKNOWN_GROUND
    for known in (on_a_slope(0.1, 3.0, True), on_a_slope(0.0, 3.0, False, **{"model.slope": "level"})):
        assert not any(p.flags & Flags.UNKNOWN_GROUND for p in known)


def test_two_feet_share_the_weight_by_the_place_of_the_com():
    q = BENT.copy()
    q[[1, 7]], q[[5, 11]] = 0.15, -0.15  # towards one side, soles level
    posture, _, _ = standing(q)
    computed = ComputedWrenches(robot(), by("contacts")).filled(
        Sample(10**9, q, STILL, contacts=ContactMessage(10**9, True, True)), posture, Foot.LEFT
    )
    p = posture.sole_pose(Foot.LEFT, Foot.RIGHT)[1, 3]
    nearer_right = posture.com_in_sole(Foot.LEFT)[0][1] / p
    assert abs(nearer_right - 0.5) > 0.1
    share = computed.right_wrench[2] / (computed.left_wrench[2] + computed.right_wrench[2])
    assert share == pytest.approx(nearer_right, abs=0.1)


def test_without_what_they_are_computed_from_there_are_none():
    posture, _, _ = standing(BENT)
    nothing = Sample(10**9, BENT, STILL, np.full(12, np.nan))
    for source in ("torques", "contacts"):
        computed = ComputedWrenches(robot(), by(source))
        assert computed.filled(nothing, posture, Foot.LEFT) is nothing
        assert bool(computed.warnings()) == (source == "torques")


@cache
def recorded() -> list[Sample]:
    """Ten seconds of a shipped walk."""
    with Session(bag_path("test1"), Config()) as session:
        return list(islice(session.samples(), 2000))


def walk(source: str, samples: list[Sample]) -> tuple[Predictor, list[Prediction]]:
    predictor = Predictor(robot(), by(source))
    return predictor, [predictor.update(replace(sample)) for sample in samples]


def stripped() -> list[Sample]:
    """Without the wrenches; with contact states by their first tenth of the weight."""
    samples = []
    for sample in recorded():
        contacts = None
        if sample.left_wrench is not None and sample.right_wrench is not None:
            on = (wrench[2] > 10.0 for wrench in (sample.left_wrench, sample.right_wrench))
            contacts = ContactMessage(sample.stamp_ns, *(bool(each) for each in on))
        samples.append(replace(sample, left_wrench=None, right_wrench=None, contacts=contacts))
    return samples


@pytest.mark.slow
@pytest.mark.parametrize("source", ["torques", "contacts"])
def test_a_walk_without_foot_sensors(source):
    """Phases, free run and predictions ahead are nearly those by sensors, and every prediction says its source."""
    _, measured = walk("sensors", recorded())
    predictor, computed = walk(source, stripped())
    pairs = [(a, b) for a, b in zip(measured, computed, strict=True) if not b.flags & Flags.STALE_WRENCH]
    assert len(pairs) > 1900
    assert np.mean([a.support.phase == b.support.phase for a, b in pairs]) > 0.97
    errors = [np.sqrt(np.nanmean([p.residual**2 for p in each], axis=0)) for each in (measured, computed)]
    assert (errors[1] < 1.2 * errors[0]).all()
    assert np.isfinite(predictor.judge.rmse()["0.2"]["published"]).all()
    assert all(p.flags & Flags.COMPUTED_WRENCH for p in computed)
    assert not any(p.flags & Flags.COMPUTED_WRENCH for p in measured)
    assert {p.support.phase for p in computed} == {Phase.LEFT, Phase.RIGHT, Phase.DOUBLE}
    assert np.isnan(computed[-1].estimate.force).all()
    assert predictor.sample.left_wrench is None  # the monitor does not take computed wrenches for measured ones
