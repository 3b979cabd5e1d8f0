# SPDX-License-Identifier: BSD-3-Clause
"""Rotation of the trunk: motions in closed form, with and without an IMU, and what is not known of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rotation_tools import BENT, NOMINAL, RATE, STILL, imu, now, robot
from scipy.spatial.transform import Rotation

from coman_reduced_model.core.base.pose import LEVEL
from coman_reduced_model.core.base.types import Foot, ImuMessage, TrunkRotation
from coman_reduced_model.core.effects.hooks import Now
from coman_reduced_model.core.observer.observer import Observer
from coman_reduced_model.core.observer.rotation import rotation_vector, turn_by
from coman_reduced_model.core.observer.trunk import TrunkFilter

STEPS = np.full(12, 1e-4)
MOUNT, SLOPE = NOMINAL.widths["imu.spread"], NOMINAL.widths["ground_slope.spread"]
ZERO = NOMINAL.widths["encoder_bias.bias.spread"]


def new_filter() -> TrunkFilter:
    return TrunkFilter(robot(), 9.81, 0.25, NOMINAL)


def pitch(t: float) -> tuple[float, float]:
    """[rad], [rad/s]."""
    return 0.05 * np.sin(2.0 * np.pi * t), 0.1 * np.pi * np.cos(2.0 * np.pi * t)


def run(make: Callable[[float, int], Now], seconds: float = 4.0, found: TrunkFilter | None = None) -> TrunkRotation:
    found = found or new_filter()
    rotation = TrunkRotation()
    for k in range(round(seconds * RATE)):
        t = (k + 1) / RATE
        rotation = found.update(make(t, 10**9 + round(t * 1e9)), STEPS)
    return rotation


def angles(rotation: TrunkRotation) -> np.ndarray:
    """Roll, pitch, yaw [rad]."""
    return Rotation.from_matrix(rotation.R).as_euler("xyz")


def rocking(t: float, stamp: int) -> Now:
    """The legs are stiff: the trunk pitches with the sole, which the encoders do not see."""
    angle, rate = pitch(t)
    return now(stamp, BENT, imu(stamp, Rotation.from_euler("y", angle), np.array([0.0, rate, 0.0])))


def bowing(t: float, stamp: int) -> Now:
    """The ankle of the left leg pitches the trunk above a sole that lies flat; no IMU."""
    q = BENT.copy()
    ankle = robot().joint_names.index(robot().config.left.joints[-2])
    q[ankle] -= pitch(t)[0]
    flat = now(stamp, q, None)
    assert flat.link.tilt[1] == pytest.approx(pitch(t)[0], abs=1e-9)
    return flat


@pytest.mark.parametrize("seconds", [2.0, 2.125, 2.25, 2.6])
def test_with_an_imu_it_is_the_pitch_to_gravity_though_the_sole_tilts(seconds):
    rotation = run(rocking, seconds)
    angle, rate = pitch(seconds)
    assert rotation.by_imu
    assert angles(rotation) == pytest.approx([0.0, angle, 0.0], abs=3e-3)
    assert rotation.angular_velocity == pytest.approx([0.0, rate, 0.0], abs=0.02)


@pytest.mark.parametrize("seconds", [2.0, 2.125, 2.25, 2.6])
def test_without_an_imu_it_is_the_pitch_above_a_flat_sole(seconds):
    rotation = run(bowing, seconds)
    angle, rate = pitch(seconds)
    assert not rotation.by_imu
    assert angles(rotation) == pytest.approx([0.0, angle, 0.0], abs=3e-3)
    assert rotation.angular_velocity == pytest.approx([0.0, rate, 0.0], abs=0.03)


def test_without_an_imu_a_slope_that_is_known_counts():
    down = Rotation.from_euler("y", 0.1).inv().apply(LEVEL)
    assert angles(run(lambda t, stamp: now(stamp, BENT, None, down=down)))[1] == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize("make", [rocking, bowing])
def test_the_covariance_is_positive_definite_and_symmetric(make):
    P = run(make).covariance
    np.testing.assert_allclose(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_yaw_is_that_of_the_encoders_whatever_the_imu_says_and_no_surer():
    def turned(yaw: float) -> TrunkRotation:
        heading = Rotation.from_euler("z", yaw)
        return run(lambda t, stamp: now(stamp, BENT, imu(stamp, heading, STILL[:3])))

    ahead, aside = turned(0.0), turned(1.0)
    assert angles(aside) == pytest.approx(angles(ahead), abs=1e-9)
    assert abs(angles(aside)[2]) < 1e-6
    # One joint turns about z, those of the pitch and the roll hardly.
    assert np.sqrt(aside.covariance[2, 2]) == pytest.approx(ZERO, rel=0.2)


def test_constants_are_in_the_covariance():
    by_imu, by_encoders = run(rocking).covariance, run(bowing).covariance
    encoders = SLOPE**2 + 3.0 * ZERO**2  # three joints pitch
    assert np.sqrt(by_encoders[1, 1]) == pytest.approx(np.sqrt(encoders), rel=0.1)
    assert np.sqrt(by_imu[1, 1]) == pytest.approx((MOUNT**-2 + 1.0 / encoders) ** -0.5, rel=0.1)


def test_of_what_imu_and_encoders_differ_by_a_part_is_the_mounting():
    off = 0.005
    rotation = run(lambda t, stamp: now(stamp, BENT, imu(stamp, Rotation.from_euler("y", off), STILL[:3])), 12.0)
    expected = off * (1.0 - MOUNT**2 / (MOUNT**2 + SLOPE**2 + 3.0 * ZERO**2))
    assert angles(rotation)[1] == pytest.approx(expected, rel=0.1)


def test_a_robot_that_falls_falls_by_the_imu():
    def falling(t: float, stamp: int) -> Now:
        rate = 0.5 if t > 4.0 else 0.0
        turn = Rotation.from_euler("y", rate * (t - 4.0))
        return now(stamp, BENT, imu(stamp, turn, np.array([0.0, rate, 0.0])))

    assert angles(run(falling, 5.0))[1] == pytest.approx(0.5, abs=0.01)


def test_the_zero_of_the_gyro_is_learnt():
    zero = np.array([0.02, -0.01, 0.03])
    rotation = run(lambda t, stamp: now(stamp, BENT, imu(stamp, Rotation.identity(), zero)), 8.0)
    assert rotation.angular_velocity == pytest.approx([0.0] * 3, abs=2e-3)


def test_the_orientation_of_an_imu_is_brought_to_the_stamp_of_the_sample():
    """It is 4 ms older: at 0.3 rad/s a milliradian."""

    def late(t: float, stamp: int) -> Now:
        angle, rate = pitch(t - 0.004)
        message = imu(stamp - 4_000_000, Rotation.from_euler("y", angle), np.array([0.0, rate, 0.0]))
        return now(stamp, BENT, message)

    assert angles(run(late, 4.0))[1] == pytest.approx(pitch(4.0)[0], abs=4e-4)


def spoilt(stamp: int, kind: str) -> ImuMessage | None:
    message = imu(stamp, Rotation.from_euler("y", 0.2), np.zeros(3), "l_foot" if kind == "on a foot" else "imu_link")
    if kind == "not finite":
        message.orientation = np.full(4, np.nan)
        message.angular_velocity = np.full(3, np.nan)
    if kind == "no orientation":
        message.orientation = None
    return None if kind == "none" else message


@pytest.mark.parametrize("kind", ["none", "not finite", "no orientation", "on a foot"])
def test_an_imu_that_says_nothing_leaves_the_encoders(kind):
    rotation = run(lambda t, stamp: now(stamp, BENT, spoilt(stamp, kind)), 1.0)
    assert not rotation.by_imu and angles(rotation) == pytest.approx([0.0] * 3, abs=1e-6)


def test_an_imu_that_is_lost_and_found_again():
    found = new_filter()
    for k in range(600):
        stamp = 10**9 + 5_000_000 * k
        lost = 200 <= k < 400
        message = None if lost else imu(stamp, Rotation.from_euler("y", 0.015), STILL[:3])
        rotation = found.update(now(stamp, BENT, message), STEPS)
        assert np.isfinite(rotation.R).all() and np.linalg.eigvalsh(rotation.covariance).min() > 0.0
        if not 200 <= k < 260:  # its next message may come
            assert rotation.by_imu == (not lost) and (angles(rotation)[1] > 0.008) == (not lost)


@pytest.mark.parametrize("rate", [10.0, 16.7])
def test_a_slow_imu_is_not_lost_between_its_messages(rate):
    """Older ones than 50 ms are not joined to a sample."""
    found = new_filter()
    for k in range(400):
        t = k / RATE
        since = t % (1.0 / rate)
        message = imu(10**9 + round((t - since) * 1e9), Rotation.from_euler("y", 0.015), STILL[:3])
        rotation = found.update(now(10**9 + round(t * 1e9), BENT, message if since <= 0.05 else None), STEPS)
        assert rotation.by_imu
    fast = run(lambda t, stamp: now(stamp, BENT, imu(stamp, Rotation.from_euler("y", 0.015), STILL[:3])))
    assert angles(rotation) == pytest.approx(angles(fast), abs=1e-3)


def test_an_imu_that_is_slower_than_the_joints_counts_once():
    def slow(t: float, stamp: int) -> Now:
        last = int(t * 40.0) / 40.0
        angle, rate = pitch(last)
        message = imu(stamp - round((t - last) * 1e9), Rotation.from_euler("y", angle), np.array([0.0, rate, 0.0]))
        return now(stamp, BENT, message)

    rotation = run(slow, 4.0)
    assert rotation.by_imu and angles(rotation)[1] == pytest.approx(pitch(4.0)[0], abs=8e-3)


def test_when_the_support_changes_to_a_foot_that_is_turned_roll_and_pitch_stay():
    """The right foot points 0.3 rad aside: the heading jumps, what leans does not."""
    q = BENT.copy()
    hip_yaw = robot().joint_names.index(robot().config.right.joints[2])
    q[hip_yaw] = 0.3
    leaning = Rotation.from_euler("xyz", [0.01, 0.02, 0.0])
    found, turns = new_filter(), {}
    for k in range(500):
        stamp, foot = 10**9 + 5_000_000 * k, Foot.LEFT if k < 400 else Foot.RIGHT
        turns[k] = found.update(now(stamp, q, imu(stamp, leaning, STILL[:3]), foot), STEPS)
    before, after = turns[399], turns[400]
    up = before.R[2], after.R[2]
    assert up[1] == pytest.approx(up[0], abs=2e-4)
    jump = Rotation.from_matrix(after.R @ before.R.T).as_rotvec()
    turn = 0.3 * np.cos(0.4)  # by a hip that is pitched
    assert abs(jump[2]) == pytest.approx(turn, abs=2e-3) and jump[:2] == pytest.approx([0.0, 0.0], abs=2e-3)
    assert after.angular_velocity == pytest.approx(before.angular_velocity, abs=5e-3)


def test_without_measured_wrenches_the_rotation_is_known_and_nothing_else():
    observer = Observer(robot(), 9.81, NOMINAL)
    for measured in (True, False):  # without a wrench in the sample, and by computed ones
        estimate = observer.update(rocking(0.1, 10**9), measured)
        assert np.isfinite(estimate.trunk.R).all() and np.isnan(estimate.com).all()


def test_small_turns_are_those_of_scipy():
    turn = np.array([0.002, -0.003, 0.001])
    R = Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix()
    np.testing.assert_allclose(turn_by(turn), Rotation.from_rotvec(turn).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotation_vector(R, R @ turn_by(turn)), turn, atol=1e-7)
    np.testing.assert_allclose(turn_by(np.zeros(3)), np.eye(3))
