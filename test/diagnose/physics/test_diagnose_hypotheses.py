# SPDX-License-Identifier: BSD-3-Clause
"""What a hypothesis does to a recording or to the world: it undoes what it describes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_tools import JOINT, index, residuals, rms, standing, stretched, t, unknown
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import robot

from coman_reduced_model.core.base import delays
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import FEET, RATE, Recording
from coman_reduced_model.diagnose.data.signals import bent_stretch, lagged, smooth
from coman_reduced_model.diagnose.inference.case import examine
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns

SINKS = 0.00016  # [m] under the weight, as `Nominal.widths` has it


def test_figures_are_named_once_and_leave_their_input_alone():
    recording, world = standing()
    known = unknowns(recording, world)
    names = [f.name for f in known]
    assert len(set(names)) == len(names)
    copies = recording.q.copy(), recording.tau.copy(), recording.motor_q.copy(), world.stiffness.copy()
    mass = robot().mass
    for each in known:
        if recording.plan is not None or each.where != "plan":
            each.apply(recording, world, each.step)
    for kept, now in zip(copies, (recording.q, recording.tau, recording.motor_q, world.stiffness), strict=True):
        assert (kept == now).all()
    assert robot().mass == mass
    for option in candidates(known):
        assert {known[i].effect for i in option.unknowns} == {option.effect}


@pytest.mark.slow
def test_next_to_nothing_of_an_effect_changes_next_to_nothing():
    """An effect that is there at all, and no effect, are not computed in two ways that differ."""
    k = float(standing()[1].stiffness[index()])
    recording, world = stretched(lambda tau, _: tau / k), standing()[1]
    where = masks(recording, world)
    before, moved = evaluate(recording, world, where).residuals, []
    for each in unknowns(recording, world):
        changes = []
        for share in (1e-6, 1e-2):
            after = evaluate(*each.apply(recording, world, share * each.reach), where).residuals
            assert all((np.isfinite(after[name]) == np.isfinite(before[name])).all() for name in before), each.name
            changes.append(max(np.nanmax(np.abs(after[name] - before[name]), initial=0.0) for name in before))
        assert changes[0] <= 0.01 * changes[1] + 1e-9, each.name
        moved.append(changes[1] > 0.0)
    assert np.mean(moved) > 0.5  # of what a standing robot shows


def test_without_motor_states_there_are_no_springs_to_judge():
    recording, world = standing()
    effects = {f.effect for f in unknowns(recording.changed(motor_q=None, tau=None), world)}
    assert not effects & {"joint_stiffness", "backlash", "motor_lag", "transport_delay", "motor_compliance"}
    assert {"payload", "encoder_bias", "wrench_scale", "wrench_delay"} <= effects


# --- sensors and clocks ---


def shifted(values: np.ndarray, by: float) -> np.ndarray:
    return delays.shifted(values, by, RATE)


def test_a_late_stream_is_put_back():
    wave = np.sin(2.0 * np.pi * t)[:, None]
    assert shifted(shifted(wave, -0.02), 0.02)[10:-10] == pytest.approx(wave[10:-10], abs=1e-9)
    assert shifted(wave, 0.013)[10:-10, 0] == pytest.approx(np.sin(2.0 * np.pi * (t + 0.013))[10:-10], abs=1e-6)


def test_a_shift_by_part_of_a_sample_takes_no_noise_away():
    """Else every noisy stream would seem to be half a sample late: with lines between samples, 3 % quieter."""
    noise = np.random.default_rng(0).standard_normal((20_000, 1))
    before = smooth(noise)[50:-50].std()
    assert smooth(shifted(noise, 0.5 / RATE))[50:-50].std() == pytest.approx(before, rel=5e-3)


def test_a_whole_shift_takes_over_gaps_and_nothing_beside_them():
    values = np.where(np.arange(40) % 7 == 3, np.nan, np.arange(40.0))[:, None]
    np.testing.assert_array_equal(shifted(values, 2.0 / RATE)[:-2], values[2:])


def undone(name: str, value: float, corrupted: Recording) -> Recording:
    return unknown(name).apply(corrupted, standing()[1], value)[0]


def test_sensor_faults_are_undone_exactly():
    recording, _ = standing()
    q = recording.q.copy()
    q[:, index()] += 0.02
    assert undone(f"encoder_bias@{JOINT}.bias", 0.02, recording.changed(q=q)).q == pytest.approx(recording.q, abs=1e-15)

    def spoiled(change) -> Recording:
        wrench = {foot: change(v) if foot == Foot.LEFT else v for foot, v in recording.wrench.items()}
        return recording.changed(wrench=wrench)

    for name, value, change in (
        ("wrench_scale@left.scale", 0.15, lambda v: 1.15 * v),
        ("wrench_bias@left.ty", 0.8, lambda v: v + 0.8 * np.eye(6)[4]),
        ("wrench_delay@left.delay", 0.02, lambda v: shifted(v, -0.02)),
    ):
        found = undone(name, value, spoiled(change)).wrench
        for foot in FEET:
            assert found[foot][10:-10] == pytest.approx(recording.wrench[foot][10:-10], abs=1e-9), name


def test_late_links_and_motors_are_undone():
    recording, _ = standing()
    late = recording.changed(tau=shifted(recording.tau, -0.02))
    assert undone("encoder_delay@all.delay", 0.02, late).tau[10:-10] == pytest.approx(recording.tau[10:-10], abs=1e-9)
    # Motors that lag behind what their states say: the states are slowed as much.
    found = unknown("transport_delay@.delay").apply(recording, standing()[1], 0.02)[0]
    assert found.motor_q[10:-10] == pytest.approx(shifted(recording.motor_q, -0.02)[10:-10], abs=1e-12)


# --- joints and the ground ---


def told(recording: Recording, name: str, value: float) -> float:
    """What of the spring's residual is left when a unknown is assumed, over what it was."""
    which = unknown(name)
    before = residuals(recording)[f"spring/{JOINT}"]
    moved, world = which.apply(recording, standing()[1], value)
    after = evaluate(moved, world, masks(recording, standing()[1])).residuals[f"spring/{JOINT}"]
    return rms(after) / rms(before)


def test_a_softer_spring_is_explained_by_its_stiffness():
    k, d = (float(getattr(standing()[1], name)[index()]) for name in ("stiffness", "damping"))
    soft = stretched(lambda tau, _: lagged(tau, d / (0.8 * k)) / (0.8 * k))
    assert told(soft, f"joint_stiffness@{JOINT}.scale", np.log(0.8)) < 2e-3
    assert told(soft, f"joint_stiffness@{JOINT}.scale", 0.2) > 1.5


def test_play_is_explained_by_backlash():
    played = stretched(lambda tau, nominal: nominal + 0.5 * 0.02 * np.sign(tau))
    before = residuals(played)[f"spring/{JOINT}"]
    which = unknown(f"backlash@{JOINT}.width")
    where = masks(played, standing()[1])
    moved, world = which.apply(played, standing()[1], 0.02)
    after = evaluate(moved, world, where).residuals[f"spring/{JOINT}"]
    assert rms(after) < 0.35 * rms(before)


def held_back(tau: np.ndarray, width: float, held: float) -> np.ndarray:
    """(n,) stretch of the spring and damper of JOINT with a slip in series that moves above a torque: explicit Euler.

    At first it is at the other end than the first large torque leaves it.
    """
    k, d = (float(getattr(standing()[1], name)[index()]) for name in ("stiffness", "damping"))
    steps, half, reach = 50, 0.5 * width, held / k
    x, slip, out = 0.0, -half * np.sign(tau[np.abs(tau) > held][0]), []
    for torque in tau:
        for _ in range(steps):
            x += (torque - k * (x - slip)) / d * (t[1] - t[0]) / steps
            slip = float(np.clip(slip + x - slip - np.clip(x - slip, -reach, reach), -half, half))
        out.append(x)
    return np.array(out)


def test_lost_motion_that_friction_holds_is_explained_by_hysteresis_and_not_by_play():
    lost = stretched(lambda tau, _: held_back(tau, 0.02, 6.0))
    which, friction = (unknown(f"hysteresis@{JOINT}.{key}") for key in ("width", "friction"))
    before = residuals(lost)[f"spring/{JOINT}"]

    def left(*assumed) -> float:
        recording, world = lost, standing()[1]
        for each, value in assumed:
            recording, world = each.apply(recording, world, value)
        return rms(evaluate(recording, world, masks(lost, standing()[1])).residuals[f"spring/{JOINT}"]) / rms(before)

    held = friction.deviation(6.0)
    assert left((which, 0.02), (friction, held)) < 0.35
    assert left((unknown(f"backlash@{JOINT}.width"), 0.02)) > 0.6
    assert left((friction, held)) == 1.0  # nothing without a width


def test_a_spring_that_grows_softer_is_explained_by_its_drift():
    k, d = (float(getattr(standing()[1], name)[index()]) for name in ("stiffness", "damping"))
    factor = 1.0 - 0.4 * (1.0 - np.exp(-t / 4.0))
    soft = stretched(lambda tau, _: lagged(tau, d / k) / k / factor)
    recording, world = unknown(f"stiffness_drift@{JOINT}.time").apply(soft, standing()[1], np.log(0.4))
    recording, world = unknown(f"stiffness_drift@{JOINT}.change").apply(recording, world, -0.4)
    before = residuals(soft)[f"spring/{JOINT}"]
    after = evaluate(recording, world, masks(soft, standing()[1])).residuals[f"spring/{JOINT}"]
    assert rms(after) < 0.02 * rms(before)


def test_a_link_is_heavier_by_the_force_and_not_only_there():
    recording, world = standing()
    heavier = unknown("body_mass@RKneeSag.scale").apply(recording, world, np.log(1.5))[1]
    body = robot().model.getJointId("RKneeSag")
    more = 0.5 * robot().model.inertias[body].mass
    found = residuals(recording, heavier)
    assert np.nanmean(found["force/z"]) == pytest.approx(-more * world.gravity, abs=1e-6)
    assert abs(np.nanmean(found["moment/x"])) > 0.01 * more * world.gravity  # the shank is off the middle
    assert heavier.model.inertias[body].lever == pytest.approx(robot().model.inertias[body].lever)


@pytest.mark.parametrize("where", ["left", "right", ""])
def test_springs_and_dampers_of_a_leg_or_of_all_change_together(where):
    world = standing()[1]
    feet = {"left": (Foot.LEFT,), "right": (Foot.RIGHT,)}.get(where, FEET)
    mine = np.concatenate([robot().legs[foot] for foot in feet])
    for name, field, value in (
        ("spring_nonlinearity@{}.cubic", "cubic", 20.0), ("joint_damping@{}.scale", "damping", 0.2),
        ("hysteresis@{}.width", "lost", 0.01), ("stiffness_drift@{}.change", "drift", -0.1),
        ("backlash@{}.width", "play", 0.01), ("joint_friction@{}.coulomb", "friction", 1.0),
    ):  # fmt: skip
        moved = unknown(name.format(where)).apply(*standing(), value)[1]
        changed = np.flatnonzero(~np.isclose(getattr(moved, field), getattr(world, field), equal_nan=True))
        assert sorted(changed) == sorted(mine), name


def test_a_hardening_spring_is_explained_by_its_cubic():
    k, d = (float(getattr(standing()[1], name)[index()]) for name in ("stiffness", "damping"))
    cubic = 0.4 / (12.0 / k) ** 2
    hard = stretched(lambda tau, _: bent_stretch(np.ascontiguousarray(tau), k, d, cubic, 1.0 / RATE))
    assert told(hard, f"spring_nonlinearity@{JOINT}.cubic", cubic) < 0.05


@given(coulomb=st.floats(0.1, 10.0), creep=st.floats(0.01, 0.3))
@settings(max_examples=10)
def test_friction_that_creeps_is_explained_by_both_of_its_figures(coulomb, creep):
    """The torque beyond what motion and ground ask for is against the rate of the joint, smoothed as torques are."""
    recording, world = standing()
    q, j = recording.q.copy(), index()
    q[:, j] = 0.05 * np.sin(2.0 * np.pi * t)
    swings = recording.changed(q=q)
    where = masks(swings, world)
    assumed = swings, world
    for name, value in (("coulomb", coulomb), ("creep", creep)):
        which = unknown(f"joint_friction@{JOINT}.{name}")
        assumed = which.apply(*assumed, value - which.nominal)
    before, after = (evaluate(*each, where).residuals[f"torque/{JOINT}"] for each in ((swings, world), assumed))
    friction = smooth(coulomb * np.tanh(0.1 * np.pi * np.cos(2.0 * np.pi * t) / creep))[where.ticks]
    np.testing.assert_allclose((before - after)[where.steady], friction[where.steady], atol=0.03 * coulomb)


def test_soles_give_way_as_usual_before_anything_is_found():
    """Derivatives do it as well as the law itself, which is used once a soft floor is found."""
    recording, world = standing()
    pressed = np.outer(np.sin(9.0 * t), [0.0, 0.0, 20.0, 1.0, 2.0, 0.0])  # by one foot alone
    left = recording.wrench[Foot.LEFT] + pressed
    recording = recording.changed(wrench={**recording.wrench, Foot.LEFT: left})
    widths = {**load_nominal().widths, "ground_compliance.vertical.usual": SINKS}
    known = unknowns(recording, world, replace(load_nominal(), widths=widths))
    soft = [i for i, each in enumerate(known) if each.name == "ground_compliance@.vertical"]
    tiny = np.where(np.isin(np.arange(len(known)), soft), 1e-9 * np.array([each.reach for each in known]), 0.0)
    prepared = recording, world, masks(recording, world)
    nothing, exact = (examine(prepared, known, at).problem.rows for at in (np.zeros(len(known)), tiny))
    assert all(known[i].usual > 0.0 for i in soft) and len(soft) == 1
    assert rms(evaluate(*prepared).residuals["feet/z"]) < 1e-12 < 1e-6 < rms(nothing["feet/z|double"])
    for key in ("feet/z|double", "force/z|double"):
        np.testing.assert_allclose(nothing[key], exact[key], atol=0.02 * rms(exact[key]))


def test_motors_that_yield_and_tell_move_the_com_off_its_plan_as_their_kinematics_say():
    """Planned at the reference; moved by motors that are c times their torque away from it; no other law sees it."""
    recording, world = standing()
    names, compliance = robot().joint_names, 5e-4
    posture, still = robot().posture(), np.zeros(len(names))
    on_left = recording.changed(phase=np.full(len(t), Phase.LEFT), left_share=np.ones(len(t)))
    planned = np.empty((len(t), 2))
    for i, torque in enumerate(on_left.tau):
        posture.update(compliance * torque, still)
        planned[i] = posture.com_in_sole(Foot.LEFT)[0][:2]
    posture.update(still, still)
    moved = np.tile(posture.com_in_sole(Foot.LEFT)[0][:2], (len(t), 1))
    walked = on_left.changed(plan=planned, moved=moved)
    where = masks(walked, world)
    before = evaluate(walked, world, where).residuals
    _, believed = next(f for f in unknowns(walked, world) if f.name == "motor_compliance@plan.compliance").apply(
        walked, world, compliance
    )
    after = evaluate(walked, believed, where).residuals
    for axis in "xy":
        assert rms(before[f"plan/{axis}"]) > 1e-3
        assert rms(after[f"plan/{axis}"]) < 0.05 * rms(before[f"plan/{axis}"])
    for name in before:
        if not name.startswith("plan/"):
            np.testing.assert_array_equal(before[name], after[name])
