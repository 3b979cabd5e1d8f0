# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the structured residuals on recordings made of formulas, and what a hypothesis does to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from synthetic import robot

from coman_reduced_model.core.config import Config
from coman_reduced_model.core.effects.foot_slip import glide
from coman_reduced_model.core.types import Foot, Phase
from coman_reduced_model.diagnose.balance import JOLT, evaluate
from coman_reduced_model.diagnose.case import examine
from coman_reduced_model.diagnose.hypotheses import candidates, figures, shifted
from coman_reduced_model.diagnose.masks import masks, on_flat_soles
from coman_reduced_model.diagnose.recording import FEET, RATE, Recording, moving
from coman_reduced_model.diagnose.signals import bent_stretch, lagged, smooth
from coman_reduced_model.diagnose.world import World

SECONDS = 4.0
t = np.arange(0.0, SECONDS, 1.0 / RATE)
JOINT = "LKneeSag"


@cache
def standing() -> tuple[Recording, World]:
    """Straight up on both feet, half of the weight through each sole below the COM; springs under slow torques."""
    world = World.nominal(robot(), Config())
    n, nj = len(t), len(robot().joint_names)
    posture = robot().posture()
    posture.update(np.zeros(nj), np.zeros(nj))
    half = 0.5 * robot().mass * world.gravity
    wrench = {}
    for foot in FEET:
        com, _ = posture.com_in_sole(foot)
        wrench[foot] = np.tile([0.0, 0.0, half, half * com[1], -half * com[0], 0.0], (n, 1))
    tau = 12.0 * np.sin(2.0 * np.pi * (0.3 + 0.02 * np.arange(nj)) * t[:, None] + np.arange(nj))
    q = np.zeros((n, nj))
    motor = np.column_stack(
        [lagged(tau[:, j], world.damping[j] / world.stiffness[j]) / world.stiffness[j] for j in range(nj)]
    )
    recording = Recording(
        "standing", t, q, tau, motor, wrench, np.tile([0.0, 0.0, 1.0], (n, 1)), None, None,
        np.full(n, Phase.DOUBLE), np.full(n, 0.5), np.ones(n, dtype=bool), np.zeros(nj),
    )  # fmt: skip
    return recording, world


def residuals(recording: Recording, world: World | None = None) -> dict[str, np.ndarray]:
    return evaluate(recording, world or standing()[1], masks(*standing())).residuals


def figure(name: str):
    return next(f for f in figures(*standing()) if f.name == name)


def rms(values: np.ndarray) -> float:
    assert np.isfinite(values).any()
    return float(np.sqrt(np.nanmean(values**2)))


def index(name: str = JOINT) -> int:
    return robot().joint_names.index(name)


# --- the laws ---


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


def stepping(slides: Sequence[float], seconds: float = 0.3) -> tuple[Recording, float]:
    """The right foot lands every 0.8 s for so long; by how much of 0.01 rad its hip gives way each time as it bears.

    Also how far back 0.01 rad takes the right sole [m].
    """
    recording, _ = standing()
    since, step = np.mod(t, 0.8) - 0.3, np.minimum(np.floor(t / 0.8).astype(int), len(slides) - 1)
    phase = np.where((since >= 0.0) & (since < seconds), Phase.DOUBLE, Phase.LEFT)
    gone = np.array([glide(s)[0] for s in since])
    q = recording.q.copy()
    q[:, index("RHipSag")] += 0.01 * np.array(slides)[step] * gone
    posture, bent = robot().posture(), np.zeros(len(robot().joint_names))
    ends = []
    for angle in (0.0, 0.01):
        bent[index("RHipSag")] = angle
        posture.update(bent, bent)
        ends.append(posture.p[Foot.RIGHT][0])
    return recording.changed(phase=phase, q=q), ends[0] - ends[1]


def test_a_foot_that_slides_after_each_landing_shows_step_by_step():
    world, (recording, back) = standing()[1], stepping([1.0] * 5)
    where = masks(recording, world)
    found = evaluate(recording, world, where).residuals["slide/x"]
    assert [slide.foot for slide in where.slides] == [Foot.RIGHT] * 5
    assert found[np.isfinite(found)] == pytest.approx(np.full(5, -back), rel=0.05)
    left = evaluate(recording, world.changed(slip=np.array([0.0, back])), where).residuals["slide/x"]
    assert np.nanmax(np.abs(left)) < 0.03 * abs(back)
    other = evaluate(recording, world.changed(slip=np.array([back, 0.0])), where).residuals["slide/x"]
    np.testing.assert_array_equal(other, found)  # the left foot has not landed


def test_a_stumble_is_no_slide_and_a_foot_that_soon_leaves_tells_none():
    world = standing()[1]
    stumbled, _ = stepping([0.0, 0.0, 3.0, 0.0, 0.0])
    where = masks(stumbled, world)
    found = evaluate(stumbled, world, where).residuals["slide/x"]
    assert len(where.slides) == 4 and np.nanmax(np.abs(found)) < 1e-9
    assert not masks(stepping([1.0] * 5, seconds=0.15)[0], world).slides


# --- springs ---


@settings(max_examples=8)
@given(st.floats(-0.9, 0.9), st.floats(0.5, 8.0), st.floats(5.0, 20.0))
def test_a_bent_spring_is_what_an_integrator_says(bend, d, amplitude):
    k, dt = 130.0, 0.005
    cubic = bend / 3.0 / (1.5 * amplitude / k) ** 2
    torque = amplitude * np.sin(2.0 * np.pi * t[:400])

    def rate(at, x):
        return (np.interp(at, t, amplitude * np.sin(2.0 * np.pi * t)) - k * x * (1.0 + cubic * x**2)) / d

    exact = solve_ivp(rate, (0.0, t[399]), [0.0], t_eval=t[:400], max_step=dt, rtol=1e-8, atol=1e-10).y[0]
    found = bent_stretch(np.ascontiguousarray(torque), k, d, cubic, dt)
    assert found == pytest.approx(exact, abs=0.06 * amplitude / k)  # backward Euler is of first order
    assert np.abs(found - exact).mean() < 0.03 * amplitude / k


def test_a_straight_spring_is_the_same_bent_by_nothing():
    torque = 10.0 * np.sin(3.0 * t)
    assert bent_stretch(torque, 130.0, 3.0, 1e-12, 0.005) == pytest.approx(
        lagged(torque, 3.0 / 130.0) / 130.0, abs=2e-3
    )


def test_a_lag_is_exact_on_a_ramp_and_leads_the_other_way():
    ramp = 2.0 * t[:, None]
    assert lagged(ramp, 0.05)[-100:] == pytest.approx(ramp[-100:] - 2.0 * 0.05, abs=1e-9)
    assert lagged(ramp, -0.05)[50:-50] == pytest.approx(ramp[50:-50] + 2.0 * 0.05, abs=1e-9)
    step = np.where(t > 1.0, 1.0, 0.0)[:, None]
    assert lagged(step, 0.2)[240 + 1, 0] == pytest.approx(1.0 - np.exp(-1.0), abs=0.02)


def stretched(change) -> Recording:
    """The standing robot with another stretch (n,) of one joint's spring, for its torque (n,)."""
    recording, _ = standing()
    motor, j = recording.motor_q.copy(), index()
    motor[:, j] = change(recording.tau[:, j], motor[:, j])
    return recording.changed(motor_q=motor)


def told(recording: Recording, name: str, value: float) -> float:
    """What of the spring's residual is left when a figure is assumed, over what it was."""
    which = figure(name)
    before = residuals(recording)[f"spring/{JOINT}"]
    moved, world = which.apply(recording, standing()[1], value)
    after = evaluate(moved, world, masks(recording, standing()[1])).residuals[f"spring/{JOINT}"]
    return rms(after) / rms(before)


def test_a_softer_spring_is_explained_by_its_stiffness():
    k, d = (float(getattr(standing()[1], name)[index()]) for name in ("stiffness", "damping"))
    soft = stretched(lambda tau, _: lagged(tau, d / (0.8 * k)) / (0.8 * k))
    assert told(soft, f"joint_stiffness@{JOINT}.scale", -0.2) < 2e-3
    assert told(soft, f"joint_stiffness@{JOINT}.scale", 0.2) > 1.5


def test_play_is_explained_by_backlash():
    played = stretched(lambda tau, nominal: nominal + 0.5 * 0.02 * np.sign(tau))
    before = residuals(played)[f"spring/{JOINT}"]
    which = figure(f"backlash@{JOINT}.width")
    where = masks(played, standing()[1])
    moved, world = which.apply(played, standing()[1], 0.02)
    after = evaluate(moved, world, where).residuals[f"spring/{JOINT}"]
    assert rms(after) < 0.35 * rms(before)


def test_a_hardening_spring_is_explained_by_its_cubic():
    k, d = (float(getattr(standing()[1], name)[index()]) for name in ("stiffness", "damping"))
    cubic = 0.4 / (12.0 / k) ** 2
    hard = stretched(lambda tau, _: bent_stretch(np.ascontiguousarray(tau), k, d, cubic, 1.0 / RATE))
    assert told(hard, f"spring_nonlinearity@{JOINT}.cubic", cubic) < 0.05


@given(coulomb=st.floats(0.1, 10.0), creep=st.floats(0.01, 0.3))
@settings(max_examples=10)
def test_friction_that_creeps_is_explained_by_both_of_its_figures(coulomb, creep):
    """The torque beyond what motion and ground ask for is against the rate of the joint (here a slow one)."""
    recording, world = standing()
    q, j = recording.q.copy(), index()
    q[:, j] = 0.05 * np.sin(2.0 * np.pi * t)
    swings = recording.changed(q=q)
    where = masks(swings, world)
    rate = evaluate(swings, world, where).motion.qd[:, j]
    assumed = swings, world
    for name, value in (("coulomb", coulomb), ("creep", creep)):
        which = figure(f"joint_friction@{JOINT}.{name}")
        assumed = which.apply(*assumed, value - which.nominal)
    before, after = (evaluate(*each, where).residuals[f"torque/{JOINT}"] for each in ((swings, world), assumed))
    friction = coulomb * np.tanh(rate / creep)
    np.testing.assert_allclose((before - after)[where.steady], friction[where.steady], atol=1e-9)


def test_soles_give_way_as_usual_before_anything_is_found():
    """Derivatives do it as well as the law itself, which is used once a soft floor is found."""
    recording, world = standing()
    pressed = np.outer(np.sin(9.0 * t), [0.0, 0.0, 20.0, 1.0, 2.0, 0.0])  # by one foot alone
    left = recording.wrench[Foot.LEFT] + pressed
    recording = recording.changed(wrench={**recording.wrench, Foot.LEFT: left})
    known = figures(recording, world)
    soft = [i for i, each in enumerate(known) if each.effect == "ground_compliance"]
    tiny = np.where(np.isin(np.arange(len(known)), soft), 1e-9 * np.array([each.reach for each in known]), 0.0)
    prepared = recording, world, masks(recording, world)
    nothing, exact = (examine(prepared, known, at).problem.rows for at in (np.zeros(len(known)), tiny))
    assert all(known[i].usual > 0.0 for i in soft) and len(soft) == 2
    assert rms(evaluate(*prepared).residuals["feet/pitch"]) < 1e-12 < 1e-5 < rms(nothing["feet/pitch|double"])
    for key in ("feet/roll|double", "feet/pitch|double", "feet/z|double", "force/z|double"):
        np.testing.assert_allclose(nothing[key], exact[key], atol=0.02 * rms(exact[key]))


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
    _, believed = next(f for f in figures(walked, world) if f.name == "motor_compliance@plan.compliance").apply(
        walked, world, compliance
    )
    after = evaluate(walked, believed, where).residuals
    for axis in "xy":
        assert rms(before[f"plan/{axis}"]) > 1e-3
        assert rms(after[f"plan/{axis}"]) < 0.05 * rms(before[f"plan/{axis}"])
    for name in before:
        if not name.startswith("plan/"):
            np.testing.assert_array_equal(before[name], after[name])


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


def landing(force: np.ndarray, steps: int = 3) -> tuple[Recording, np.ndarray]:
    """The right foot lands every second with a force (k,) [N] that then stays; the values of `landing/z`."""
    recording, world = standing()
    since = np.mod(t, 1.0) - 0.5
    phase = np.where((since >= 0.0) & (t < steps), Phase.DOUBLE, Phase.LEFT)
    borne = force[np.clip(np.round(since * RATE).astype(int), 0, len(force) - 1)]
    wrench = {**recording.wrench, Foot.RIGHT: np.where(since >= 0.0, borne, 0.0)[:, None] * np.eye(6)[2]}
    landed = recording.changed(phase=phase, wrench=wrench)
    found = evaluate(landed, world, masks(landed, world)).residuals["landing/z"]
    return landed, found[np.isfinite(found)] + JOLT * robot().mass


def test_a_force_that_only_rises_is_no_blow():
    for rise_s in (0.02, 0.05, 0.1):
        rising = 60.0 * np.clip(np.arange(1, 100) / RATE / rise_s, 0.0, 1.0)
        assert landing(rising)[1] == pytest.approx(np.zeros(3), abs=1e-9)
    landed, at_once = landing(np.full(100, 60.0))
    seldom = landed.changed(period=0.02)
    assert np.isnan(masks(seldom, standing()[1]).blow).all()  # of samples that are too far apart nothing is told
    assert at_once == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("late", [0, 8])
@pytest.mark.parametrize("impulse", [0.7, 1.5])
def test_a_blow_is_told_from_the_load_that_follows(impulse, late):
    """A half sine of 10 ms beside a load that rises in 50 ms; the edge of the foot may have touched before."""
    k = np.arange(100)
    inside = (k >= late) & (k < late + 2)
    blow = impulse * np.pi / 0.02 * np.abs(np.sin(np.pi * (k + 0.5) / RATE / 0.01)) * inside
    recording, found = landing(blow + 50.0 * np.clip(k / RATE / 0.05, 0.0, 1.0))
    assert found == pytest.approx(np.full(3, impulse), rel=0.25)
    world = standing()[1]
    _, believed = next(f for f in figures(recording, world) if f.effect == "touchdown_impact").apply(
        recording, world, impulse
    )
    left = evaluate(recording, believed, masks(recording, world)).residuals["landing/z"]
    assert rms(left + JOLT * robot().mass) < 0.35 * rms(found)


def test_a_foot_that_chatters_does_not_land():
    recording, world = standing()
    phase = np.where(np.mod(t, 0.2) < 0.1, Phase.DOUBLE, Phase.LEFT)
    assert np.isnan(masks(recording.changed(phase=phase), world).blow).all()


# --- hypotheses: a figure undoes what it describes ---


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
    return figure(name).apply(corrupted, standing()[1], value)[0]


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
    found = figure("transport_delay@.delay").apply(recording, standing()[1], 0.02)[0]
    assert found.motor_q[10:-10] == pytest.approx(shifted(recording.motor_q, -0.02)[10:-10], abs=1e-12)


def test_figures_are_named_once_and_leave_their_input_alone():
    recording, world = standing()
    known = figures(recording, world)
    names = [f.name for f in known]
    assert len(set(names)) == len(names)
    copies = recording.q.copy(), recording.tau.copy(), recording.motor_q.copy(), world.stiffness.copy()
    mass = robot().mass
    for each in known:
        if recording.plan is not None or not each.where == "plan":
            each.apply(recording, world, each.step)
    for kept, now in zip(copies, (recording.q, recording.tau, recording.motor_q, world.stiffness), strict=True):
        assert (kept == now).all()
    assert robot().mass == mass
    for option in candidates(known):
        assert {known[i].effect for i in option.figures} == {option.effect}


def test_without_motor_states_there_are_no_springs_to_judge():
    recording, world = standing()
    effects = {f.effect for f in figures(recording.changed(motor_q=None, tau=None), world)}
    assert not effects & {"joint_stiffness", "backlash", "motor_lag", "transport_delay", "motor_compliance"}
    assert {"payload", "encoder_bias", "wrench_scale", "wrench_delay"} <= effects


# --- masks ---


def test_contacts_and_gaps_are_left_out_and_feet_in_the_air_found():
    recording, world = standing()
    phase = np.select([t < 1.0, t < 2.0, t < 3.0], [Phase.DOUBLE, Phase.LEFT, Phase.DOUBLE], Phase.RIGHT)
    valid = ~((t > 0.4) & (t < 0.5))
    where = masks(recording.changed(phase=phase, valid=valid), world)
    at = t[where.ticks]
    assert not where.steady[(np.abs(at - 1.0) < 0.05) | (np.abs(at - 2.0) < 0.05) | ((at > 0.4) & (at < 0.5))].any()
    assert where.steady[(at > 1.2) & (at < 1.8)].all()
    assert where.air[Foot.RIGHT][(at > 1.2) & (at < 1.8)].all() and not where.air[Foot.RIGHT][at < 1.1].any()
    assert not where.air[Foot.LEFT][at < 3.1].any()
    assert where.double[(at > 2.1) & (at < 2.9)].all() and not where.double[(at > 1.0) & (at < 2.0)].any()
    (slide,) = where.slides
    assert slide.foot == Foot.RIGHT and 2.0 < t[slide.first.start] < t[slide.last.stop] <= 2.2 and slide.share > 0.9
    assert moving(phase) and not moving(recording.phase)


@pytest.mark.parametrize("steps", [1, 3])
def test_a_step_that_was_mostly_stood_on_an_edge_is_left_out_unless_most_are(steps):
    """Four steps, left and right; in some, more than half of the time on the edge of the sole, by the IMU."""
    recording, world = standing()
    since, step = np.mod(t, 1.0), np.floor(t)
    phase = np.where(since < 0.2, Phase.DOUBLE, np.where(step % 2, Phase.RIGHT, Phase.LEFT))
    edge = (step < steps) & (since > 0.2) & (since < 0.64)
    up = np.column_stack([np.zeros(len(t)), 0.02 * (1.0 + since) * edge, np.ones(len(t))])
    rocked = recording.changed(phase=phase, up=up, left_share=np.where(since < 0.2, 0.5, step % 2 == 0))
    where = masks(rocked, world)
    flat = on_flat_soles(where, evaluate(rocked, world, where).residuals)
    single, at = flat.steady & ~flat.double, t[flat.ticks]
    assert not single[edge[flat.ticks]].any()
    rest = single[(at > 0.74) & (at < 0.92)]
    assert not rest.any() if steps == 1 else rest.all()
    assert single[(at > 3.3) & (at < 3.8)].all() and not flat.staggers


def swaying(last: Phase) -> Recording:
    """By its IMU on the edge of a foot, nearly always; on the left foot, on the right one, then `last`."""
    sway = 0.05 * np.sin(2.0 * np.pi * 1.3 * t)
    up = np.column_stack([np.zeros(len(t)), sway, np.ones(len(t))])
    return standing()[0].changed(phase=np.select([t < 1.0, t < 2.0], [Phase.LEFT, Phase.RIGHT], last), up=up)


def test_who_is_nearly_always_on_an_edge_staggers():
    recording, world = swaying(Phase.DOUBLE), standing()[1]
    where = masks(recording, world)
    found = on_flat_soles(where, evaluate(recording, world, where).residuals)
    assert found.staggers and found.steady.sum() == where.steady.sum()


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


@pytest.mark.parametrize("lacks", [(), ("tau",), ("motor_q", "plan", "moved"), ("up",)])
@pytest.mark.parametrize("believed", [{}, {"tilting": 2e-4, "sinking": 1e-6}, {"lead": 0.3, "yielded": 2e-4}])
def test_what_is_taken_over_from_another_hypothesis_is_what_it_would_be_anew(lacks, believed):
    recording, world = moving_about().changed(**dict.fromkeys(lacks)), standing()[1].changed(**believed)
    where = masks(recording, world)
    before = evaluate(recording, world, where)
    for figure in figures(recording, world):
        moved = figure.apply(recording, world, figure.step)
        anew = evaluate(*moved, where).residuals
        taken_over = evaluate(*moved, where, before).residuals
        assert list(anew) == list(taken_over)
        for name, value in anew.items():
            scale = 1.0 + np.abs(np.nan_to_num(value)).max()
            np.testing.assert_allclose(taken_over[name], value, rtol=0.0, atol=1e-11 * scale, err_msg=figure.name)


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
