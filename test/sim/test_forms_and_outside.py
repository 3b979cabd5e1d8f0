# SPDX-License-Identifier: BSD-3-Clause
"""Forms of hidden effects that the diagnosis does not share, and effects that its catalogue does not have."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from sim_runs import Run

from coman_reduced_model.errors import ConfigError
from coman_reduced_model.sim.describe import mujoco_spec
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.robot_table import COMAN, with_upper_body
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.spring_laws import SpringLaws
from coman_reduced_model.sim.virtual_robot import VirtualRobot

K = COMAN.joint_array(COMAN.stiffness)
KNEE = COMAN.joint_names.index("LKneeSag")
STILL = np.zeros(12)


@pytest.fixture(scope="module")
def walked(walking):
    return Run(walking, 2.6)


def started(text: str, standing):
    """A hidden effect within a robot that stands."""
    effect = parse(text)
    robot = VirtualRobot(COMAN, SensorOptions.exact(), [effect])
    robot.reset(standing, settle_s=0.05)
    return effect


def springs_of(effect) -> SpringLaws:
    """What the springs do beside the linear law, and remember."""
    return SpringLaws.of(effect.spring_laws(), 12)


def law(springs, deflections) -> np.ndarray:
    """Torque of the left knee's spring, effect included, over its deflection [Nm]."""
    out = []
    for deflection in deflections:
        bent = np.zeros(12)
        bent[KNEE] = deflection
        out.append(K[KNEE] * deflection + springs.torque(0.0, bent, STILL)[KNEE])
    return np.array(out)


@pytest.mark.parametrize("form", ["cubic", "tanh", "steps"])
@pytest.mark.parametrize("cubic", [150.0, -100.0])
@pytest.mark.parametrize("at", [0.05, 0.01])
def test_each_form_of_a_bent_spring_has_the_stated_secant_and_never_pushes_the_wrong_way(standing, form, cubic, at):
    cubic *= (0.05 / at) ** 2
    springs = springs_of(started(f"spring_nonlinearity:where=LKneeSag,cubic={cubic},form={form},at={at}", standing))
    assert law(springs, [at])[0] / (K[KNEE] * at) == pytest.approx(1.0 + cubic * at**2, rel=1e-6)
    d = np.linspace(0.0, 2.4 * at, 200)
    torque = law(springs, d)
    assert np.all(np.diff(torque) > 0.0)
    assert law(springs, -d) == pytest.approx(-torque)


def test_a_spring_of_two_slopes_is_the_data_sheets_below_the_step(standing):
    springs = springs_of(started("spring_nonlinearity:where=LKneeSag,cubic=150,form=steps", standing))
    d = np.linspace(0.0, 0.02, 20)
    assert law(springs, d) == pytest.approx(K[KNEE] * d)


def test_hysteresis_stays_where_it_slipped_unlike_play(standing):
    """Prandtl: up, back and up again encloses a loop; the spring's end moves by the width at most."""
    effect = started("hysteresis:where=LKneeSag,width=0.01,friction=1", standing)
    effect.start(COMAN, mujoco_spec(COMAN).compile(), np.random.default_rng(0))
    reach = 1.0 / K[KNEE]
    springs = springs_of(effect)
    first = law(springs, np.linspace(0.0, 0.03, 300))
    assert first[-1] == pytest.approx(K[KNEE] * (0.03 - 0.005))  # slipped by half the width
    back = law(springs, np.linspace(0.03, 0.005 + reach / 2.0, 300))
    assert back[-1] == pytest.approx(K[KNEE] * reach / 2.0)  # still slipped, with hardly any load
    assert law(springs, np.linspace(0.005 + reach / 2.0, 0.03, 300)) == pytest.approx(back[::-1])


def together(standing, *texts: str) -> SpringLaws:
    """The springs' laws of several effects of the left knee."""
    hidden = [started(f"{text},where=LKneeSag", standing) for text in texts]
    for effect in hidden:
        effect.start(COMAN, mujoco_spec(COMAN).compile(), np.random.default_rng(0))
    return SpringLaws.of([each for effect in hidden for each in effect.spring_laws()], 12)


def test_lost_motion_is_in_series_with_play(standing):
    """The same torque moves it, whatever plays behind it, and what is lost adds up."""
    d = np.linspace(0.0, 0.03, 300)
    found = law(together(standing, "hysteresis:width=0.01,friction=1", "backlash:width=0.004"), d)
    assert found[-1] == pytest.approx(K[KNEE] * (0.03 - 0.005 - 0.002))
    slips = (d > 0.002 + 1.0 / K[KNEE]) & (d < 0.002 + 1.0 / K[KNEE] + 0.005)
    assert slips.sum() > 40 and found[slips] == pytest.approx(np.ones(int(slips.sum())))  # at the friction


def test_plays_add_up_and_bear_nothing_inside(standing):
    d = np.linspace(-0.02, 0.02, 401)
    both = law(together(standing, "backlash:width=0.01", "backlash:width=0.002"), d)
    assert both == pytest.approx(law(together(standing, "backlash:width=0.012"), d))
    inside = np.abs(d) < 0.006 - 1e-9
    assert inside.sum() > 100 and both[inside] == pytest.approx(np.zeros(int(inside.sum())), abs=1e-9)
    bent = law(together(standing, "backlash:width=0.01", "spring_nonlinearity:cubic=150"), d)
    assert bent[-1] == pytest.approx(K[KNEE] * 0.015 * (1.0 + 150.0 * 0.015**2))  # what play leaves bends the spring


def test_a_drifting_spring_changes_by_its_time_constant(standing):
    effect = started("stiffness_drift:where=LKneeSag,change=-0.3,time=4", standing)
    bent = 0.02 * np.ones(12)
    for t, share in ((0.0, 0.0), (4.0, 1.0 - np.exp(-1.0)), (40.0, 1.0)):
        torque = springs_of(effect).torque(t, bent, STILL)
        assert torque[KNEE] == pytest.approx(-0.3 * share * K[KNEE] * 0.02, abs=1e-4)
        assert np.delete(torque, KNEE) == pytest.approx(np.zeros(11))


def test_a_spring_that_changes_evenly_is_there_after_twice_the_time(standing):
    springs = springs_of(started("stiffness_drift:where=LKneeSag,change=-0.3,time=4,form=ramp", standing))
    for t, share in ((0.0, 0.0), (2.0, 0.25), (4.0, 0.5), (8.0, 1.0), (40.0, 1.0)):
        torque = springs.torque(t, 0.02 * np.ones(12), STILL)
        assert torque[KNEE] == pytest.approx(-0.3 * share * K[KNEE] * 0.02)


def test_several_places_slip_one_after_the_other_and_as_far_in_all(standing):
    d = np.linspace(0.0, 0.06, 600)
    one, several = (
        law(together(standing, f"hysteresis:width=0.01,friction=1,form={f}"), d) for f in ("one", "several")
    )
    assert several[-1] == pytest.approx(one[-1]) == K[KNEE] * (0.06 - 0.005)
    slipped = d - several / K[KNEE]
    assert (np.diff(slipped) >= -1e-12).all() and slipped[d < 0.4 / K[KNEE]] == pytest.approx(0.0, abs=1e-12)
    steps = [slipped[np.searchsorted(K[KNEE] * (d - slipped), torque)] for torque in (0.7, 1.5, 2.5)]
    assert steps == pytest.approx(0.005 / 3.0 * np.array([1.0, 2.0, 3.0]), rel=0.02)


def test_several_places_slip_back_as_they_slipped(standing):
    """The same places give way at the same torques in both directions: all the way back is the way there, turned."""
    d = np.linspace(-0.06, 0.06, 4001)
    springs = together(standing, "hysteresis:width=0.01,friction=1,form=several")
    there, back = (law(springs, each) for each in (d, d[::-1]))  # begins unloaded, all the way to one side
    assert back[-1] == pytest.approx(-there[-1])
    there = law(springs, d)  # from slipped to one side to slipped to the other
    assert back == pytest.approx(-there, abs=1e-9)


@pytest.mark.parametrize(("where", "body"), [("LKneeSag", "l_shank"), ("LElbow", "l_forearm"), ("", "base_link")])
def test_a_heavier_link_weighs_more_and_only_that_link(where, body):
    effect = parse(f"body_mass:where={where},scale=1.5" if where else "body_mass:scale=1.5")
    robot = with_upper_body(COMAN)
    plain, spec = mujoco_spec(robot).compile(), mujoco_spec(robot)
    effect.edit_model(spec, robot)
    heavier = spec.compile()
    ratio = heavier.body_mass[1:] / plain.body_mass[1:]
    changed = [plain.body(i + 1).name for i in np.flatnonzero(np.abs(ratio - 1.0) > 1e-9)]
    assert len(changed) == 1 and ratio.max() == pytest.approx(1.5)
    if not where:
        assert changed == [body]
    assert heavier.body_inertia.sum() > plain.body_inertia.sum()


def test_cross_talk_shows_a_share_of_the_vertical_force(standing):
    still = Run(standing, 0.05).wrench("left")[-1]
    talked = Run(standing, 0.05, "wrench_cross_talk:where=left,fx=0.1,fy=-0.05").wrench("left")[-1]
    assert talked - still == pytest.approx(still[2] * np.array([0.1, -0.05, 0.0, 0.0, 0.0, 0.0]), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("form", "begin", "end"), [("smooth", 0.05, 0.2), ("sudden", 0.1, 0.13), ("creep", 0.0, 0.5)])
def test_a_foot_slips_in_each_form_by_the_distance_and_at_its_time(walking, walked, form, begin, end):
    run = Run(walking, 2.4, f"foot_slip:where=left,distance=0.006,form={form}")
    t = run.truth("t")
    gone = (walked.truth("T_left")[: len(t)] - run.truth("T_left"))[:, 0, 3]
    landed = t[np.flatnonzero(run.truth("T_left")[:, 2, 3] > 0.012)[-1]] + 0.02
    before, after = (
        gone[np.searchsorted(t, landed + begin - 0.03)],
        gone[np.searchsorted(t, min(landed + end + 0.05, 2.39))],
    )
    assert abs(before) < 2e-3 and after == pytest.approx(0.006, abs=1.5e-3)


@pytest.mark.parametrize("form", ["half_sine", "decay", "double"])
def test_each_form_of_a_landing_blow_brings_its_impulse(form):
    effect = parse(f"touchdown_impact:impulse=1,form={form}")
    t = np.linspace(0.0, 0.06, 60_001)
    force = np.array([effect._share(since) for since in t])  # noqa: SLF001
    assert np.trapezoid(force, t) == pytest.approx(1.0, rel=0.01) and force.min() >= 0.0


def test_an_encoder_drifts_by_its_rate(standing):
    run = Run(standing, 1.0, "thermal_drift:where=LKneeSag,rate=0.01")
    error = run.positions() - run.truth("q")
    assert error[:, KNEE] == pytest.approx(0.01 * run.truth("t"), abs=1e-4)
    assert np.delete(error, KNEE, axis=1) == pytest.approx(np.zeros((len(error), 11)), abs=1e-12)


def test_springs_bear_what_a_cogging_gear_does_not(standing):
    """At rest joints need the same torque: what the gear brings, the spring does not."""
    still = Run(standing, 0.05).truths[-1]
    run = Run(standing, 0.05, "cogging:where=KneeSag,amplitude=2,per_turn=60", settle=2.0).truths[-1]
    ripple = 2.0 * np.sin(60.0 * run.q[KNEE])
    assert abs(ripple) > 1.0
    assert run.tau[KNEE] + ripple == pytest.approx(still.tau[KNEE], abs=0.2 * abs(ripple))


def test_a_dragging_cable_pulls_against_the_motion(walking, walked):
    run = Run(walking, 2.6, "cable_drag:friction=10")
    force = sum(
        np.einsum("nij,nj->ni", run.truth(f"T_{side}")[:, :3, :3], run.truth(f"{side}_wrench")[:, :3])
        for side in ("left", "right")
    )[:, :2]
    momentum = 17.3 * np.gradient(run.truth("com_vel")[:, :2], run.truth("t"), axis=0)
    pull = np.convolve((momentum - force)[:, 1], np.ones(9) / 9.0, "same")
    speed = run.truth("com_vel")[:, 1]
    fast = np.abs(speed) > 0.08
    assert -(pull * np.sign(speed))[fast].mean() == pytest.approx(10.0, abs=2.5)


def test_a_driver_that_hangs_repeats_its_last_value(walking):
    run = Run(walking, 1.2, "stale_stream:where=left,length=0.2,every=0.5")
    t, forces = run.truth("t"), run.wrench("left")
    hangs = (t > 0.51) & (t < 0.69)
    assert np.ptp(forces[hangs], axis=0) == pytest.approx(np.zeros(6), abs=1e-12)
    assert np.ptp(run.truth("left_wrench")[hangs], axis=0).max() > 0.1
    free = (t > 0.72) & (t < 0.98)
    assert forces[free] == pytest.approx(run.truth("left_wrench")[free], abs=1e-6)
    assert run.wrench("right") == pytest.approx(run.truth("right_wrench"), abs=1e-6)


def test_a_slow_clock_makes_forces_the_later_the_longer_it_runs(walking):
    run = Run(walking, 2.4, "late_clock:rate=0.02")
    t, measured, true = run.truth("t"), run.wrench("right")[:, 2], run.truth("right_wrench")[:, 2]
    for at in (1.25, 2.2):  # where the load passes
        near = np.abs(t - at) < 0.12
        shifted = np.interp(t[near] - 0.02 * at, t, true)
        assert np.abs(measured[near] - shifted).max() < 0.25 * np.abs(measured[near] - true[near]).max() + 1.0


def test_a_late_clock_is_not_late_at_first():
    """Periods of 10 ms and 2 ms a second: what is nearest is the present value, until half a period is lost."""
    clock = parse("late_clock:rate=0.002")
    clock.start(None, None, None)
    for k in range(400):
        signals = SimpleNamespace(left_wrench=np.full(6, float(k)), right_wrench=np.full(6, float(k)))
        clock.sense(0.01 * k, signals)
        assert signals.left_wrench[0] == pytest.approx(0.998 * k, abs=0.5 + 1e-9)


@pytest.mark.parametrize("text", ["spring_nonlinearity:form=odd", "foot_slip:form=odd", "touchdown_impact:form=odd"])
def test_an_unknown_form_is_refused(text):
    with pytest.raises(ConfigError, match="allowed"):
        parse(text)
