# SPDX-License-Identifier: BSD-3-Clause
"""The virtual robot's description, inverse kinematics and plan."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from conftest import ROOT, child_environment
from hypothesis import given, settings
from hypothesis import strategies as st

from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.sim.describe import mujoco_spec, urdf
from coman_reduced_model.sim.motion import follow, plan_motion, zmp_of
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN, ROBOTS, with_upper_body

TURNED_IMU = replace(with_upper_body(COMAN), name="turned_imu", imu_turn=(0.2, -0.1, 2.0))
TABLES = [*ROBOTS.values(), *(with_upper_body(table) for table in ROBOTS.values()), TURNED_IMU]

# --- the description ---


def test_the_shipped_urdf_is_what_the_table_says():
    assert (ROOT / "config" / "coman.urdf").read_text(encoding="utf-8") == urdf(COMAN), (
        "remake it: python -c 'from coman_reduced_model.sim.describe import urdf; "
        "from coman_reduced_model.sim.robot_table import COMAN; print(urdf(COMAN), end=str())' > config/coman.urdf"
    )


def test_figures_of_the_paper():
    model = pin.buildModelFromXML(urdf(COMAN), pin.JointModelFreeFlyer())
    assert pin.computeTotalMass(model) == pytest.approx(17.3, abs=1e-6)
    legs = [sum(joint.link.mass for joint in COMAN.joints() if joint.name[0] == side) for side in "LR"]
    assert legs == pytest.approx([5.9, 5.9])
    assert COMAN.ankle_height + COMAN.shank + COMAN.thigh + COMAN.trunk.box[2] == pytest.approx(0.671, abs=0.001)
    assert {"base_link", "l_sole", "r_sole", "l_ft", "r_ft", "imu_link"} <= {frame.name for frame in model.frames}


@pytest.mark.parametrize("table", TABLES, ids=[table.name for table in TABLES])
def test_mujoco_and_pinocchio_are_the_same_machine(table):
    model = pin.buildModelFromXML(urdf(table), pin.JointModelFreeFlyer())
    data = model.createData()
    mj = mujoco_spec(table).compile()
    state = mujoco.MjData(mj)
    joints = [model.joints[model.getJointId(name)] for name in table.joint_names]
    index = np.array([joint.idx_v for joint in joints])
    low, high = np.array([joint.limits for joint in table.joints()]).T
    rng = np.random.default_rng(7)
    for _ in range(20):
        quaternion = rng.standard_normal(4)
        quaternion /= np.linalg.norm(quaternion)  # x y z w
        angles, base, rates = rng.uniform(low, high), rng.standard_normal(3), rng.standard_normal(model.nv)
        q, v = pin.neutral(model), np.zeros(model.nv)
        q[:3], q[3:7], q[index + 1] = base, quaternion, angles
        R = pin.Quaternion(quaternion).matrix()
        v[:3], v[3:6], v[index] = (
            R.T @ rates[:3],
            rates[3:6],
            rates[6:],
        )  # MuJoCo: linear in the world, angular in the body
        state.qpos[:] = [*base, *quaternion[[3, 0, 1, 2]], *angles]
        state.qvel[:] = rates
        mujoco.mj_forward(mj, state)
        mujoco.mj_energyVel(mj, state)
        pin.centerOfMass(model, data, q)
        pin.updateFramePlacements(model, data)
        assert state.subtree_com[0] == pytest.approx(data.com[0], abs=1e-9)
        assert state.energy[1] == pytest.approx(pin.computeKineticEnergy(model, data, q, v), rel=1e-8)
        for frame in ("l_sole", "r_sole", "l_ft", "r_ft", "imu_link"):
            assert state.site(frame).xpos == pytest.approx(data.oMf[model.getFrameId(frame)].translation, abs=1e-9)
        turn = data.oMf[model.getFrameId("imu_link")].rotation
        assert state.site("imu_link").xmat.reshape(3, 3) == pytest.approx(turn, abs=1e-9)


def test_the_simulator_knows_nothing_of_the_reduced_model():
    """It is there to test it: a shared error would go unseen."""
    code = (
        "import sys, coman_reduced_model.sim.virtual_robot\n"
        "forbidden = ('model', 'predictor', 'effects', 'pipeline', 'robot')\n"
        "print([n for n in forbidden if 'coman_reduced_model.core.' + n in sys.modules], 'rclpy' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=child_environment(), check=True
    )
    assert result.stdout.strip() == "[] False"


# --- inverse kinematics and plan ---

small = st.floats(-1.0, 1.0)


@settings(max_examples=40)
@given(com=st.tuples(small, small, small), feet=st.tuples(*[small] * 8), yaw=st.floats(-3.1, 3.1))
def test_inverse_kinematics_puts_com_and_soles_where_they_are_asked(legs, com, feet, yaw):
    soles = []
    for side, (x, y, z, turn) in zip((1.0, -1.0), np.reshape(feet, (2, 4)), strict=True):
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(0.05 * z, 0.1 * x, yaw + 0.15 * turn)
        T[:3, 3] = pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ [0.06 * x, side * 0.0726 + 0.02 * y, 0.02 * z + 0.02]
        soles.append(T[None])
    wanted = pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ [0.02 * com[0], 0.03 * com[1], 0.35 + 0.01 * com[2]]
    posture = legs.inverse(wanted[None], *soles)
    q = legs.configuration(posture)[0]
    pin.centerOfMass(legs.model, legs.data, q)
    pin.updateFramePlacements(legs.model, legs.data)
    assert legs.data.com[0] == pytest.approx(wanted, abs=1e-7)
    for name, T in zip(("l_sole", "r_sole"), soles, strict=True):
        assert legs.data.oMf[legs.model.getFrameId(name)].homogeneous == pytest.approx(T[0], abs=1e-9)


def test_the_corrected_com_makes_the_planned_zmp(planned, legs):
    _, plan = planned
    t = np.arange(0.0, plan.duration_s, 0.005)
    point = plan.sample_many(t)
    posture = legs.inverse(point.com, point.T_odom_left, point.T_odom_right)
    zmp = zmp_of(legs.ground_wrench(posture, *legs.derivatives(t, posture)), 0.0)
    assert np.sqrt(np.mean((zmp - point.zmp[:, :2]) ** 2)) < 0.001  # a point mass alone: 7 mm


def test_what_the_legs_cannot_do_is_refused_in_one_line():
    for changes in ({"com_height_m": 0.45}, {"step_length_m": 0.5}, {"com_height_m": 0.1}):
        with pytest.raises(ConfigError, match="com_height_m") as error:
            plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1", **changes)))
        assert "\n" not in str(error.value) and "allowed" in str(error.value)
    with pytest.raises(ConfigError, match="allowed"):
        robot_gait(COMAN, "test1", duration_s=1.0)


def test_a_streamed_reference_leads_the_springs_as_a_planned_one_does(planned, legs):
    motion, plan = planned
    for t in (0.2, 2.9, 3.3, 3.6):
        window = [plan.reference(t + dt, round(1e9 * (t + dt))) for dt in (-0.02, 0.0, 0.02)]
        theta, _ = follow(legs, window)
        assert theta == pytest.approx(motion(np.array([t]))[0][0], abs=0.006)
