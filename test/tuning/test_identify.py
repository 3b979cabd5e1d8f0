# SPDX-License-Identifier: BSD-3-Clause
"""Springs from experiments: closed forms on made data, and the virtual robot's own springs found again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import recording as recorded_elsewhere

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.types import Foot, Phase, Prediction, Sample, SupportState
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.errors import BagError
from coman_reduced_model.resources import bag_path
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.record import load_truth
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.topics import TopicNames
from coman_reduced_model.tuning.identify import fit_decay, free_oscillations, identified_config, identify, pendulum
from coman_reduced_model.tuning.recording import JoinedBag, motor_side, read_all
from coman_reduced_model.tuning.statistics import hac_covariance, quantile

COUNT = 2.0 * np.pi / 4096
CONFIG = Config()


@pytest.fixture(scope="module")
def robot():
    return Robot(urdf(COMAN), CONFIG.robot)


def recording(robot, t, q, motor, tau, phase=Phase.DOUBLE, name="bag"):
    samples = [
        Sample(1_000_000_000 + round(1e9 * t[i]), q[i], np.zeros(12), None if tau is None else tau[i], motor[i], None)
        for i in range(len(t))
    ]
    nothing = np.full(3, np.nan)
    support = SupportState(phase, Foot.LEFT)
    said = Prediction(0, "", support, nothing, nothing, nothing, nothing, nothing, nothing, np.eye(4), [], 0)
    return JoinedBag(Path(name), robot, samples, [replace(said, stamp_ns=s.stamp_ns) for s in samples], ())


def slow_load(robot, stiffness, damping, torque=8.0, offset=0.3, seed=0):
    """Every joint under a slow torque of its own while it moves through many counts; sensors as the default ones."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, 0.005)
    frequency = 0.11 + 0.017 * np.arange(12)
    angle = 2.0 * np.pi * frequency * t[:, None]
    deflection = torque / stiffness * np.sin(angle)
    tau = stiffness * deflection + damping * torque / stiffness * 2.0 * np.pi * frequency * np.cos(angle)
    q = 0.2 * np.sin(2.0 * np.pi * 0.07 * t[:, None] + np.arange(12))
    counted = COUNT * np.round(q / COUNT)
    measured = tau + offset + 0.05 * rng.standard_normal(tau.shape)
    return recording(robot, t, counted, q + deflection, measured)


def by_leg(robot):
    """Nominal springs in the order of the robot's joints."""
    legs = {}
    for leg in (CONFIG.robot.left, CONFIG.robot.right):
        legs |= dict(zip(leg.joints, zip(leg.stiffness, leg.damping, strict=True), strict=True))
    return np.array([legs[name] for name in robot.joint_names]).T


def test_static_stiffness_is_found_within_its_interval(robot):
    scale = np.linspace(0.8, 1.2, 12)
    stiffness, damping = by_leg(robot)
    joints = identify([slow_load(robot, scale * stiffness, damping)], CONFIG)
    assert [joint.name for joint in joints] == [*CONFIG.robot.left.joints, *CONFIG.robot.right.joints]
    true, dampers = (dict(zip(robot.joint_names, each, strict=True)) for each in (scale * stiffness, damping))
    for joint in joints:
        assert joint.stiffness.value == pytest.approx(true[joint.name], rel=0.03)
        assert joint.damping is None or joint.damping.value == pytest.approx(dampers[joint.name], rel=0.1)
    # Twelve intervals of 95 %: now and then one lies beside.
    assert sum(joint.stiffness.low <= true[joint.name] <= joint.stiffness.high for joint in joints) >= 10


@pytest.mark.slow
@pytest.mark.parametrize("walk", ["test1", "test2", "other_robot/walk_003"])
def test_a_walk_shows_stiffness_and_damping_of_the_soft_joints(walk):
    """Of the shipped walks, and of one that an independent simulation has recorded, whose constants are the same."""
    bag = recorded_elsewhere(walk) if "/" in walk else bag_path(walk)
    recordings = read_all([bag], motor_side(CONFIG), TopicNames(), None, None)
    joints = {joint.name: joint for joint in identify(recordings, CONFIG)}
    for leg in (CONFIG.robot.left, CONFIG.robot.right):
        for name, k, d in zip(leg.joints, leg.stiffness, leg.damping, strict=True):
            if name[1:] in ("KneeSag", "AnkSag"):
                assert joints[name].stiffness.value == pytest.approx(k, rel=0.01)
                assert joints[name].damping.value == pytest.approx(d, rel=0.03)
            else:
                assert joints[name].stiffness is None or joints[name].stiffness.value == pytest.approx(k, rel=0.1)


def test_torque_offsets_differ_from_bag_to_bag_and_do_not_matter(robot):
    stiffness, damping = by_leg(robot)
    bags = [slow_load(robot, stiffness, damping, offset=offset, seed=seed) for seed, offset in ((1, -2.0), (2, 3.0))]
    for joint, true in zip(
        identify(bags, CONFIG), CONFIG.robot.left.stiffness + CONFIG.robot.right.stiffness, strict=True
    ):
        assert joint.stiffness.value == pytest.approx(true, rel=0.03)


def test_joints_that_were_not_excited_are_said_and_keep_their_constants(robot):
    stiffness, damping = by_leg(robot)
    load = slow_load(robot, 1.1 * stiffness, damping)
    still = [robot.joint_names.index(name) for name in ("LHipYaw", "RAnkSag")]
    for sample in load.samples:
        sample.tau[still] = 0.1
        sample.motor_q[still] = sample.q[still] + 0.001
    unmoved = robot.joint_names.index("LHipLat")
    for sample in load.samples:
        sample.q[unmoved] = 0.1
    joints = {joint.name: joint for joint in identify([load], CONFIG)}
    for name in ("LHipYaw", "RAnkSag", "LHipLat"):
        assert joints[name].stiffness is None and "not excited" in joints[name].note
    tuned = identified_config(CONFIG, list(joints.values())).robot
    assert tuned.left.stiffness[2] == CONFIG.robot.left.stiffness[2]
    assert tuned.left.stiffness[3] == pytest.approx(1.1 * CONFIG.robot.left.stiffness[3], rel=0.03)
    assert tuned.left.damping[0] == CONFIG.robot.left.damping[0]  # stiff: hardly excited
    assert tuned.left.damping[3] == pytest.approx(CONFIG.robot.left.damping[3], rel=0.05)


def test_without_torques_or_motors_it_says_so(robot):
    stiffness, damping = by_leg(robot)
    load = slow_load(robot, stiffness, damping)
    for sample in load.samples:
        sample.tau = None
    assert all("no torque in bag" in joint.note for joint in identify([load], CONFIG))
    for sample in load.samples:
        sample.motor_q = None
    with pytest.raises(BagError, match="no motor-side positions"):
        identify([load], CONFIG)


def test_a_bag_without_torques_takes_none_from_the_others(robot):
    stiffness, damping = by_leg(robot)
    load, other = (slow_load(robot, stiffness, damping, seed=seed) for seed in range(2))
    for sample in other.samples:
        sample.tau = None
    alone, both = (identify(bags, CONFIG) for bags in ([load], [load, other]))
    assert [joint.stiffness for joint in both] == [joint.stiffness for joint in alone]


@pytest.mark.parametrize("jump", [1.7e9, 300.0, -10.0])
def test_a_clock_that_is_set_while_it_records_does_no_harm(robot, jump):
    stiffness, damping = by_leg(robot)
    load = slow_load(robot, stiffness, damping)
    for sample in load.samples[4000:]:
        sample.stamp_ns += round(1e9 * jump)
    for joint in identify([load], CONFIG):
        assert joint.stiffness is not None and not joint.stiffness.loose


def swinging(robot, damping, stiffness=200.0, joint="LAnkSag", stiffer=1.0, seed=0):
    """A pendulum about the ankle of the left leg, pushed every 4 s, and its true sigma and omega."""
    index = robot.joint_names.index(joint)
    posture = np.zeros(12)
    posture[[robot.joint_names.index(name) for name in ("LHipSag", "LKneeSag", "LAnkSag")]] = -0.4, 0.8, -0.4
    t = np.arange(0.0, 34.0, 0.005)
    still = recording(robot, t[:2], np.tile(posture, (2, 1)), np.tile(posture, (2, 1)), None, Phase.LEFT)
    inertia, gravity = pendulum(robot, still, Foot.LEFT, joint)
    sigma = damping / (2.0 * inertia)
    omega = np.sqrt((stiffer * stiffness + gravity) / inertia - sigma**2)
    rng = np.random.default_rng(seed)
    x = np.zeros_like(t)
    for push, size in zip(np.arange(1.0, 33.0, 4.0), rng.uniform(0.015, 0.03, 8), strict=True):
        after = np.clip(t - push, 0.0, None)
        x += size * np.exp(-sigma * after) * np.sin(omega * after)
    q = np.tile(posture, (len(t), 1))
    q[:, index] -= x
    motor = np.tile(posture + 0.02, (len(t), 1))
    return recording(robot, t, COUNT * np.round(q / COUNT), motor, None, Phase.LEFT, "decay"), sigma, omega


def test_damping_is_found_within_its_interval(robot):
    bag, sigma, omega = swinging(robot, damping=4.4)
    joints = {joint.name: joint for joint in identify([bag], CONFIG)}
    found = joints["LAnkSag"].damping
    assert found.value == pytest.approx(4.4, rel=0.15)
    assert found.low <= 4.4 <= found.high
    assert "inertia of the URDF" in joints["LAnkSag"].note
    assert all(joint.damping is None for name, joint in joints.items() if name != "LAnkSag")


def test_a_known_stiffness_corrects_the_inertia_of_the_pendulum(robot):
    # The floor yields: the pendulum swings slower than the spring alone would let it.
    bag, *_ = swinging(robot, damping=4.4 / 1.05**1.5, stiffer=1.0 / 1.05)
    stiffness, damping = by_leg(robot)
    joints = {joint.name: joint for joint in identify([bag, slow_load(robot, stiffness, damping)], CONFIG)}
    assert joints["LAnkSag"].damping.value == pytest.approx(4.4, rel=0.03)
    assert "for floor and other joints" in joints["LAnkSag"].note


def test_a_decay_is_fitted_exactly_where_nothing_disturbs_it():
    t = np.arange(0.0, 2.0, 0.005)
    x = np.exp(-1.7 * t) * (0.02 * np.cos(11.0 * t) - 0.01 * np.sin(11.0 * t)) + 0.3
    assert fit_decay(t, x) == pytest.approx((1.7, 11.0), rel=1e-4)


def test_standing_still_has_no_oscillations(robot):
    t = np.arange(0.0, 10.0, 0.005)
    assert free_oscillations(t, np.zeros_like(t)) == []
    q = np.zeros((len(t), 12))
    joints = identify([recording(robot, t, q, q, None, Phase.LEFT, "still")], CONFIG)
    assert any("free oscillations in still" in joint.note for joint in joints)
    assert all(joint.damping is None for joint in joints)


def test_intervals_hold_for_coloured_noise():
    """White-noise intervals would hold the truth in about half of these cases."""
    rng = np.random.default_rng(5)
    inside, n, lags = 0, 400, 30
    x = np.sin(np.arange(n) / 40.0)
    J = np.column_stack([x, np.ones(n)])
    for _ in range(200):
        noise = np.zeros(n)
        shocks = rng.standard_normal(n)
        for i in range(1, n):
            noise[i] = 0.85 * noise[i - 1] + shocks[i]
        y = 2.0 * x + noise
        fit = np.linalg.lstsq(J, y, rcond=None)[0]
        error = np.sqrt(hac_covariance(J, y - J @ fit, lags)[0, 0])
        inside += abs(fit[0] - 2.0) < quantile(n / lags) * error
    assert 0.88 * 200 <= inside <= 199


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_springs_of_a_virtual_robot_are_found_again(tmp_path, capsys):
    """The whole way, as a user goes it: two experiments recorded, one command, a configuration that loads."""
    common = ["--hide", "scatter:seed=7,spring=0.08,mass=0.01,com=0.001"]
    load, decay = tmp_path / "load", tmp_path / "decay"
    assert run(["record", "--gait", "load", "--out", str(load), "--seed", "70", "--duration", "40", *common]) == 0
    decayed = [
        "record",
        "--gait",
        "decay",
        "--joint",
        "RKneeSag",
        "--out",
        str(decay),
        "--seed",
        "71",
        "--duration",
        "24",
        *common,
    ]
    assert run(decayed) == 0
    capsys.readouterr()
    out = tmp_path / "identified.yaml"
    assert run(["identify", str(load), str(decay), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    truth = load_truth(tmp_path / "load.truth.npz")
    true = dict(zip(truth["joint_names"], truth["stiffness"], strict=True))
    inside = 0
    for name, joint in result["joints"].items():
        found = joint["stiffness_Nm_per_rad"]
        assert found["value"] == pytest.approx(true[name], rel=0.03), name
        inside += found["interval"][0] <= true[name] <= found["interval"][1]
    assert inside >= 10
    index = list(truth["joint_names"]).index("RKneeSag")
    found = result["joints"]["RKneeSag"]["damping_Nms_per_rad"]
    assert found["value"] == pytest.approx(truth["damping"][index], rel=0.15)
    assert found["interval"][0] <= truth["damping"][index] <= found["interval"][1]
    tuned = load_config(out).robot.right
    assert tuned.damping[3] == pytest.approx(found["value"], rel=1e-5)
    assert run(["identify", str(load), "--out", str(out)]) == 2
    assert "exists; --force" in capsys.readouterr().err


def test_wrong_experiments_are_refused_in_one_line(tmp_path, capsys):
    out = ["--out", str(tmp_path / "bag")]
    for arguments, said in (
        (["--gait", "decay", "--joint", "LHipSag"], "allowed: LKneeSag"),
        (["--gait", "decay"], "allowed: LKneeSag"),
        (["--gait", "test1", "--joint", "LKneeSag"], "only with --gait decay"),
    ):
        assert run(["record", *arguments, *out]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1
