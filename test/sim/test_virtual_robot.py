# SPDX-License-Identifier: BSD-3-Clause
"""The virtual robot against closed forms and against a second description of the same machine."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from conftest import ROOT
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from sim_runs import Rates

from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.gait.parameters import GAITS
from coman_reduced_model.errors import ConfigError, OutputError
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.motors import MotorOptions
from coman_reduced_model.sim.record import load_truth, record, robot_gait, suiting
from coman_reduced_model.sim.robot_table import COMAN, ROBOTS
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import START_NS, VirtualRobot

G = 9.81
COUNT = 2.0 * np.pi / 4096.0
K, D = COMAN.joint_array(COMAN.stiffness), COMAN.joint_array(COMAN.damping)
STREAMS = ("joint_states", "motor_states", "left_wrench", "right_wrench", "imu")


class Run:
    """A motion gone through with default sensors: readings and truths, period by period."""

    def __init__(self, robot: VirtualRobot, motion, seconds: float) -> None:
        robot.reset(motion)
        self.robot, self.readings, self.truths = robot, [], []
        while robot.t < seconds - 1e-9 and not robot.fallen:
            self.readings.append(robot.step())
            self.truths.append(robot.truth)

    def truth(self, name: str) -> np.ndarray:
        return np.array([getattr(truth, name) for truth in self.truths])

    def messages(self, stream: str) -> list:
        return [m for r in self.readings if (m := getattr(r, stream)) is not None]


@pytest.fixture(scope="module")
def walked(planned) -> Run:
    motion, _ = planned
    return Run(VirtualRobot(COMAN, seed=3), motion, motion.end)


@pytest.fixture(scope="module")
def fast(planned) -> Run:
    """The first two steps, by perfect sensors at 1 kHz."""
    motion, _ = planned
    return Run(VirtualRobot(COMAN, SensorOptions.exact(rate_hz=1000.0)), motion, 2.6)


def stand(motion, seconds: float = 0.5, **options) -> Run:
    options.setdefault("sensors", SensorOptions.exact())
    return Run(VirtualRobot(COMAN, **options), motion, seconds)


# --- standing: closed forms ---


def test_it_stands_still_and_the_floor_carries_its_weight(standing):
    run = stand(standing, 2.0)
    force = run.truth("left_wrench")[:, 2] + run.truth("right_wrench")[:, 2]
    assert force == pytest.approx(17.3 * G, rel=1e-3)
    soles = run.truth("T_left")[:, :3, 3]
    assert np.abs(soles - soles[0]).max() < 2e-5
    assert abs(soles[0, 2]) < 2e-4  # the floor is hard
    assert np.abs(run.truth("com_vel")).max() < 1e-3


def test_springs_deflect_by_the_torque_that_statics_asks_for(standing, legs):
    run = stand(standing)
    truth = run.truths[-1]
    assert truth.tau == pytest.approx(K * (truth.motor_q - truth.q), abs=0.02)
    # Independent of the simulator: inverse dynamics with the ground forces that the simulator claims.
    q = pin.neutral(legs.model)
    q[:3], q[3:7], q[7:] = truth.base_position, truth.base_orientation, truth.q
    pin.forwardKinematics(legs.model, legs.data, q)
    external = pin.StdVec_Force([pin.Force.Zero() for _ in range(legs.model.njoints)])
    for joint, wrench in (("LAnkLat", truth.left_wrench), ("RAnkLat", truth.right_wrench)):
        sole = pin.SE3(np.eye(3), np.array([0.0, 0.0, -COMAN.ankle_height]))
        external[legs.model.getJointId(joint)] = sole.act(pin.Force(wrench))
    tau = pin.rnea(legs.model, legs.data, q, np.zeros(18), np.zeros(18), external)
    assert np.abs(tau[:6]).max() < 0.1  # the trunk hangs on nothing
    assert truth.tau == pytest.approx(tau[6:], abs=0.03)


def test_torques_in_motion_are_those_that_move_the_legs(standing, legs):
    """In the air, without weight, against inverse dynamics: nothing but the springs moves anything.

    Light feet behind stiff dampers accelerate a lot within one step of the integrator.
    """
    robot = VirtualRobot(COMAN, SensorOptions.exact(rate_hz=1000.0))
    robot.model.opt.gravity[:] = 0.0
    start = replace(standing.start, base=standing.start.base + [0.0, 0.0, 1.0])

    def swings(t):
        wave = 2.0 * np.pi * 5.0 * np.asarray(t)[:, None] - np.arange(12)
        begins = np.clip(np.asarray(t)[:, None] / 0.05, 0.0, 1.0)
        return start.q[0] + begins * 0.05 * np.sin(wave), begins * 0.05 * 2.0 * np.pi * 5.0 * np.cos(wave)

    robot.reset(swings, start, settle_s=0.0)
    truths = []
    while robot.t < 0.3:
        robot.step()
        truths.append(robot.truth)
    q = [np.concatenate([t.base_position, t.base_orientation, t.q]) for t in truths]
    dt, model, data = 0.001, legs.model, legs.data
    v = [pin.difference(model, a, b) / dt for a, b in pairwise(q)]  # halfway between
    off, size = [], []
    for i in range(100, len(q) - 1):
        needed = pin.rnea(model, data, q[i], 0.5 * (v[i - 1] + v[i]), (v[i] - v[i - 1]) / dt)
        gravity = pin.computeGeneralizedGravity(model, data, q[i])
        off.append(truths[i].tau - (needed - gravity)[6:])
        size.append(truths[i].tau)
    assert np.abs(size).max() > 2.0
    assert np.abs(off).max() < 0.05


def test_perfect_sensors_tell_the_truth(standing):
    run = stand(standing, 0.2)
    for reading, truth in zip(run.readings, run.truths, strict=True):
        joints, motors, imu = reading.joint_states, reading.motor_states, reading.imu
        assert joints.names == COMAN.joint_names
        assert joints.stamp_ns == motors.stamp_ns == imu.stamp_ns == START_NS + round(1e9 * truth.t)
        for value, true in (
            (joints.position, truth.q),
            (joints.velocity, truth.qd),
            (joints.effort, truth.tau),
            (motors.position, truth.motor_q),
            (motors.velocity, truth.motor_qd),
            (np.append(reading.left_wrench.force, reading.left_wrench.torque), truth.left_wrench),
            (np.append(reading.right_wrench.force, reading.right_wrench.torque), truth.right_wrench),
            (imu.orientation, truth.base_orientation),
        ):
            assert value == pytest.approx(true, abs=1e-12)
        assert imu.linear_acceleration[2] == pytest.approx(G, abs=0.01)


def test_the_wrench_can_be_told_at_the_sensor(standing):
    sole = stand(standing, 0.05).readings[-1].left_wrench
    sensor = stand(standing, 0.05, sensors=SensorOptions.exact(wrench_frame="sensor")).readings[-1].left_wrench
    assert (sole.frame_id, sensor.frame_id) == ("l_sole", "l_ft")
    assert sensor.force == pytest.approx(sole.force, abs=1e-9)
    above = np.array([0.0, 0.0, COMAN.ankle_height - COMAN.sensor_below_ankle])
    assert sensor.torque == pytest.approx(sole.torque - np.cross(above, sole.force), abs=1e-9)


def test_a_robot_without_motor_encoders_torques_or_velocities(standing):
    options = SensorOptions(motor_states=False, effort=False, velocity="none", drop=0.0)
    reading = stand(standing, 0.02, sensors=options).readings[0]
    assert (
        reading.motor_states is None and reading.joint_states.effort is None and reading.joint_states.velocity is None
    )


@pytest.mark.parametrize(
    "option", [{"rate_hz": 300.0}, {"rate_hz": 2000.0}, {"drop": -0.1}, {"velocity": "guess"}, {"wrench_frame": "odom"}]
)
def test_impossible_sensors_are_refused(option):
    with pytest.raises(ConfigError, match=rf"{next(iter(option))}.*allowed"):
        VirtualRobot(COMAN, SensorOptions(**option))


# --- walking ---


def test_it_walks_fourteen_steps_without_feedback(walked, planned):
    _, plan = planned
    assert not walked.robot.fallen
    t, left, right = walked.truth("t"), walked.truth("T_left"), walked.truth("T_right")
    point = plan.sample_many(t)
    assert point.step[-1] == 13
    error = (left - point.T_odom_left)[-1, :3, 3]
    assert np.abs(error[:2]).max() < 0.05  # it leans back a little in each step and so goes farther
    tilt = np.degrees(2.0 * np.arcsin(np.abs(walked.truth("base_orientation")[:, :2]).max(axis=0)))
    assert tilt.max() < 3.0
    for sole, phase in ((left, Phase.RIGHT), (right, Phase.LEFT)):
        planned_height = np.maximum(point.T_odom_left, point.T_odom_right)[:, 2, 3]
        middle = (point.phase == phase) & (planned_height > 0.029)
        assert sole[middle, 2, 3].min() > 0.02


def test_forces_and_motion_of_the_walk_obey_newton(fast):
    """Momentum of all links against what floor and gravity gave them."""
    t, velocity = fast.truth("t"), fast.truth("com_vel")
    force = sum(
        np.einsum("nij,nj->ni", fast.truth(f"T_{side}")[:, :3, :3], fast.truth(f"{side}_wrench")[:, :3])
        for side in ("left", "right")
    )
    force[:, 2] -= COMAN.mass * G
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(t)[:, None]
    impulse = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    momentum = COMAN.mass * (velocity - velocity[0])
    assert np.abs(momentum).max() > 1.5
    assert np.abs(impulse - momentum).max() < 0.05  # [Ns]


@pytest.mark.slow
def test_springs_obey_their_law_in_the_walk(planned):
    motion, rates = planned[0], Rates()
    walked = Run(VirtualRobot(COMAN, disturbances=[rates], seed=3), motion, motion.end)
    rate = walked.truth("motor_qd") - rates.after(walked.truths)
    tau = K * (walked.truth("motor_q") - walked.truth("q")) + D * rate
    assert walked.truth("tau") == pytest.approx(tau, abs=1e-9)
    assert np.abs(walked.truth("motor_q") - walked.truth("q"))[:, 3].max() > 0.03  # soft knees


def test_default_sensors_have_the_stated_errors(walked):
    joints = [(r.joint_states, r.left_wrench, truth) for r, truth in zip(walked.readings, walked.truths, strict=True)]
    angle = np.array([m.position - truth.q for m, _, truth in joints if m])
    assert np.abs(angle).max() <= 0.5 * COUNT + 1e-12
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(COUNT / np.sqrt(12.0), rel=0.1)
    effort = np.array([m.effort - truth.tau for m, _, truth in joints if m])
    assert effort.std(axis=0) == pytest.approx(0.05, rel=0.15)
    quiet = [m for m, _, truth in joints if m and truth.t < 0.8]
    assert np.array([m.velocity for m in quiet]).std() < 0.04
    force = np.array([w.force for _, w, truth in joints if w and truth.t < 0.8])
    assert force.std(axis=0) == pytest.approx([1.0, 1.0, 1.5], rel=0.3)


def test_stamps_jitter_and_messages_get_lost_as_often_as_stated(walked):
    periods = len(walked.readings)
    lost = np.array([periods - len(walked.messages(stream)) for stream in STREAMS])
    assert 0 < lost.sum() < 3 * 5 * periods * 0.002
    for stream in STREAMS:
        stamps = np.array([m.stamp_ns for m in walked.messages(stream)])
        assert np.all(np.diff(stamps) > 0)
        offset = (stamps - START_NS) % 5_000_000 / 1e6  # [ms] into the period
        phase = walked.robot.sensors.phase.get(stream, 0) * 0.5
        error = (offset - phase + 2.5) % 5.0 - 2.5
        assert error.std() == pytest.approx(0.1, rel=0.15) and np.abs(error).max() <= 0.3001
    assert [m.stamp_ns for m in walked.messages("joint_states")][:5] == [
        m.stamp_ns for m in walked.messages("motor_states")
    ][:5]


def test_link_positions_give_the_true_com(walked, legs):
    """What a predictor measures, by an independent model, against the simulator: the floor of what follows."""
    sole = legs.model.getFrameId("l_sole")

    def com(q):
        pin.centerOfMass(legs.model, legs.data, np.concatenate([[0, 0, 0, 0, 0, 0, 1.0], q]))
        return pin.updateFramePlacement(legs.model, legs.data, sole).actInv(legs.data.com[0])

    exact, noisy = [], []
    for reading, truth in list(zip(walked.readings, walked.truths, strict=True))[::10]:
        true = np.linalg.inv(truth.T_left) @ np.append(truth.com, 1.0)
        exact.append(com(truth.q) - true[:3])
        if reading.joint_states:
            noisy.append(com(reading.joint_states.position) - true[:3])
    assert np.abs(exact).max() < 1e-6
    assert np.sqrt(np.mean(np.square(noisy), axis=0)).max() < 0.0004


def test_a_seed_makes_one_walk_and_noise_does_not_touch_the_physics(planned):
    motion, _ = planned
    first, again, other = (
        Run(VirtualRobot(COMAN, SensorOptions(rate_hz=rate), seed=seed), motion, 0.2)
        for rate, seed in ((200.0, 5), (200.0, 5), (200.0, 6))
    )
    for stream in ("joint_states", "left_wrench", "imu"):
        stamps = [[m.stamp_ns for m in run.messages(stream)] for run in (first, again, other)]
        assert stamps[0] == stamps[1] != stamps[2]
    efforts = [np.array([m.effort for m in run.messages("joint_states")]) for run in (first, again)]
    assert np.array_equal(*efforts)
    assert np.array_equal(first.truth("q"), other.truth("q"))


def test_the_rate_of_the_sensors_does_not_change_the_walk(planned, fast):
    motion, _ = planned
    slow = Run(VirtualRobot(COMAN, SensorOptions.exact()), motion, 2.6)
    assert fast.truth("q")[::5] == pytest.approx(slow.truth("q"), abs=1e-9)


# --- motors ---


def test_motors_with_a_loop_yield_under_load(standing):
    truth = stand(standing, motors=MotorOptions(kp=5000.0)).truths[-1]
    reference = standing(np.array([truth.t]))[0][0]
    assert reference - truth.motor_q == pytest.approx(truth.tau / 5000.0, abs=2e-5)


# --- bags ---


def test_a_bag_and_its_truth(tmp_path):
    said = []
    result = record("test1", tmp_path / "walk", duration_s=3.0, seed=2, progress=lambda f, s: said.append(f))
    assert result.fallen_s is None and result.duration_s == pytest.approx(2.9, abs=0.5)
    assert said == sorted(said) and said[-1] == 1.0
    assert sorted(p.name for p in result.bag.iterdir()) == ["metadata.yaml", "walk.mcap"]
    truth = load_truth(result.truth)
    assert len(truth["t"]) == len(truth["com"]) == round(200 * result.duration_s)
    assert truth["contact"][:20].all() and not truth["contact"].all()
    with AnyReader([result.bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert counts == result.messages
        assert set(counts) == {
            *("/robot_description", "/joint_states", "/motor_states", "/left_foot/wrench", "/right_foot/wrench"),
            *("/imu/data", "/com/reference"),
        }
        latched = next(c for c in reader.connections if c.topic == "/robot_description")
        assert latched.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        log_times = []
        for connection, log_time, raw in reader.messages():
            log_times.append(log_time)
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/robot_description":
                assert message.data == urdf(COMAN)
            elif connection.topic == "/com/reference":
                assert message.header.frame_id == "odom" and len(message.preview_position) == 75
        assert log_times == sorted(log_times)
    with pytest.raises(OutputError, match="--force"):
        record("test1", tmp_path / "walk", duration_s=3.0)


def test_the_same_seed_makes_the_same_bag(tmp_path):
    raw = []
    for name in ("a", "b"):
        record("stand", tmp_path / name, duration_s=1.0, seed=4)
        with AnyReader([tmp_path / name]) as reader:
            raw.append([(c.topic, t, bytes(data)) for c, t, data in reader.messages()])
    assert raw[0] == raw[1]


def test_what_suits_a_robot_leaves_what_makes_a_gait():
    assert "step_width_m" in suiting(COMAN, "test1") and "step_width_m" not in suiting(COMAN, "wide")


@pytest.mark.parametrize("bad", [{"robot": "asimo"}, {"walk": "moonwalk"}, {"duration_s": 0.5}])
def test_what_cannot_be_recorded_leaves_nothing_behind(tmp_path, bad):
    with pytest.raises(ConfigError, match="allowed"):
        record(**{"walk": "test1", "out": tmp_path / "bag", **bad})
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["test1", "test2", "stand"])
def test_the_shipped_bags_are_of_this_robot_and_hold_no_truth(name):
    folder = ROOT / "bags" / name
    assert {path.suffix for path in folder.iterdir()} == {".mcap", ".yaml"}
    with AnyReader([folder]) as reader:
        description = [c for c in reader.connections if c.topic == "/robot_description"]
        connection, _, raw = next(reader.messages(description))
        assert reader.deserialize(raw, connection.msgtype).data == urdf(COMAN)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_walks_every_gait(robot):
    table = ROBOTS[robot]
    for name in GAITS:
        motion, _ = plan_motion(table, plan_walk(replace(robot_gait(table, name), stand_after_s=0.5)))
        body = VirtualRobot(table, SensorOptions.exact(rate_hz=100.0))
        body.reset(motion)
        while body.t < motion.end and not body.fallen:
            body.step()
        assert not body.fallen, f"{robot} falls in {name} at {body.t:.2f} s"
