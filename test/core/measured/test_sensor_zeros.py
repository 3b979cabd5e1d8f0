# SPDX-License-Identifier: BSD-3-Clause
"""Zeros of foot sensors: found while the robot walks or stands, and phases as with good sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import recording

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array, Foot, Phase, Sample
from coman_reduced_model.core.measured import sensor_zeros
from coman_reduced_model.core.measured.sensor_zeros import SensorZeros
from coman_reduced_model.core.monitor.plausibility import Plausibility
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.diagnose.data.recording import load

LEFT, RIGHT = np.array([20.0, -12.0, 120.0, 1.0, -2.0, 0.3]), np.array([-15.0, 30.0, -70.0, -1.5, 0.5, -0.2])
NONE = np.zeros(6)
LEARNT = 300  # samples (1.5 s) after which phases must be right


@pytest.fixture(scope="module")
def walk() -> tuple[coman.Robot, coman.Config, list[Sample]]:
    with coman.Session(coman.bag_path("test1")) as session:
        return session.robot, session.config.replaced({"prediction.horizons": []}), list(session.samples())


def run(walk: tuple[coman.Robot, coman.Config, list[Sample]], left: Array, right: Array) -> tuple[Predictor, Array]:
    """The predictor at the end, and the phases (n,)."""
    robot, config, samples = walk
    predictor, phases = Predictor(robot, config), []
    for sample in samples:
        wrenches = [
            None if each is None else each + zero
            for each, zero in ((sample.left_wrench, left), (sample.right_wrench, right))
        ]
        changed = replace(sample, left_wrench=wrenches[0], right_wrench=wrenches[1])
        phases.append(predictor.update(changed).support.phase)
    return predictor, np.array(phases)


@pytest.fixture(scope="module")
def good(walk) -> tuple[Predictor, Array]:
    """By good sensors."""
    return run(walk, NONE, NONE)


def test_good_sensors_are_left_alone(good) -> None:
    predictor, _ = good
    assert not predictor.zeros.active and not predictor.zeros.warnings()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("left", "right"), [(LEFT, RIGHT), (LEFT, NONE), (NONE, RIGHT), (-LEFT, -RIGHT), (-2.0 * LEFT, 3.0 * RIGHT)]
)
def test_zeros_are_found_and_phases_are_those_of_good_sensors(walk, good, left: Array, right: Array) -> None:
    _, expected = good
    predictor, phases = run(walk, left, right)
    assert set(expected) >= {Phase.LEFT, Phase.RIGHT, Phase.DOUBLE}
    assert np.mean(phases[LEARNT:] != expected[LEARNT:]) < 0.02
    for foot, zero in ((Foot.LEFT, left), (Foot.RIGHT, right)):
        np.testing.assert_allclose(predictor.zeros.of(foot)[:3], zero[:3], atol=5.0)
        np.testing.assert_allclose(predictor.zeros.of(foot)[3:], zero[3:], atol=0.5)
    said = " ".join(map(str, predictor.zeros.warnings()))
    assert ("left_foot" in said) == left.any() and ("right_foot" in said) == right.any()


@pytest.mark.slow
@pytest.mark.parametrize("left", [-0.3, -0.45, -0.7])
def test_zeros_that_leave_a_tenth_of_the_weight_are_not_taken_for_kilograms(walk, left: float) -> None:
    robot, config, samples = walk
    down = np.array([0.0, 0.0, robot.mass * config.robot.gravity, 0.0, 0.0, 0.0])
    zeros = left * down, (-0.9 - left) * down
    predictor, _ = run(walk, *zeros)
    np.testing.assert_allclose(predictor.zeros.both[[2, 8]], [zeros[0][2], zeros[1][2]], atol=5.0)
    checks = Plausibility(robot, config)
    for sample in samples:
        assert sample.left_wrench is not None and sample.right_wrench is not None
        checks.update(
            replace(sample, left_wrench=sample.left_wrench + zeros[0], right_wrench=sample.right_wrench + zeros[1])
        )
    found = checks.warnings({foot: float(predictor.zeros.of(foot)[2]) for foot in (Foot.LEFT, Foot.RIGHT)})
    assert not [each.text for each in found if "kilograms" in each.text]


@pytest.mark.slow
def test_zeros_that_cancel_in_the_total_are_found_by_feet_in_the_air(walk, good) -> None:
    """25 N too little on the left foot, 20 N too much on the right one: no foot ever seems to lift."""
    left, right = np.array([20.0, -12.0, -25.0, 1.0, -2.0, 0.3]), np.array([-15.0, 30.0, 20.0, -1.5, 0.5, -0.2])
    _, expected = good
    predictor, found = run(walk, left, right)
    assert predictor.zeros.active
    for foot, zero in ((Foot.LEFT, left), (Foot.RIGHT, right)):
        np.testing.assert_allclose(predictor.zeros.of(foot)[:3], zero[:3], atol=3.0)
    later = len(expected) // 2  # both feet have been in the air twice
    assert np.mean(found[later:] != expected[later:]) < 0.02


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_foot_that_bears_load_on_a_step_is_not_in_the_air(walk, share: float) -> None:
    robot, config, samples = walk
    link, zeros = robot.posture(), SensorZeros(robot.mass * config.robot.gravity)
    q = np.zeros(len(robot.joint_names))
    q[robot.legs[Foot.LEFT][:4]] = [-0.5, 0.0, 0.0, 1.0]
    q[robot.legs[Foot.LEFT][4:]] = [-0.5, 0.0]
    link.update(q, np.zeros_like(q))
    assert link.sole_pose(Foot.RIGHT, Foot.LEFT)[2, 3] > 0.03
    wrench = np.array([0.1, 0.0, 1.0, 0.0, 0.0, 0.0]) * zeros.weight
    for k in range(600):
        sample = replace(samples[0], stamp_ns=(k + 1) * 5_000_000, left_wrench=share * wrench)
        zeros.corrected(replace(sample, right_wrench=(1.0 - share) * wrench), link)
    assert not zeros.active


def test_what_explains_the_total_force_worse_than_no_zeros_is_not_taken_off(walk, monkeypatch) -> None:
    """A robot that is lighter than its URDF, and rocks: the joints have a foot in the air that bears load."""
    robot, config, samples = walk
    lighter = [
        replace(each, left_wrench=0.85 * each.left_wrench, right_wrench=0.85 * each.right_wrench)
        for each in samples
        if each.left_wrench is not None and each.right_wrench is not None
    ]
    zeros, link, active = SensorZeros(robot.mass * config.robot.gravity), robot.posture(), []
    for sample in lighter:
        bears = Foot.LEFT if sample.left_wrench[2] > sample.right_wrench[2] else Foot.RIGHT
        monkeypatch.setattr(sensor_zeros, "_in_the_air", lambda link, foot=bears: foot)
        link.update(sample.q, sample.qd)
        corrected = zeros.corrected(sample, link)
        active.append(zeros.active)
    assert sum(active) > 100 and not any(active[-800:])
    assert corrected is lighter[-1] and not zeros.both.any() and not zeros.of(Foot.RIGHT).any()
    (said,) = zeros.warnings()
    assert "85% of the weight, and no zeros of the sensors explain it" in said.text and zeros.settled
    zeros.weight *= 0.85  # as by a parameter of the node
    assert not zeros.settled and not zeros.warnings()


@pytest.mark.slow
def test_a_robot_that_is_lifted_keeps_its_zeros(walk) -> None:
    """It hangs for ten seconds, as on a gantry, and is put down again."""
    robot, config, samples = walk
    zeros, link = SensorZeros(robot.mass * config.robot.gravity), robot.posture()
    left, right = (np.array([0.0, 0.0, force, 0.0, 0.0, 0.0]) for force in (60.0, 40.0))
    for sample in samples:
        if sample.left_wrench is not None and sample.right_wrench is not None:
            link.update(sample.q, sample.qd)
            read = replace(sample, left_wrench=sample.left_wrench + left, right_wrench=sample.right_wrench + right)
            zeros.corrected(read, link)
    before = zeros.both
    np.testing.assert_allclose(before[[2, 8]], [60.0, 40.0], atol=4.0)
    for k in range(2000):
        hanging = replace(read, stamp_ns=read.stamp_ns + (k + 1) * 5_000_000, left_wrench=left, right_wrench=right)
        zeros.corrected(hanging, link)
    assert zeros.active
    np.testing.assert_array_equal(zeros.both, before)


def test_reversed_forces_are_no_zeros(walk) -> None:
    robot, config, samples = walk
    predictor = Predictor(robot, config)
    for sample in samples:
        if sample.left_wrench is not None and sample.right_wrench is not None:
            predictor.update(replace(sample, left_wrench=-sample.left_wrench, right_wrench=-sample.right_wrench))
    assert not predictor.zeros.active


@pytest.mark.slow
def test_a_real_robot_whose_sensors_read_hundreds_of_newtons() -> None:
    folder = recording("real/icub_yoga")
    config = coman.load_config(folder / "icub02.yaml")
    phases = {}
    for name in ("zeroed", "raw"):
        with coman.Session(folder / name, config) as session:
            phases[name] = np.array([p.support.phase for p in session.predictions()])
            zeros = session.pipeline.predictor.zeros
    assert np.mean(phases["raw"] != phases["zeroed"]) < 0.02
    # A diagnosis takes what is known in the end.
    raw, zeroed = (load(folder / name, config)[0].phase for name in ("raw", "zeroed"))
    assert np.mean(raw != zeroed) < 0.001
    # What the right sensor reads in the air, and what the left one, which never leaves the ground, has too little.
    np.testing.assert_allclose(zeros.of(Foot.RIGHT)[:3], [269.0, 79.0, -114.5], atol=5.0)
    assert zeros.of(Foot.LEFT)[2] == pytest.approx(-214.0, abs=10.0)


def test_a_robot_that_hangs_or_jumps_has_no_zeros(walk) -> None:
    robot, config, samples = walk
    predictor = Predictor(robot, config)
    noise = np.random.default_rng(0).normal(0.0, 1.0, (len(samples), 2, 6))
    for sample, (left, right) in zip(samples, noise, strict=True):
        predictor.update(replace(sample, left_wrench=left, right_wrench=right))
    assert not predictor.zeros.active


@pytest.mark.slow
def test_a_clock_that_goes_back_and_values_that_are_none_do_not_end_learning(walk) -> None:
    robot, config, samples = walk
    predictor = Predictor(robot, config)
    known = [s for s in samples if s.left_wrench is not None and s.right_wrench is not None]
    for again, zero in enumerate((LEFT, 0.5 * LEFT)):
        for k, sample in enumerate(known):
            wrench = sample.left_wrench + (zero if k % 97 else np.nan)
            predictor.update(replace(sample, stamp_ns=sample.stamp_ns - again * 50 * 10**9, left_wrench=wrench))
    assert np.isfinite(predictor.zeros.of(Foot.LEFT)).all()
    assert predictor.zeros.of(Foot.LEFT)[2] == pytest.approx(0.5 * LEFT[2], abs=15.0)


def test_samples_stay_as_they_came(walk) -> None:
    robot, config, samples = walk
    predictor = Predictor(robot, config)
    sample = replace(samples[500], left_wrench=samples[500].left_wrench + LEFT)
    before = sample.left_wrench.copy()
    predictor.zeros.active = True
    predictor.update(sample)
    np.testing.assert_array_equal(sample.left_wrench, before)
    assert predictor.sample is not None and predictor.sample is not sample
