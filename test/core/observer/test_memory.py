# SPDX-License-Identifier: BSD-3-Clause
"""The filter on a point mass whose motion, forces and encoders are known: its covariance against its errors."""

from typing import NamedTuple

import numpy as np
import pytest

from coman_reduced_model.core.observer.memory import BEGINS, CHANGES, GOES_ON, ROWS, SIZES, Noise, memory_of, take

DT, MASS, GRAVITY = 0.005, 30.0, 9.81  # [s], [kg], [m/s^2]
STEP = 5e-4  # [m] of the measured position
WEIGHT = MASS * GRAVITY
WRENCH, LEVEL = np.zeros(6), np.asfortranarray(np.eye(3))  # as views of the robot are
PUSHED = slice(2000, 2400)  # samples: 10 s to 12 s


class Run(NamedTuple):
    """What is estimated, sample by sample."""

    errors: np.ndarray  # (n, 3) of the velocity [m/s]
    sigma: np.ndarray  # (n, 3) [m/s]
    covariance: np.ndarray  # (n, 3, 3) of the velocity
    measured: np.ndarray  # (n, 3, 3) covariance of the measured position [m^2]


def run(chatter: float, n: int = 4000) -> Run:
    """A mass that swings; for two seconds it chatters sideways at 25 Hz and `chatter` [m/s], which no force shows."""
    t = DT * np.arange(n)[:, None]
    amplitude, pulse = np.array([0.05, 0.08, 0.02]), 2.0 * np.pi * np.array([0.7, 0.9, 1.1])
    position, velocity = amplitude * np.sin(pulse * t), amplitude * pulse * np.cos(pulse * t)
    felt = -(pulse**2) * position
    fast = 2.0 * np.pi * 25.0 * t[PUSHED, 0]
    position[PUSHED, 1] += chatter / (2.0 * np.pi * 25.0) * np.sin(fast)
    velocity[PUSHED, 1] += chatter * np.cos(fast)
    rounded = STEP * np.round(position / STEP)
    block = np.zeros(sum(SIZES))
    memory = memory_of(block)
    memory.walks[:], memory.constant[:] = (0.1 * WEIGHT) ** 2, 1.0
    memory.scalars[1], memory.squares[:] = 3.0, 1.0
    memory.rounding[:] = STEP**2 / 12.0 * np.eye(3)
    noise = Noise(MASS, GRAVITY, (1e-4 * WEIGHT) ** 2, 0.0, 0.0, np.zeros(3))
    out, found = np.empty((ROWS, 3)), []
    for k in range(n):
        wrench = np.concatenate([MASS * (felt[k] + [0.0, 0.0, GRAVITY]), np.zeros(3)])
        take(
            block, noise, (GOES_ON if k else BEGINS, DT, 1), wrench, WRENCH, LEVEL, LEVEL, rounded[k], velocity[k], out
        )
        P = out[9:].reshape(6, 6)[3:, 3:].copy()
        found.append((out[1] - velocity[k], np.sqrt(np.diag(P)), P, out[3:6].copy()))
    return Run(*(np.array(part) for part in zip(*found, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.001, 0.01])
@pytest.mark.parametrize("change", [1, 200])  # at once, and after a while
def test_a_change_of_feet_goes_unnoticed(dt, change):
    """The same mass, that moves steadily, seen from one sole and then from another."""
    block, out = np.zeros(sum(SIZES)), np.empty((ROWS, 3))
    memory, noise = memory_of(block), Noise(MASS, GRAVITY, (1e-4 * WEIGHT) ** 2, 0.0, 0.0, np.zeros(3))
    memory.walks[:], memory.constant[:], memory.rounding[:] = (0.1 * WEIGHT) ** 2, 1.0, 1e-8 * np.eye(3)
    memory.scalars[1], memory.squares[:] = 3.0, 1.0
    velocity, apart = np.array([0.25, -0.1, 0.0]), np.array([0.1, 0.2, 0.0])
    rng, wrench = np.random.default_rng(0), np.array([0.0, 0.0, WEIGHT, 0.0, 0.0, 0.0])
    for k in range(change + 1):
        what = BEGINS if k == 0 else CHANGES if k == change else GOES_ON
        com = velocity * dt * k + (apart if what == CHANGES else 0.0)
        measured = com + 1e-4 * rng.uniform(-0.5, 0.5, 3)
        take(block, noise, (what, dt, 1), wrench, WRENCH, LEVEL, LEVEL, measured, velocity, out)
    assert np.abs(out[0] - com).max() < 1.5e-4
    assert np.abs(out[1] - velocity).max() < 0.02


@pytest.fixture(scope="module")
def calm() -> Run:
    return run(0.0)


@pytest.fixture(scope="module")
def shaken() -> Run:
    return run(0.2)


def test_the_velocity_is_as_sure_as_it_says(calm):
    """Somewhat too cautious, since it expects forces to wander a little, and these do not."""
    picked = slice(600, None, 25)  # errors of samples in a row are alike
    nees = [e @ np.linalg.solve(P, e) for e, P in zip(calm.errors[picked], calm.covariance[picked], strict=True)]
    assert 1.0 < np.mean(nees) < 4.2


def test_rounding_is_counted_once(calm):
    variance = np.einsum("nii->ni", calm.measured)[1000:].mean(axis=0)
    assert variance == pytest.approx(np.full(3, STEP**2 / 12.0), rel=0.25)


def test_chatter_that_forces_do_not_show_makes_the_velocity_less_sure(calm, shaken):
    after_a_tenth = slice(PUSHED.start + 20, PUSHED.stop)
    error = np.sqrt(np.mean(shaken.errors[after_a_tenth, 1] ** 2))
    sigma = np.sqrt(np.mean(shaken.sigma[after_a_tenth, 1] ** 2))
    assert error > 0.05 and 0.5 < sigma / error < 3.0
    assert shaken.sigma[after_a_tenth, 0].mean() < 1.5 * calm.sigma[after_a_tenth, 0].mean()  # of that axis alone


def test_after_the_chatter_it_is_sure_again(calm, shaken):
    late = slice(PUSHED.stop + 400, None)
    assert shaken.sigma[late, 1].mean() < 1.5 * calm.sigma[late, 1].mean()


def test_samples_that_are_lost_are_no_noise_of_the_measured_com(n=4000):
    """By steps of encoders; a third of the samples is missing. Third differences want even steps."""
    found, rng = [], np.random.default_rng(1)
    for lost in (0.0, 0.3):
        block, out = np.zeros(sum(SIZES)), np.empty((ROWS, 3))
        memory, noise = memory_of(block), Noise(MASS, GRAVITY, (1e-4 * WEIGHT) ** 2, 0.0, 0.0, np.zeros(3))
        memory.walks[:], memory.constant[:], memory.scalars[1], memory.squares[:] = (0.1 * WEIGHT) ** 2, 1.0, 3.0, 1.0
        memory.rounding[:] = STEP**2 / 12.0 * np.eye(3)
        kept = np.flatnonzero(rng.uniform(size=n) >= lost)
        for i, k in enumerate(kept):
            t, pulse = DT * k, 2.0 * np.pi * 1.5
            com = STEP * np.round(0.05 * np.sin(pulse * t) / STEP) * np.ones(3)
            felt = MASS * (-(pulse**2) * com + [0.0, 0.0, GRAVITY])
            dt = DT * (k - kept[i - 1]) if i else DT
            velocity = 0.05 * pulse * np.cos(pulse * t) * np.ones(3)
            step = GOES_ON if i else BEGINS, dt, 1
            take(block, noise, step, np.concatenate([felt, np.zeros(3)]), WRENCH, LEVEL, LEVEL, com, velocity, out)
        found.append(np.sqrt(memory.white / memory.scalars[0]))
    np.testing.assert_allclose(found[1], found[0], rtol=0.3)
