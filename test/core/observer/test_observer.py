# SPDX-License-Identifier: BSD-3-Clause
"""Estimate of COM and external force: how far off on data whose truth is known, and how sure it says it is."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from predictor_tools import later_predictions

from coman_reduced_model.core.base.types import Flags, Prediction, Sample
from coman_reduced_model.resources import bag_path

PULL = 12.0  # [N] forward


def walk(change: Callable[[Sample], None] = lambda sample: None, seconds: float = 7.0) -> Iterator[Prediction]:
    """Predictions of a walk, its samples changed, after the first two seconds."""
    for prediction, _ in later_predictions(bag_path("test1"), change, seconds):
        yield prediction


@pytest.fixture(scope="module")
def plain() -> list[Prediction]:
    return list(walk())


def test_innovations_are_as_large_as_the_covariance_says(plain):
    nis = np.array([p.estimate.nis for p in plain])
    assert 2.0 < np.nanmean(nis) < 4.5
    assert not any(p.flags & Flags.INCONSISTENT for p in plain)


def test_covariances_are_symmetric_and_positive(plain):
    for p in plain[::50]:
        for each in (p.estimate.covariance, p.estimate.measured_covariance, p.estimate.force_covariance):
            assert each == pytest.approx(each.T) and np.linalg.eigvalsh(each).min() > 0.0


def test_the_velocity_has_less_noise_than_that_of_the_encoders(plain):
    """From one sample to the next; the robot's own motion is in both."""
    measured, estimated = (
        np.diff(list(values), axis=0).std(axis=0)
        for values in ([p.measured_com_vel for p in plain], [p.estimate.com_vel for p in plain])
    )
    assert (estimated < 0.6 * measured).all()


def test_nothing_pushes_a_robot_that_walks_alone(plain):
    force = np.mean([p.estimate.force for p in plain], axis=0)
    sigma = np.sqrt(np.diag(plain[-1].estimate.force_covariance))
    assert (np.abs(force) < sigma).all()


def test_a_pull_that_the_feet_bear_is_found(plain):
    def pull(sample: Sample) -> None:  # the ground holds against it; that the robot did not move for it costs nothing
        for wrench in (sample.left_wrench, sample.right_wrench):
            if wrench is not None:
                wrench[0] -= 0.5 * PULL

    without = np.mean([p.estimate.force for p in plain], axis=0)
    found = np.mean([p.estimate.force for p in walk(pull)], axis=0) - without
    assert found == pytest.approx([PULL, 0.0, 0.0], abs=0.5)


def test_wrenches_that_do_not_belong_to_the_motion_are_said_to_be_inconsistent():
    """Horizontal forces in another unit."""

    def scaled(sample: Sample) -> None:
        for wrench in (sample.left_wrench, sample.right_wrench):
            if wrench is not None:
                wrench[:2] *= 80.0

    assert any(p.flags & Flags.INCONSISTENT for p in walk(scaled))


def test_without_a_wrench_nothing_is_estimated():
    def drop(sample: Sample) -> None:
        sample.left_wrench = None

    for p in walk(drop, seconds=3.0):
        assert np.isnan(p.estimate.com).all() and np.isnan(p.estimate.force).all()


def test_after_a_wrench_that_is_not_finite_it_begins_again():
    samples = iter(range(10_000))

    def spoil(sample: Sample) -> None:
        if next(samples) == 500 and sample.left_wrench is not None:
            sample.left_wrench[:] = np.nan

    known = [np.isfinite(p.estimate.force).all() for p in walk(spoil, seconds=4.0)]
    assert 1 <= known.count(False) <= 5 and known[-1]


def test_masses_and_zeros_of_encoders_are_in_the_covariance(plain):
    """A tenth of a millimetre is what the noise of the encoders alone would make."""
    sigma = np.sqrt(np.diag(plain[-1].estimate.covariance)[:3])
    assert (sigma > 8e-4).all() and (sigma < 1e-2).all()


def test_a_force_that_comes_and_goes_makes_the_velocity_less_certain(plain):
    def shake(sample: Sample) -> None:
        for wrench in (sample.left_wrench, sample.right_wrench):
            if wrench is not None:
                wrench[1] += 10.0 * np.sin(2.0 * np.pi * 3.0e-9 * (sample.stamp_ns % 1_000_000_000_000))

    calm, shaken = (
        np.median([np.diag(p.estimate.covariance)[3:] for p in some], axis=0) for some in (plain, list(walk(shake)))
    )
    assert shaken[1] > 1.5 * calm[1] and shaken[0] < 1.5 * calm[0]
