# SPDX-License-Identifier: BSD-3-Clause
"""Errors of the trunk's rotation: a truth in closed form, and estimates that are off by a known turn."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.types import (
    Estimate,
    Flags,
    Foot,
    Phase,
    Prediction,
    SupportState,
    TrunkRotation,
)
from coman_reduced_model.core.evaluation.consistency import Consistency, TrueMotion
from coman_reduced_model.core.evaluation.rotation import TrueRotation

NAN = np.full(3, np.nan)
SIGMA = np.array([2e-3, 2e-3, 1e-3, 0.02, 0.02, 0.02])
AHEAD = Rotation.from_euler("z", 0.3)  # where the sole points


def truth(seconds: float = 400.0) -> TrueMotion:
    """The trunk pitches about its own y, above a sole that points aside and is tilted."""
    t = np.linspace(0.0, seconds, round(200 * seconds) + 1)
    turns = AHEAD * Rotation.from_euler("y", 0.1 * np.sin(t)[:, None])
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    pose[:, :3, :3] = (AHEAD * Rotation.from_euler("y", 0.05)).as_matrix()
    poses, com = {Foot.LEFT: pose, Foot.RIGHT: pose}, np.zeros((len(t), 3))
    return TrueMotion.of(np.round(1e9 * t).astype(np.int64), com, poses, (turns.as_quat(), np.array([0.0, 0.0, -9.81])))


def rotation(t: float) -> tuple[np.ndarray, np.ndarray]:
    return Rotation.from_euler("y", 0.1 * np.sin(t)).as_matrix(), np.array([0.0, 0.1 * np.cos(t), 0.0])


def prediction(t: float, phase: Phase, off: np.ndarray) -> Prediction:
    R, rate = rotation(t)
    trunk = TrunkRotation(R @ Rotation.from_rotvec(off[:3]).as_matrix(), rate + off[3:], np.diag(SIGMA**2), t < 200.0)
    in_sole = np.vstack([R @ Rotation.from_rotvec([0.0, 5e-3, 0.0]).as_matrix(), np.zeros((2, 3)), rate + 0.05])
    return Prediction(
        round(1e9 * t), "", SupportState(phase, Foot(phase.value)), NAN, NAN, NAN, NAN, NAN, NAN, np.eye(4), [],
        Flags.OK, base_in_sole=in_sole, estimate=Estimate(trunk=trunk),
    )  # fmt: skip


def test_the_truth_is_in_the_level_frame_of_the_sole():
    found = truth(2.0).rotation
    assert isinstance(found, TrueRotation)
    R, rate = rotation(1.0)
    at = found.at(1.0, Foot.LEFT)
    np.testing.assert_allclose(at[0], R, atol=1e-6)
    np.testing.assert_allclose(at[1], rate, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_errors_and_what_the_covariance_says_of_them(factor):
    motion, rng = truth(), np.random.default_rng(2)
    consistency = Consistency(motion)
    for step in range(500):
        phase = Phase.LEFT if step % 2 else Phase.RIGHT
        off = factor * SIGMA * rng.standard_normal(6)
        for k in range(3):
            consistency.add(prediction(2.0 + 0.7 * step + 0.1 * k, phase, off))
    found = consistency.summary()
    assert found["tilt_by_imu"] == pytest.approx(198.0 / 350.0, abs=0.02)
    assert found["nees_tilt"] == pytest.approx(2.0 * factor**2, rel=0.15)
    assert found["nees_angular_velocity"] == pytest.approx(3.0 * factor**2, rel=0.15)
    assert found["rmse_turn_rad"]["y"] == pytest.approx(2e-3 * factor, rel=0.1)
    assert found["rmse_encoder_turn_rad"]["y"] == pytest.approx(5e-3, rel=0.01)
    assert found["rmse_encoder_angular_velocity_rad_s"]["y"] == pytest.approx(0.05, rel=0.01)
    if factor == 1.0:
        for shares in found["turn_within_90"].values():
            assert list(shares.values()) == pytest.approx([0.9] * 3, abs=0.05)
