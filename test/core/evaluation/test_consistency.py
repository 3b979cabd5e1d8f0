# SPDX-License-Identifier: BSD-3-Clause
"""NEES, NIS and intervals of estimates whose errors are drawn from a known covariance."""

import numpy as np
import pytest

from coman_reduced_model.core.base.types import Estimate, Flags, Foot, Phase, Prediction, SupportState
from coman_reduced_model.core.evaluation.consistency import Consistency, TrueMotion

SIGMA = np.array([1e-3, 1e-3, 2e-3, 0.01, 0.02, 0.01])
NAN = np.full(3, np.nan)


def truth(seconds: float = 400.0) -> TrueMotion:
    """Soles at rest, the left one turned by a quarter about z, the COM on a circle."""
    t = np.linspace(0.0, seconds, round(200 * seconds) + 1)
    com = np.column_stack([0.01 * np.sin(2.0 * t), 0.01 * np.cos(2.0 * t), np.full_like(t, 0.5)])
    poses = {foot: np.tile(np.eye(4), (len(t), 1, 1)) for foot in (Foot.LEFT, Foot.RIGHT)}
    poses[Foot.LEFT][:, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    poses[Foot.RIGHT][:, :3, 3] = [0.0, -0.1, 0.0]
    return TrueMotion.of(np.round(1e9 * t).astype(np.int64), com, poses)


def prediction(stamp_ns: int, phase: Phase, com: np.ndarray, com_vel: np.ndarray, nis: float = 3.0) -> Prediction:
    foot = Foot.RIGHT if phase == Phase.RIGHT else Foot.LEFT
    return Prediction(
        stamp_ns, "", SupportState(phase, foot), com, com_vel, NAN, NAN, NAN, NAN, np.eye(4), [], Flags.OK,
        estimate=Estimate(com, com_vel, np.diag(SIGMA**2), nis=nis),
    )  # fmt: skip


def judged(factor: float) -> dict:
    """A walk of 500 steps, its errors `factor` times as large as the covariance says, the same throughout a step."""
    motion, rng, consistency = truth(), np.random.default_rng(3), Consistency(truth())
    for step in range(500):
        phase = Phase.LEFT if step % 2 else Phase.RIGHT
        off = factor * SIGMA * rng.standard_normal(6)
        for k in range(4):
            stamp = round(1e9 * (2.0 + 0.7 * step + 0.1 * k))
            com, vel = motion.at(stamp, Foot(phase.value))
            consistency.add(prediction(stamp, phase, com + off[:3], vel + off[3:]))
    return consistency.summary()


def test_errors_as_large_as_the_covariance_says():
    found = judged(1.0)
    assert found["steps"] == pytest.approx(500, abs=4)  # but for the first seconds
    assert found["nees_position"] == pytest.approx(3.0, abs=0.35)
    assert found["nees_velocity"] == pytest.approx(3.0, abs=0.35)
    for part in ("position", "velocity"):
        assert list(found["within_90"][part].values()) == pytest.approx([0.9] * 3, abs=0.05)
        for level, share in found["reliability"][part].items():
            assert share == pytest.approx(float(level), abs=0.04)


def test_errors_that_are_twice_as_large():
    found = judged(2.0)
    assert found["nees_velocity"] == pytest.approx(12.0, abs=1.2)
    assert max(found["within_90"]["position"].values()) < 0.7


def test_errors_of_estimate_and_encoders_stand_side_by_side():
    motion, consistency = truth(10.0), Consistency(truth(10.0))
    for stamp in range(0, 10 * 10**9, 10**8):
        com, vel = motion.at(stamp, Foot.LEFT)
        each = prediction(stamp, Phase.LEFT, com, vel)
        each.measured_com, each.measured_com_vel = com + 2e-3, vel - 0.1
        consistency.add(each)
    for errors, of_encoders in ((consistency.position_errors, 2e-3), (consistency.errors, -0.1)):
        assert errors[:, 0] == pytest.approx(0.0) and errors[:, 1] == pytest.approx(of_encoders)


def test_without_a_truth_only_innovations_are_judged():
    consistency = Consistency()
    for k in range(100):
        consistency.add(prediction(k * 50_000_000, Phase.LEFT, np.zeros(3), np.zeros(3), nis=2.0 + k % 2))
    assert consistency.summary() == pytest.approx({"nis": 2.5, "inconsistent": 0.0})


def test_the_nis_of_steps_is_that_of_the_middles_of_single_supports():
    """Of three supports, each with a NIS of its own at its middle; the double support does not count."""
    consistency = Consistency()
    consistency.add(prediction(0, Phase.DOUBLE, np.zeros(3), np.zeros(3)))
    for k, phase in enumerate((Phase.LEFT, Phase.DOUBLE, Phase.RIGHT, Phase.LEFT)):
        for i in range(5):
            nis = 10.0 * k if i == 2 else 3.0
            consistency.add(prediction((100 + 5 * k + i) * 50_000_000, phase, np.zeros(3), np.zeros(3), nis))
    assert consistency.nis.tolist() == [0.0, 20.0, 30.0]


def test_the_velocity_against_the_ground_counts_where_it_is_known():
    """The sole pitches about its origin at a constant rate, the COM is at rest in it."""
    t = np.linspace(0.0, 10.0, 2001)
    pitch, arm = 0.05 * t, np.array([0.0, 0.0, 0.5])
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    pose[:, 0, 0], pose[:, 2, 2], pose[:, 0, 2], pose[:, 2, 0] = (
        np.cos(pitch),
        np.cos(pitch),
        np.sin(pitch),
        -np.sin(pitch),
    )
    com = pose[:, :3, :3] @ arm
    motion = TrueMotion.of(np.round(1e9 * t).astype(np.int64), com, {Foot.LEFT: pose, Foot.RIGHT: pose})
    consistency = Consistency(motion)
    for k in range(300):
        phase = Phase.LEFT if (k // 30) % 2 else Phase.DOUBLE
        each = prediction(k * 30_000_000, phase, arm, np.zeros(3))
        if k > 200:
            each.estimate.ground_vel = np.array([0.025 + 2e-3, 0.0, 0.0])
            each.estimate.ground_vel_covariance = np.diag([1e-3**2] * 3)
        consistency.add(each)
    found = consistency.summary()
    assert found["rmse_ground_velocity_m_s"] == pytest.approx({"x": 2e-3, "y": 0.0, "z": 0.0}, abs=1e-5)
    assert found["rmse_encoder_ground_velocity_m_s"]["x"] == pytest.approx(0.025, abs=1e-5)
    assert found["nees_ground_velocity"] == pytest.approx(4.0, abs=0.05)
    assert found["rmse_velocity_m_s"]["x"] == pytest.approx(0.0, abs=1e-6)


def test_true_motion_is_in_the_axes_of_the_sole():
    com, vel = truth(2.0).at(0, Foot.LEFT)  # the sole's x is the world's y
    assert com == pytest.approx([0.01, 0.0, 0.5], abs=1e-6)
    assert vel == pytest.approx([0.0, -0.02, 0.0], abs=1e-3)
    com, _ = truth(2.0).at(0, Foot.RIGHT)
    assert com == pytest.approx([0.0, 0.11, 0.5], abs=1e-6)
