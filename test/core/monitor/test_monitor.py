# SPDX-License-Identifier: BSD-3-Clause
"""The monitor in use: no alarm on a nominal robot, and the right channel in time when an effect begins in mid-walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from monitor_tools import (
    BEGINS,
    FEET,
    KNEE,
    LEVEL,
    LOADED,
    WITHIN,
    detected_in_time,
    mismatches,
    turned,
    watched,
    watching,
)
from scipy.spatial.transform import Rotation
from synthetic import JOINTS, MOTORS, RIGHT, T0, names, robot, walk, write_bag

from coman_reduced_model.core.base.input_warning import WarningKind
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.monitor.laws import LANDED_S, Laws
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.record import record


@pytest.mark.slow
def test_encoder_slip_in_mid_walk_is_detected_within_five_seconds(tmp_path, capsys):
    def change(stream, message):
        late = (message.stamp_ns - T0) * 1e-9 >= BEGINS
        return turned(message, KNEE, 0.012) if stream == JOINTS and late else message

    bag = write_bag(tmp_path / "walk", walk(13.0), change)
    found = mismatches(bag, tmp_path / "out")
    first = next(each for each in found if each["channel"] == "spring/LKneeSag")
    assert first["changed"] and first["unit"] == "rad" and all(each["detected_s"] > BEGINS for each in found)
    assert BEGINS < first["detected_s"] <= BEGINS + WITHIN and first["size"] == pytest.approx(-0.012, abs=0.001)
    assert "spring/LKneeSag changed by -1" in capsys.readouterr().err
    assert mismatches(bag, tmp_path / "off", "--set", "monitor.enabled=false") == []


def test_stamps_that_jitter_leave_no_look_out():
    rng = np.random.default_rng(0)

    def jittering(stream, t, message):
        return replace(message, stamp_ns=message.stamp_ns + round(1e5 * rng.uniform(-1.0, 1.0)))

    looks = [int(watched(each, 5.0).laws.forces.memory.state["count"][0]) for each in (lambda *m: m[2], jittering)]
    assert looks[0] > 450 and looks[1] == pytest.approx(looks[0], rel=0.02)


@pytest.mark.slow
def test_missing_streams_leave_the_other_channels():
    """Without motor side, torques and IMU: `feet` shows a link encoder, `unloaded` a foot sensor."""

    def slipped(stream, t, message):
        if stream == JOINTS:
            message = replace(message, effort=None)
            return turned(message, KNEE, 0.012) if t >= BEGINS else message
        return message

    poor = {"skip": (MOTORS,), "prediction.reference": "none"}
    first = detected_in_time(watched(slipped, **poor).first.values(), "feet/pitch")
    assert first.size == pytest.approx(-0.012, abs=0.003)

    def biased(stream, t, message):
        if stream == RIGHT and t >= BEGINS:
            return replace(message, torque=message.torque + [0.0, 1.0, 0.0])
        return slipped(stream, 0.0, message)

    assert detected_in_time(watched(biased, **poor).first.values(), "unloaded/right/ty").size == pytest.approx(
        1.0, 0.05
    )


@pytest.mark.slow
def test_friction_that_begins_shows_in_drag():
    def change(stream, t, message):
        if stream != JOINTS or t < BEGINS:
            return message
        effort = message.effort.copy()
        effort[KNEE] += 2.0 * np.tanh(message.velocity[KNEE] / 0.02)
        return replace(message, effort=effort)

    first = detected_in_time(watched(change).first.values(), "drag/LKneeSag")
    assert first.unit == "Nm" and first.size == pytest.approx(2.0, rel=0.4)
    assert "drag/RKneeSag" not in watched(change).first


def test_softer_spring_with_zero_mean_load_shows_in_stiffness():
    """An ankle oscillates by half a milliradian (RMS); from then on its drive yields twice as much."""
    joint, k = names().index("RAnkLat"), Config().robot.right.stiffness[-1]

    def change(stream, t, message):
        bend = 0.0007 * np.sin(2.0 * np.pi * t / 0.3)  # as often as there are support phases
        if stream == MOTORS:
            return turned(message, joint, bend * (2.0 if t >= BEGINS else 1.0))
        if stream == JOINTS:
            message = replace(message, effort=message.effort.copy())
            message.effort[joint] += k * bend
        return message

    found = watched(change).first
    first = detected_in_time(found.values(), "stiffness/RAnkLat")
    assert first.unit == "rad" and first.size == pytest.approx(0.0005, rel=0.25)
    assert "spring/RAnkLat" not in found and len(found) == 1


@pytest.mark.slow
def test_spring_under_a_higher_load_is_no_softer_spring():
    """12 Nm more on a knee, whose spring is 5 % softer than described, as a nominal one may be; then on a worse one."""

    def watch(softer):
        def change(stream, t, message):
            if t < BEGINS or stream not in (JOINTS, MOTORS):
                return message
            if stream == MOTORS:
                return turned(message, KNEE, softer * 12.0 / 180.0)
            effort = message.effort.copy()
            effort[KNEE] += 12.0
            return replace(message, effort=effort)

        return "spring/LKneeSag" in watched(change).first

    assert not watch(1.05) and watch(1.4)


@pytest.mark.slow
def test_damped_spring_has_its_stiffness_at_any_rate():
    """From 7 s on k s + d s' = 5 Nm sin(w t), in closed form, at 3.3 Hz; without its damper the slope looks changed.

    No foot force balances that torque: laws other than those of springs do not hold.
    """
    leg = Config().robot.left
    k, d = leg.stiffness[3], leg.damping[3]
    w = 2.0 * np.pi / 0.3
    size, behind = 5.0 / np.hypot(k, w * d), np.arctan(w * d / k)

    def change(stream, t, message):
        if t < BEGINS:
            return message
        if stream == MOTORS:
            return turned(message, KNEE, size * np.sin(w * t - behind))
        if stream == JOINTS:
            message = replace(message, effort=message.effort.copy())
            message.effort[KNEE] += 5.0 * np.sin(w * t)
        return message

    assert not [channel for channel in watched(change).first if channel.split("/")[0] in ("spring", "stiffness")]
    undamped = {"robot.left.damping": [*leg.damping[:3], 0.0, *leg.damping[4:]]}
    assert "stiffness/LKneeSag" in watched(change, **undamped).first


@pytest.mark.slow
def test_intermittent_force_shows_in_unsteady():
    def change(stream, t, message):
        if stream not in FEET.values() or t < BEGINS:
            return message
        return replace(message, force=message.force + [0.0, 0.5 * 8.0 * np.sin(2.0 * np.pi * 1.3 * t), 0.0])

    found = watched(change, imu=lambda t: LEVEL).first
    first = detected_in_time(found.values(), "unsteady/y")
    assert first.unit == "N" and 2.0 < first.size < 8.0 and "unsteady/x" not in found
    assert not any(
        channel.startswith("unsteady") for channel in watched(change).first
    )  # without an IMU it is not distinguished from rocking soles


@pytest.mark.slow
@pytest.mark.parametrize(("reset", "lasts"), [(np.inf, True), (12.0, False)])
def test_after_a_reset_an_intermittent_force_is_the_normal_state(reset, lasts):
    def change(stream, t, message):
        if stream not in FEET.values() or t < BEGINS:
            return message
        return replace(message, force=message.force + [0.0, 0.5 * 8.0 * np.sin(2.0 * np.pi * 1.3 * t), 0.0])

    monitor = watched(change, 16.0, imu=lambda t: LEVEL, reset=reset)
    assert ("unsteady/y" in {each.channel for each in monitor.mismatches}) == lasts


@pytest.mark.slow
def test_an_imu_may_be_mounted_in_any_orientation():
    """A push from the side while the robot tips on its toes, where only an IMU shows that the force is horizontal."""
    front = float(robot().soles[Foot.LEFT][1])

    def change(stream, t, message):
        if stream not in FEET.values() or t < BEGINS or message.force[2] < 1.0:
            return message
        toes = [0.0, -(front - 0.001) * message.force[2], 0.0]
        return replace(message, force=message.force + [0.0, 10.0, 0.0], torque=message.torque + toes)

    mounted = Rotation.from_euler("xyz", [1.0, 0.3, -2.0])
    aligned, turned_about = (watched(change, imu=lambda t: LEVEL, mounted=m).first for m in (None, mounted))
    assert "force/y" in aligned and set(aligned) == set(turned_about)
    for channel, each in aligned.items():
        assert turned_about[channel].size == pytest.approx(each.size, rel=1e-6, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("poor", [False, True])
def test_mismatch_is_reported_while_it_lasts_and_when_it_recurs(poor):
    """Between two slips the encoder is right for 8 s; without motor positions `feet`, which drifts, shows it."""

    def change(stream, t, message):
        if stream == JOINTS and poor:
            message = replace(message, effort=None)
        slipped = BEGINS < t < 30.0 or t > 38.0
        return turned(message, KNEE, 0.012) if stream == JOINTS and slipped else message

    less = {"skip": (MOTORS,), "prediction.reference": "none"} if poor else {}
    channel = "feet/pitch" if poor else "spring/LKneeSag"
    looks = {29.0: True, 37.5: False, 44.0: True}
    found = {}
    for t, monitor in watching(change, 44.1, **less):
        if (seconds := round(t, 3)) in looks:
            found[seconds] = channel in {each.channel for each in monitor.mismatches}
    assert found == looks


@pytest.mark.slow
def test_mismatch_is_dropped_where_no_phase_ends_any_more():
    """The wrenches are lost for good: after 10 s nothing is known of it."""

    def change(stream, t, message):
        if stream not in FEET.values() or t < BEGINS:
            return message
        return replace(message, force=message.force + [0.0, 10.0, 0.0]) if t < 11.0 else None

    seen, hidden = ({each.channel for each in watched(change, until).mismatches} for until in (11.0, 25.0))
    assert seen >= {"force/y"} and not hidden


@pytest.mark.slow
def test_mismatch_that_cannot_be_observed_any_more_is_dropped():
    """A lateral force, then the robot stands on its toes, which hides it: dropped after 10 s."""
    front = float(robot().soles[Foot.LEFT][1])

    def change(stream, t, message):
        if stream not in FEET.values() or t < BEGINS or message.force[2] < LOADED:
            return message
        if t < 11.0:
            return replace(message, force=message.force + [0.0, 10.0, 0.0])
        return replace(message, torque=message.torque + [0.0, -(front - 0.001) * message.force[2], 0.0])

    seen, hidden = ({each.channel for each in watched(change, until).mismatches} for until in (11.0, 25.0))
    assert seen >= {"force/y"} and not hidden


def test_large_offset_is_detected_in_gaits_that_never_repeat():
    def change(stream, t, message):
        if stream not in (JOINTS, MOTORS):
            return message
        message = replace(message, position=message.position + 0.08 * (int(t / 1.2) % 3))
        return turned(message, KNEE, -0.02) if stream == JOINTS and t >= BEGINS else message

    found = watched(change).first["spring/LKneeSag"]
    assert 0.0 < (found.detected_ns - T0) * 1e-9 - BEGINS < WITHIN


@pytest.mark.parametrize(("share", "detected"), [(0.96, False), (0.6, True)])
def test_offset_from_the_start_is_detected_beyond_the_scatter_of_nominal_robots(share, detected):
    def change(stream, t, message):
        if stream == MOTORS:
            return turned(message, KNEE, 8.0 / (share * 180.0) - 0.01)
        if stream == JOINTS:
            message.effort[KNEE] = 8.0
        return message

    found = watched(change, 6.0).mismatches
    assert [each.channel for each in found] == (["spring/LKneeSag"] if detected else [])
    assert not any(each.changed for each in found)


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "lasts"), [(0.4, True), (11.0, False)])
def test_what_has_changed_is_reported_after_a_short_gap_too(gap, lasts):
    def change(stream, t, message):
        if 12.0 < t < 12.0 + gap:
            return None
        return turned(message, KNEE, 0.004) if stream == JOINTS and t > 7.0 else message

    monitor = watched(change, 16.0 + gap)
    assert ("spring/LKneeSag" in {each.channel for each in monitor.mismatches}) == lasts
    assert all(each.onset_ns < T0 + 8_000_000_000 for each in monitor.mismatches)


def test_torques_that_stop_or_come_back_change_no_spring():
    """Without them the needed ones take their place, which differ from them."""

    def change(stream, t, message):
        return replace(message, effort=None) if stream == JOINTS and 7.0 < t < 10.0 else message

    assert not {each for each in watched(change, 14.0).first if each.startswith(("spring", "stiffness"))}


@pytest.mark.slow
def test_mismatch_ends_with_its_cause_and_with_the_stream():
    def change(stream, t, message):
        return turned(message, KNEE, 0.02) if stream == JOINTS and 7.0 < t < 11.0 else message

    monitor = watched(change, 11.0)
    assert monitor.mismatches
    monitor.reset()
    assert not monitor.mismatches and monitor.first
    assert not watched(change, 16.0).mismatches


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "channel"),
    [
        ("backlash:where=LKneeSag,width=0.0122", "spring/LKneeSag"),
        ("wrench_scale:where=right,scale=1.07", "force/z"),
        ("wrench_delay:where=right,delay=0.015", "late/right"),
        ("touchdown_impact:impulse=0.7", "landing/z"),
        ("external_force:y=-4.0", "force/y"),
    ],
)
def test_an_effect_that_begins_in_the_virtual_robot(tmp_path, hidden, channel):
    bag = record(
        "test1", tmp_path / "walk", disturbances=[parse(f"{hidden},after={BEGINS}")], seed=7, duration_s=13.5
    ).bag
    found = mismatches(bag, tmp_path / "out")
    first = next(each for each in found if each["channel"] == channel)
    assert BEGINS < first["detected_s"] <= BEGINS + WITHIN
    if channel.startswith("late"):
        assert 0.007 < first["size"] < 0.017 and first["unit"] == "s"
    assert all(each["detected_s"] > BEGINS for each in found)


@pytest.mark.parametrize("rate", [200, 500, 1000])
def test_landing_impulse_does_not_depend_on_rate_and_jitter(rate):
    """A half sine of 10 ms beside a load that rises in 50 ms; not known at a rate that is too low."""
    laws, rng, impulse = Laws(robot(), Config()), np.random.default_rng(rate), 0.7
    where, found = laws.names.index("landing/z"), []
    for _ in range(20):
        laws.begin()
        laws.looks = 1
        stamps = (np.arange(60) + 0.1 * rng.uniform(-1.0, 1.0, 60)) / rate
        for dt, at in zip(np.diff(stamps), stamps[1:] - stamps[1], strict=True):
            if at < LANDED_S:
                half = at + 0.5 / rate
                impact = impulse * np.pi / 0.02 * np.sin(np.pi * half / 0.01) * (half < 0.01)
                laws.land(at, dt, impact + 1000.0 * at)
        found.append(laws.mean(2).values[where])
    assert found == pytest.approx(np.full(20, impulse), rel=0.25) and np.std(found) < 0.1 * impulse
    laws.begin()
    laws.looks = 1
    for at in (0.0, 0.02):
        laws.land(at, 0.02, 50.0)
    assert np.isnan(laws.mean(2).values[where])


def test_a_baseline_of_an_earlier_version_says_nothing_of_the_monitor(tmp_path):
    shipped = load_nominal()
    old = {"spring": {"unit": "rad", "single": 0.0003, "double": 0.0003, "robots": 0.001, "drift": 0.3},
           "feet": {"unit": "rad", "single": 0.001, "double": 0.0005, "robots": 0.003, "drift": 2.0}}  # fmt: skip
    path = tmp_path / "old.yaml"
    path.write_text(yaml.safe_dump({**shipped.plain(), "monitor": old}))
    laws = Laws(robot(), Config().replaced({"monitor.baseline": str(path)}))
    assert laws.nominal == Laws(robot(), Config()).nominal


def test_a_baseline_of_another_robot_is_a_warning(tmp_path):
    path = tmp_path / "usual.yaml"
    for mass, said in ((robot().mass, False), (1.5 * robot().mass, True)):
        source = {"robot": "anna", "mass_kg": mass}
        path.write_text(yaml.safe_dump({**load_nominal().plain(), "source": source}))
        pipeline = Pipeline(robot(), Config().replaced({"monitor.baseline": str(path)}))
        found = [each for each in pipeline.status().warnings if each.kind is WarningKind.BASELINE]
        assert [("anna" in str(each)) for each in found] == [True] * said


def test_a_baseline_has_rows_for_single_channels(tmp_path):
    shipped = load_nominal()
    own = {**shipped.monitor["spring"], "single": 0.5, "usual": 0.002, "usual_load": 0.01, "usual_slope": 0.05}
    path = tmp_path / "own.yaml"
    path.write_text(yaml.safe_dump({**shipped.plain(), "monitor": {**shipped.monitor, "spring/LKneeSag": own}}))
    laws = Laws(robot(), Config().replaced({"monitor.baseline": str(path)}))
    knee, other = laws.names.index("spring/LKneeSag"), laws.names.index("spring/RKneeSag")
    assert laws.noise[0, knee] == 0.5 and laws.noise[0, other] == shipped.monitor["spring"]["single"]
    assert laws.rows[knee] == "spring/LKneeSag" and laws.rows[other] == "spring"
