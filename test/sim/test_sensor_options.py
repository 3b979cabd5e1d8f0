# SPDX-License-Identifier: BSD-3-Clause
"""Options of the sensors, and what all clean robots have: small imperfections of everything at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model.errors import ConfigError
from coman_reduced_model.sim.disturbances import Imperfections, overrides
from coman_reduced_model.sim.robot_table import COMAN, with_upper_body
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.spring_laws import SpringLaws
from coman_reduced_model.sim.virtual_robot import VirtualRobot

K, D = COMAN.joint_array(COMAN.stiffness), COMAN.joint_array(COMAN.damping)


def read(motion, periods: int, disturbances=(), seed: int = 0, **options):
    """Readings and truths of a standing robot whose sensors are exact but for the options."""
    robot = VirtualRobot(COMAN, SensorOptions.exact(**options), disturbances, seed=seed)
    robot.reset(motion, settle_s=0.3)
    readings, truths = [], []
    for _ in range(periods):
        readings.append(robot.step())
        truths.append(robot.truth)
    return readings, truths


def wrench_errors(readings, truths, foot: str) -> np.ndarray:
    """(n, 6) what a foot sensor reads beside what there is."""
    messages = [getattr(reading, f"{foot}_wrench") for reading in readings]
    read_values = np.array([[*m.force, *m.torque] for m in messages])
    return read_values - np.array([getattr(truth, f"{foot}_wrench") for truth in truths])


def test_white_noise_of_encoders_is_as_large_as_stated(standing):
    readings, truths = read(standing, 200, encoder_noise=3e-4)
    errors = np.array([r.joint_states.position - t.q for r, t in zip(readings, truths, strict=True)])
    assert errors.std() == pytest.approx(3e-4, rel=0.05) and abs(errors.mean()) < 3e-5
    assert abs(np.corrcoef(errors[:-1, 3], errors[1:, 3])[0, 1]) < 0.25


def test_torques_can_come_from_the_deflection_and_then_hold_its_errors(standing):
    readings, truths = read(standing, 5, torque_source="deflection", encoder_noise=1e-3)
    for reading, truth in zip(readings, truths, strict=True):
        error = reading.joint_states.position - truth.q
        expected = K * (truth.motor_q - truth.q - error) + D * (truth.motor_qd - reading.joint_states.velocity)
        assert reading.joint_states.effort == pytest.approx(expected, abs=1e-6)


def test_torque_sensors_have_gains_of_their_own(standing):
    readings, truths = read(standing, 3, torque_gain=0.05)
    gains = [r.joint_states.effort / t.tau for r, t in zip(readings, truths, strict=True)]
    assert gains[0] == pytest.approx(gains[2], rel=1e-9)
    assert 0.01 < (gains[0] - 1.0).std() < 0.12


def test_zeros_of_foot_sensors_are_constant_within_their_bound_and_drawn_by_the_seed(standing):
    zeros = [wrench_errors(*read(standing, 4, seed=seed, wrench_zero=200.0), "left") for seed in range(6)]
    for zero in zeros:
        assert np.ptp(zero, axis=0) == pytest.approx(np.zeros(6), abs=1e-9)
    forces, moments = np.array([z[0, :3] for z in zeros]), np.array([z[0, 3:] for z in zeros])
    assert 100.0 < np.abs(forces).max() <= 200.0 and np.abs(moments).max() <= 10.0


def test_cross_talk_and_gains_are_linear_in_the_load(standing):
    for option in ({"cross_talk": 0.02}, {"wrench_gain": 0.02}):
        errors = wrench_errors(*read(standing, 2, **option), "right")
        assert 0.0 < np.abs(errors[0, :3]).max() < 0.1 * 86.0  # half the weight


def test_gains_are_those_of_a_robot_and_zeros_those_of_a_recording(standing):
    gains = {"gains_seed": 7, "wrench_gain": 0.05, "cross_talk": 0.02}
    first, second = (wrench_errors(*read(standing, 3, seed=seed, **gains), "left") for seed in (1, 2))
    assert np.abs(first).max() > 1.0
    np.testing.assert_allclose(first, second, atol=1e-9)
    other = wrench_errors(*read(standing, 3, seed=1, **{**gains, "gains_seed": 8}), "left")
    assert np.abs(other - first).max() > 1.0
    zeros = [wrench_errors(*read(standing, 1, seed=seed, gains_seed=7, wrench_zero=100.0), "left") for seed in (1, 2)]
    assert np.abs(zeros[0] - zeros[1]).max() > 1.0


@pytest.mark.parametrize("engine", ["mujoco", "drake"])
def test_a_foot_sensor_that_averages_reads_the_mean_of_the_steps_of_a_period(standing, engine):
    if engine == "drake":
        pytest.importorskip("pydrake")

    def swaying(times):
        theta, rate = standing(times)
        return theta + 0.01 * np.sin(40.0 * times)[:, None], rate + 0.4 * np.cos(40.0 * times)[:, None]

    def felt(instant: int, **options) -> tuple[list[int], np.ndarray]:
        robot = VirtualRobot(COMAN, SensorOptions.exact(**options), engine=engine)
        robot.reset(swaying, standing.start, settle_s=0.1)
        robot.sensors.phase["left_wrench"] = robot._sampled.at[1] = instant
        messages = [robot.step().left_wrench for _ in range(6)]
        return [m.stamp_ns for m in messages], np.array([[*m.force, *m.torque] for m in messages])

    steps = range(VirtualRobot(COMAN, SensorOptions.exact()).sensors.steps)
    stamps, each = zip(*(felt(k) for k in steps), strict=True)
    assert np.ptp(each, axis=0)[1:, 2].max() > 0.1  # the force changes within a period
    middle, mean = felt(steps[-1], wrench_average=True)
    assert mean[1:] == pytest.approx(np.mean(each, axis=0)[1:], abs=1e-9)
    assert middle == [sum(each) // len(steps) for each in zip(*stamps, strict=True)]


def test_streams_can_be_slower_than_the_robot(standing):
    readings, _ = read(standing, 60, joints_every=2, wrench_every=5, imu_every=3)
    counts = {name: sum(getattr(r, name) is not None for r in readings) for name in
              ("joint_states", "motor_states", "left_wrench", "right_wrench", "imu")}  # fmt: skip
    assert counts == {"joint_states": 30, "motor_states": 30, "left_wrench": 12, "right_wrench": 12, "imu": 20}


@pytest.mark.parametrize(
    "option", [{"torque_source": "thought"}, {"wrench_every": 0}, {"encoder_noise": -1.0}, {"wrench_zero": -5.0}]
)
def test_options_that_are_not_possible_are_refused(option):
    with pytest.raises(ConfigError, match="allowed"):
        SensorOptions(**option)


# --- imperfections ---


def test_imperfections_are_one_robots_in_every_recording_and_grow_with_their_amount():
    one, same, other = (Imperfections(seed=seed, amount=1.0).drawn(COMAN) for seed in (3, 3, 4))
    half = Imperfections(seed=3, amount=0.5).drawn(COMAN)
    for name, value in one.items():
        assert np.array_equal(value, same[name])
        if name not in ("eccentric_per_turn", "eccentric_phase"):
            assert not np.array_equal(value, other[name])
            nominal = 1.0 if name.endswith("gain") else 0.0
            assert np.asarray(half[name]) - nominal == pytest.approx(0.5 * (np.asarray(value) - nominal))


@pytest.mark.parametrize("seed", range(5))
def test_imperfections_stay_small(seed):
    found = Imperfections(seed=seed).drawn(COMAN)
    assert np.all((found["play"] > 0.0) & (found["play"] <= 1.2e-3))
    assert np.all((found["friction"] > 0.0) & (found["friction"] <= 0.2))
    assert np.abs(found["slope"]).max() <= 3 * 0.0045
    assert max(found["wrench_late"]) <= 4e-3 and found["delay"] <= 2e-3


def test_joints_of_the_upper_body_have_imperfections_too_and_leave_those_of_the_legs():
    whole = with_upper_body(COMAN)
    legs, both = Imperfections(seed=3).drawn(COMAN), Imperfections(seed=3).drawn(whole)
    for name in ("play", "lag", "encoder_zero", "eccentricity", "torque_gain", "eccentric_per_turn"):
        assert both[name].shape == (24,) and np.array_equal(both[name][:12], legs[name])
    assert np.all(both["play"][12:] > 0.0)
    assert 0.0 < both["friction"][-1] < 0.3 * both["friction"][12:15].max()  # elbow against waist


def test_play_in_every_joint_is_a_dead_zone(standing):
    imperfections = Imperfections(seed=2)
    robot = VirtualRobot(COMAN, SensorOptions.exact(), [imperfections])
    robot.reset(standing, settle_s=0.1)
    play = imperfections.drawn(COMAN)["play"]
    inside, outside = 0.4 * play, 0.01 * np.ones(12)
    still, springs = np.zeros(12), SpringLaws.of(imperfections.spring_laws(), 12)
    assert springs.torque(0.0, inside, still) == pytest.approx(-K * inside)  # transmits nothing
    assert springs.torque(0.0, outside, still) == pytest.approx(-K * 0.5 * play)
    assert springs.torque(0.0, -outside, still) == pytest.approx(K * 0.5 * play)


def test_sensors_of_a_robot_on_its_sloping_floor_agree_with_its_tilt(standing):
    imperfections = Imperfections(seed=2)
    readings, truths = read(standing, 2, [imperfections])
    roll, pitch = imperfections.drawn(COMAN)["slope"]
    measured, true = readings[-1].imu.orientation, truths[-1].base_orientation
    assert 2.0 * (measured[:2] - true[:2]) == pytest.approx([roll, pitch], abs=1e-4)
    encoders = readings[-1].joint_states.position - truths[-1].q
    assert 1e-4 < np.abs(encoders).max() < 5e-3


def test_a_late_motor_command_arrives_with_delay_and_lag(standing):
    imperfections = Imperfections(seed=5)
    robot = VirtualRobot(COMAN, SensorOptions.exact(), [imperfections])
    robot.reset(standing, settle_s=0.1)
    dt, drawn = robot.model.opt.timestep, imperfections.drawn(COMAN)
    before = imperfections.move_motors(np.zeros(1), np.zeros((400, 12)), np.zeros((400, 12)))[0]
    ramp = np.outer(dt * np.arange(1, 401), np.ones(12))
    after, rate = imperfections.move_motors(np.zeros(1), ramp, np.ones_like(ramp))
    assert before[-1] == pytest.approx(np.zeros(12), abs=1e-6)
    behind = (ramp - after)[-1]
    assert behind == pytest.approx(drawn["lag"] + round(drawn["delay"] / dt) * dt, abs=1e-6)
    assert rate[-1] == pytest.approx(np.ones(12), abs=1e-3)


def test_two_imperfect_robots_are_not_alike(standing):
    q = [read(standing, 1, [Imperfections(seed=seed)])[1][0].q for seed in (0, 1)]
    assert np.abs(q[0] - q[1]).max() > 1e-4


def test_imperfections_touch_only_what_they_override():
    assert overrides([Imperfections()], "apply") == [] and overrides([Imperfections()], "bear") == []
    assert replace(Imperfections(seed=1), amount=2.0).to_dict()["parameters"] == {"seed": 1, "amount": 2.0}
