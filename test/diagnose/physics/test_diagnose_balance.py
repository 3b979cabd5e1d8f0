# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the structured residuals on recordings made of formulas."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from diagnose_tools import JOINT, index, residuals, rms, standing, stretched, t
from synthetic import robot

from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import FEET, RATE, Recording
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import unknowns


def test_a_standing_robot_is_in_balance():
    found = residuals(standing()[0])
    for name, value in found.items():
        if name.startswith(("force", "moment", "tilt", "feet")):
            assert rms(value) < 1e-6, name
        if name.startswith("spring"):
            assert rms(value[10:-10]) < 1e-9, name  # away from the ends, where smoothing and lag begin
    assert not any(np.isfinite(v).any() for name, v in found.items() if name.startswith("unloaded"))


def test_mass_that_the_urdf_lacks_shows_in_the_force_only_if_it_is_above_the_com():
    recording, world = standing()
    heavier = world.add_mass(2.0, np.zeros(3), robot().base_id)
    found = residuals(recording, heavier)
    assert np.nanmean(found["force/z"]) == pytest.approx(-2.0 * world.gravity, abs=1e-6)  # sensors say too little
    assert rms(found["force/x"]) < 1e-6
    assert world.model.inertias[1].mass < heavier.model.inertias[1].mass  # the original is as it was


def test_a_sensor_that_reads_too_much():
    recording, _ = standing()
    half = 0.5 * robot().mass * 9.81
    wrench = {**recording.wrench, Foot.LEFT: recording.wrench[Foot.LEFT] * 1.1}
    assert np.nanmean(residuals(recording.changed(wrench=wrench))["force/z"]) == pytest.approx(0.1 * half, rel=1e-3)


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_the_robot_leans_with_the_floor(axis):
    recording, world = standing()
    k, a = ("roll", "pitch").index(axis), 0.02
    up = np.array([0.0, np.sin(a), np.cos(a)]) if k == 0 else np.array([-np.sin(a), 0.0, np.cos(a)])
    leaning = recording.changed(up=np.tile(up, (len(t), 1)))
    assert abs(np.nanmean(residuals(leaning)[f"tilt/{axis}"])) == pytest.approx(np.sin(a), rel=1e-6)
    assert rms(residuals(leaning, world.changed(slope=a * np.eye(2)[k]))[f"tilt/{axis}"]) < 1e-5  # of second order


def test_soles_at_different_heights_and_angles():
    recording, _ = standing()
    q = recording.q.copy()
    q[:, index("LAnkLat")] += 0.03
    found = residuals(recording.changed(q=q))
    assert abs(np.nanmean(found["feet/roll"])) == pytest.approx(0.03, rel=1e-3)
    assert rms(found["feet/pitch"]) < 1e-3 < rms(found["feet/z"])
    assert rms(found["feet/y"]) < 1e-6  # where it stood at touchdown is where it stands


def test_motors_that_yield_do_so_with_the_lag_and_the_inertia_of_their_loops():
    """Motor = reference - c (torque + rotor acceleration), a lag later, where the motor states echo the reference."""
    compliance, settling, rotor = 5e-4, 0.008, 0.14

    def echoed(torque, motor):
        second = np.gradient(np.gradient(motor, 1.0 / RATE), 1.0 / RATE)
        return motor + compliance * (torque - settling * np.gradient(torque, 1.0 / RATE) + rotor * second)

    yielding = stretched(echoed)
    where = masks(*standing())

    def left(**world) -> float:
        moved = standing()[1].changed(**world)
        return rms(evaluate(yielding, moved, where).residuals[f"spring/{JOINT}"])

    at_rest = left(yielding=compliance)
    assert at_rest < 0.05 * left()
    assert left(yielding=compliance, settling=settling, rotor=rotor) < 0.2 * at_rest
    assert left(settling=settling, rotor=rotor) == left()  # motors that do not yield have neither


def test_motors_that_lead_their_plan_do_so_by_the_sag_of_its_torques():
    """Standing bent on the left foot: the torques are the slope of the potential energy above that foot."""
    recording, world = standing()
    posture, still, share = robot().posture(), np.zeros(len(robot().joint_names)), 0.7
    bent = np.array([{"Hip": -0.3, "Kne": 0.6, "Ank": -0.3}[name[1:4]] if name.endswith("Sag") else 0.05
                     for name in robot().joint_names])  # fmt: skip

    def com(q):
        posture.update(q, still)
        return posture.com_in_sole(Foot.LEFT)[0]

    unit = 1e-4 * np.eye(len(bent))
    torque = robot().mass * world.gravity * np.array([(com(bent + e) - com(bent - e))[2] / 2e-4 for e in unit])
    stood = np.tile(bent, (len(t), 1))
    planned = com(bent - share * np.nan_to_num(torque / world.stiffness))
    on_left = recording.changed(
        q=stood, motor_q=stood, phase=np.full(len(t), Phase.LEFT), left_share=np.ones(len(t)),
        plan=np.tile(planned[:2], (len(t), 1)), moved=np.tile(com(bent)[:2], (len(t), 1)),
    )  # fmt: skip
    where = masks(on_left, world)
    for axis in "xy":
        before = rms(evaluate(on_left, world, where).residuals[f"plan/{axis}"])
        assert before > 5e-4
        assert rms(evaluate(on_left, world.changed(lead=share), where).residuals[f"plan/{axis}"]) < 0.05 * before


def moving_about() -> Recording:
    """Every joint and every force changes, on one foot, the other, both; the numbers mean nothing."""
    recording, _ = standing()
    nj = len(robot().joint_names)
    q = 0.05 * np.sin(2.0 * np.pi * (0.4 + 0.1 * np.arange(nj)) * t[:, None] + np.arange(nj))
    rocking = 1.0 + 0.2 * np.sin(7.0 * t[:, None] + np.arange(6))
    phase = np.select([t < 1.3, t < 2.6], [Phase.LEFT, Phase.RIGHT], Phase.DOUBLE)
    return recording.changed(
        q=q, motor_q=q + recording.motor_q, wrench={foot: rocking * recording.wrench[foot] for foot in FEET},
        phase=phase, left_share=np.select([phase == Phase.LEFT, phase == Phase.RIGHT], [1.0, 0.0], 0.5),
        plan=0.01 * q[:, :2], moved=0.01 * q[:, 2:4],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("lacks", [(), ("tau",), ("motor_q", "plan", "moved"), ("up",)])
@pytest.mark.parametrize(
    "believed", [{}, {"tilting": 2e-4, "sinking": 1e-6}, {"softness": 2e-4}, {"lead": 0.3, "yielded": 2e-4}]
)
def test_what_is_taken_over_from_another_hypothesis_is_what_it_would_be_alone(lacks, believed):
    recording, world = moving_about().changed(**dict.fromkeys(lacks)), standing()[1].changed(**believed)
    where = masks(recording, world)
    before = evaluate(recording, world, where)
    every = not lacks and (not believed or "lead" in believed)  # else two joints stand for all, which are alike
    for unknown in unknowns(recording, world):
        if not (every or unknown.where in ("LKneeSag", "RAnkLat") or unknown.where not in robot().joint_names):
            continue
        moved = unknown.apply(recording, world, unknown.step)
        again = evaluate(*moved, where).residuals
        taken_over = evaluate(*moved, where, before).residuals
        assert list(again) == list(taken_over)
        for name, value in again.items():
            scale = 1.0 + np.abs(np.nan_to_num(value)).max()
            np.testing.assert_allclose(taken_over[name], value, rtol=0.0, atol=1e-11 * scale, err_msg=unknown.name)


def test_the_trunk_moves_as_it_must_for_the_sole_to_stand_still():
    recording, world = moving_about(), standing()[1]
    motion, model, idx_v = evaluate(recording, world, masks(recording, world)).motion, robot().model, robot().idx_v
    data, configuration = model.createData(), pin.neutral(model)
    velocity, acceleration = np.zeros(model.nv), np.zeros(model.nv)
    for i in range(0, len(motion.q), 9):
        robot().scatter(motion.q[i], configuration)
        velocity[idx_v], acceleration[idx_v] = motion.qd[i], motion.qdd[i]
        for foot, frame in robot().sole_ids.items():
            velocity[:6], acceleration[:6] = motion.twist[foot][i], motion.twist_rate[foot][i]
            pin.forwardKinematics(model, data, configuration, velocity, acceleration)
            assert np.abs(velocity[:6]).max() > 1e-3
            assert pin.getFrameVelocity(model, data, frame).vector == pytest.approx(np.zeros(6), abs=1e-12)
            assert pin.getFrameAcceleration(model, data, frame).vector == pytest.approx(np.zeros(6), abs=1e-11)
