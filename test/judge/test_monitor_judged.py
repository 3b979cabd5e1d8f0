# SPDX-License-Identifier: BSD-3-Clause
"""The monitor, judged: effects that begin in mid-walk, hours of clean walking, and their figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import poisson

from coman_reduced_model.judge import hours
from coman_reduced_model.judge.cases import ATTEMPTS
from coman_reduced_model.judge.monitor import alarms, delays, draw_onset, families_with_onset
from coman_reduced_model.judge.sudden import beginning
from coman_reduced_model.sim.describe import mujoco_spec
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.spring_laws import SpringLaws
from coman_reduced_model.sim.worlds.draw import plain_kinds


def test_families_take_turns_in_beginning_in_mid_walk():
    able = families_with_onset()
    onsets = [draw_onset(seed) for seed in range(len(able))]
    assert [onset.family for onset in onsets] == able and len(able) > 20
    for onset in onsets:
        assert 7.0 <= onset.after <= 10.0 and onset.world.duration_s == 17.0
    again = draw_onset(3, attempt=1)
    assert again.family == onsets[3].family and again.world.kinds == onsets[3].world.kinds
    assert draw_onset(3, worlds={"contact": "creeping"}).world.kinds["contact"] == "creeping"


def test_what_changes_the_robots_build_begins_as_forces_or_not_at_all():
    assert beginning(make("body_mass", {"where": "LKneeSag", "scale": 1.5}), 5.0) is None
    assert beginning(make("encoder_bias", {"where": "LKneeSag", "bias": 0.01}), 5.0) is not None
    assert beginning(make("payload", {"mass": 1.0}), 5.0) is not None


@pytest.mark.parametrize(("effect", "share"), [("joint_stiffness", "stiffness"), ("joint_damping", "damping")])
def test_springs_that_change_in_mid_walk_transmit_their_change_from_then_on(effect, share):
    later = beginning(make(effect, {"where": "LKneeSag", "scale": 1.5}), 5.0)
    later.start(COMAN, mujoco_spec(COMAN).compile(), np.random.default_rng(0))
    springs = SpringLaws.of(later.spring_laws(), 12)
    deflection, rate = (0.02, 0.0) if share == "stiffness" else (0.0, 0.3)
    torque = springs.torque(6.0, np.full(12, deflection), np.full(12, rate))
    wanted = 0.5 * getattr(COMAN.joints()[3], share) * (deflection + rate)
    assert torque == pytest.approx(np.where(np.arange(12) == 3, wanted, 0.0))
    assert not springs.torque(4.9, np.full(12, deflection), np.full(12, rate)).any()


def test_an_alarm_before_the_effect_says_nothing_of_its_delay():
    base = {"fell": False, "failed": "", "attempt": 0}
    rows = [
        {**base, "detections": [{"after_s": 2.0, "channel": "force"}, {"after_s": 1.0, "channel": "spring"}]},
        {**base, "detections": [{"after_s": -3.0, "channel": "force"}, {"after_s": 1.0, "channel": "force"}]},
        {**base, "detections": [{"after_s": 5.5, "channel": "force"}]},
        {**base, "detections": []},
        {**base, "fell": True, "attempt": 3, "lowered": True, "detections": [{"after_s": 0.5, "channel": "force"}]},
    ]
    found = delays(rows)
    assert (found["redrawn"], found["lowered"]) == (1, 1)
    assert (found["walks"], found["fell"], found["alarm_before"]) == (5, 1, 1)
    assert (found["detected"]["hits"], found["detected"]["of"]) == (1, 3) and found["median_s"] == 5.5
    assert delays(rows[1:4])["median_s"] is None  # most are not detected


def test_alarms_in_an_hour_have_the_interval_of_a_poisson_process():
    walk = {"failed": "", "seconds": 900.0, "alarms": [], "attempt": 0}
    found = alarms([walk, {**walk, "alarms": ["force/z", "spring/LKneeSag"], "attempt": 1}])
    assert found["hours"] == 0.5 and found["alarms_per_hour"] == 4.0 and found["redrawn"] == 1
    low, high = (limit * found["hours"] for limit in found["interval_per_hour"])
    below = poisson.cdf([1, 2], [low, high])  # two alarms or more at `low`, two or fewer at `high`
    assert 1.0 - below[0] == pytest.approx(0.025) and below[1] == pytest.approx(0.025)
    none = alarms([walk])["interval_per_hour"]
    assert none[0] == 0.0 and none[1] * 0.25 == pytest.approx(-np.log(0.025))
    assert alarms([])["interval_per_hour"] is None


def test_long_walks_go_on_until_their_hours_are_walked(tmp_path, monkeypatch):
    log = tmp_path / "log"  # walks run in other processes

    def watched(world, noise):
        with log.open("a") as file:
            file.write(f"{world.kinds['gait']} {noise}\n")
        failed = "no clock" if len(log.read_text().splitlines()) == 2 else ""
        return {"failed": failed, "seconds": 0.0 if failed else 120.0, "alarms": []}

    monkeypatch.setattr(hours, "_watched", watched)
    rows = hours.run_hours(tmp_path, [4, 5], 4 * 120.0 / 3600.0)
    assert [row["seed"] for row in rows] == [4, 5, 4, 5, 4] and sum(row["seconds"] for row in rows) == 480.0
    made = log.read_text().splitlines()
    assert len(set(made)) == 5 and made[0].split()[0] != made[2].split()[0]  # another gait in each round
    assert hours.run_hours(tmp_path, [4, 5], 4 * 120.0 / 3600.0) == rows
    assert hours.run_hours(tmp_path, [4, 5], 0.0) == rows  # without --hours all that were walked count
    assert log.read_text().splitlines() == made  # what exists is kept
    monkeypatch.setattr(hours, "_watched", lambda *_: {"failed": hours.FALLS, "seconds": 0.0, "alarms": []})
    assert {row["attempt"] for row in hours.run_hours(tmp_path / "falls", [4, 5], 1.0)} == {ATTEMPTS - 1}


@pytest.mark.slow
def test_a_long_walk_leaves_its_figures_and_no_bag(tmp_path, monkeypatch):
    monkeypatch.setattr(hours, "LONG_S", 6.0)
    (row,) = hours.run_hours(tmp_path, [3], 5.0 / 3600.0, worlds=plain_kinds())
    assert row["failed"] == "" and 5.0 < row["seconds"] < 7.0 and row["worlds"]["length"] == "6 s"
    assert [path.name for path in tmp_path.rglob("*.*")] == ["3_0.json"]
    assert hours.run_hours(tmp_path / "again", [3], 5.0 / 3600.0, worlds=plain_kinds()) == [row]
