# SPDX-License-Identifier: BSD-3-Clause
"""Both physics engines where they must agree with closed forms, with Pinocchio and with each other."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.errors import ConfigError, EngineError
from coman_reduced_model.sim.contact import Contact, Floor
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import VirtualRobot

G, WEIGHT = 9.81, 17.3 * 9.81
drake = pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="drake is not installed")
ENGINES = ["mujoco", pytest.param("drake", marks=drake)]


def run(engine: str, motion, seconds: float, hide: str = "", table=COMAN, settle: float = 0.3, **options):
    """A robot with exact sensors after some seconds, and its truths."""
    hidden = [parse(text) for text in filter(None, hide.split("+"))]
    robot = VirtualRobot(table, SensorOptions.exact(), hidden, engine=engine, **options)
    robot.reset(motion, settle_s=settle)
    return robot, steps(robot, seconds)


def steps(robot: VirtualRobot, seconds: float) -> list:
    truths = []
    for _ in range(round(seconds / robot.period)):
        robot.step()
        truths.append(robot.truth)
    return truths


def thrown(engine: str, motion, hide: str = "") -> VirtualRobot:
    """A robot in the air, springs released: it turns and shakes while it falls."""
    robot, _ = run(engine, motion, 0.05, hide)
    robot.data.qpos[2] += 2.0
    robot.data.qvel[:6] = [0.4, -0.2, 1.0, 0.5, -0.8, 0.3]
    robot._engine.reset(robot.data)  # noqa: SLF001
    return robot


@pytest.mark.parametrize("engine", ENGINES)
def test_in_free_fall_the_com_flies_a_parabola_and_nothing_touches_the_feet(engine, standing):
    robot = thrown(engine, standing)
    truths = steps(robot, 0.3)
    t = np.array([truth.t for truth in truths])
    t -= t[0]
    com = np.array([truth.com for truth in truths])
    start, last = com[0], com[1]
    speed = (last - start) / t[1] + [0.0, 0.0, 0.5 * G * t[1]]
    flown = start + np.outer(t, speed) - np.outer(0.5 * G * t**2, [0.0, 0.0, 1.0])
    # First-order integration: an error of g dt t / 2, and what a step of finite turning leaves.
    assert com == pytest.approx(flown, abs=G * 5e-4 * t[-1])
    assert max(np.abs(truth.left_wrench).max() for truth in truths) == 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_in_the_air_without_dampers_energy_stays(engine, standing):
    """Kinetic energy, height and springs, by Pinocchio: the integrators lose little of what the springs had."""
    robot = thrown(engine, standing, "joint_damping:scale=0.01")
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    data = model.createData()
    order = np.array([model.joints[model.getJointId(name)].idx_v for name in COMAN.joint_names])

    def energy() -> float:
        q, v = np.zeros(model.nq), np.zeros(model.nv)
        q[:3], q[3:7] = robot.data.qpos[:3], robot.data.qpos[[4, 5, 6, 3]]
        R = pin.Quaternion(q[3:7]).toRotationMatrix()
        v[:3], v[3:6] = R.T @ robot.data.qvel[:3], robot.data.qvel[3:6]
        q[order + 1], v[order] = robot.data.qpos[7:], robot.data.qvel[6:]
        springs = 0.5 * float(robot.stiffness @ (robot.motion(np.array([robot.t]))[0][0] - q[order + 1]) ** 2)
        return pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q) + springs

    before = energy()
    kinetic = 0.5 * 17.3 * (0.4**2 + 0.2**2 + 1.0)
    steps(robot, 0.2)
    assert energy() == pytest.approx(before, abs=0.1 * kinetic)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stiff_robot_stands_and_the_floor_carries_it_below_its_com(engine):
    stiff = replace(COMAN, stiffness=dict.fromkeys(COMAN.stiffness, 5e3), damping=dict.fromkeys(COMAN.damping, 20.0))
    standing = plan_motion(stiff, plan_walk(robot_gait(stiff, "stand")))[0]
    _, truths = run(engine, standing, 0.2, table=stiff, settle=0.6)
    last = truths[-1]
    force, moment = np.zeros(3), np.zeros(3)
    for T, wrench in ((last.T_left, last.left_wrench), (last.T_right, last.right_wrench)):
        f = T[:3, :3] @ wrench[:3]
        force += f
        moment += np.cross(T[:3, 3], f) + T[:3, :3] @ wrench[3:]
    assert force == pytest.approx([0.0, 0.0, WEIGHT], abs=0.3)
    assert [-moment[1] / force[2], moment[0] / force[2]] == pytest.approx(last.com[:2], abs=2e-4)
    assert np.linalg.norm(last.com_vel) < 1e-3


@pytest.mark.parametrize("engine", ENGINES)
def test_the_com_is_pinocchios_and_springs_obey_their_law(engine, walking):
    _, truths = run(engine, walking, 1.6)
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    data = model.createData()
    order = np.array([model.joints[model.getJointId(name)].idx_q for name in COMAN.joint_names])
    stiffness, damping = (COMAN.joint_array(values) for values in (COMAN.stiffness, COMAN.damping))
    for truth in truths[-40::8]:
        q = np.zeros(model.nq)
        q[:3], q[3:7], q[order] = truth.base_position, truth.base_orientation, truth.q
        assert truth.com == pytest.approx(pin.centerOfMass(model, data, q), abs=1e-6)
        law = stiffness * (truth.motor_q - truth.q) + damping * (truth.motor_qd - truth.qd)
        assert truth.tau == pytest.approx(law, abs=0.6)  # the damper is implicit


@pytest.mark.parametrize("engine", ENGINES)
def test_the_same_seed_is_the_same_walk(engine, walking):
    def readings():
        robot = VirtualRobot(COMAN, seed=4, engine=engine)
        robot.reset(walking, settle_s=0.2)
        return [robot.step() for _ in range(30)]

    for one, other in zip(readings(), readings(), strict=True):
        for name in ("joint_states", "left_wrench", "imu"):
            a, b = getattr(one, name), getattr(other, name)
            assert (a is None) == (b is None) and (a is None or repr(a) == repr(b))


@drake
@pytest.mark.slow
def test_two_engines_walk_the_same_walk_within_millimetres(walking):
    truths = [run(engine, walking, 2.6, settle=1.0)[1] for engine in ("mujoco", "drake")]
    one, other = (np.array([truth.com for truth in each]) for each in truths)
    assert np.sqrt(np.mean((one - other) ** 2, axis=0)).max() < 2e-3


@drake
def test_soles_sink_into_drakes_floor_by_force_over_modulus(standing):
    """Pressure = modulus * depth / thickness of the layer, evenly below both soles."""
    _, truths = run("drake", standing, 0.1, settle=0.6, contact=Contact(modulus=1e6))
    area = 2.0 * COMAN.foot_width * (COMAN.foot_back + COMAN.foot_front)
    depth = 0.01 * WEIGHT / (1e6 * area)
    last = truths[-1]
    sunk = -0.5 * (last.T_left[2, 3] + last.T_right[2, 3])
    assert sunk == pytest.approx(depth, rel=0.3)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_robot_stands_on_tiles(engine, standing):
    floor = Floor(tile_height=0.002, tile_size=0.3, seed=3)
    _, truths = run(engine, standing, 0.1, settle=0.6, floor=floor)
    last = truths[-1]
    assert last.left_wrench[2] + last.right_wrench[2] == pytest.approx(WEIGHT, abs=2.0)
    for T in (last.T_left, last.T_right):
        assert -0.0025 < T[2, 3] < 0.0012


def test_an_engine_that_is_not_installed_is_said_in_one_line(monkeypatch):
    monkeypatch.delitem(sys.modules, "coman_reduced_model.sim.engines.drake_engine", raising=False)
    monkeypatch.setitem(sys.modules, "pydrake", None)
    monkeypatch.setitem(sys.modules, "pydrake.geometry", None)
    with pytest.raises(ConfigError, match="drake is not installed .pip install drake."):
        VirtualRobot(COMAN, engine="drake")


def test_an_unknown_engine_is_refused():
    with pytest.raises(ConfigError, match="allowed: mujoco, drake"):
        VirtualRobot(COMAN, engine="bullet")


@drake
def test_where_drake_cannot_go_on_it_is_said_in_one_line(standing):
    robot, _ = run("drake", standing, 0.01, settle=0.02)
    robot.data.qvel[2] = np.nan
    robot._engine.reset(robot.data)  # noqa: SLF001
    with pytest.raises(EngineError, match="drake cannot go on"):
        steps(robot, 0.01)


def test_where_mujoco_diverges_it_is_said_in_one_line(standing, monkeypatch, tmp_path):
    """MuJoCo itself would go on from where the robot began, as if it had not fallen."""
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes a log of its own
    robot, _ = run("mujoco", standing, 0.05)
    robot.data.qvel[10] = 1e11
    with pytest.raises(EngineError, match=r"mujoco cannot go on: the simulation diverged at 0\.05 s"):
        robot.step()
    robot.reset(standing, settle_s=0.3)
    robot.step()
