# SPDX-License-Identifier: BSD-3-Clause
"""What the channels of the monitor are like, learnt from nominal robots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.monitor.channels import AFTER_LEFT, LEFT, RIGHT, read_row
from coman_reduced_model.diagnose.monitor_rows import PLAUSIBLE, Walk, rows_of_population, rows_of_robot
from coman_reduced_model.errors import BagError
from coman_reduced_model.judge.learn_monitor import learn_monitor

NAMES = ("spring/A", "spring/B", "spring/C", "force/z")
TABLE = {
    "spring": {"unit": "rad", "single": 1.0, "double": 1.0, "by_robot": 1.0, "by_channel": 1.0, "drift": 0.0,
               "robots": 1.0},
    "force": {"unit": "N", "single": 2.0, "double": 2.0, "by_robot": 0.5, "by_channel": 0.5, "drift": 0.0,
              "robots": 0.0},
}  # fmt: skip
ROWS = ("spring", "spring", "spring", "force")


def walk(rng, noise, offset=0.0, phases=20, drift=0.0, slope=0.0, kinds=(LEFT, RIGHT, AFTER_LEFT)):
    """A walk whose channels have a noise (4,) in single support, twice as much in double support with less load."""
    found = []
    for kind in kinds:
        factor, load = (2.0, 0.0) if kind == AFTER_LEFT else (1.0, 0.03)
        level = np.cumsum(rng.normal(0.0, 1.0, (phases, 4)), axis=0) * drift * factor * noise
        values = offset + slope * load + level + rng.normal(0.0, 1.0, (phases, 4)) * factor * noise
        found += [(kind, each, np.array([True, True, True, False]), np.full(4, load)) for each in values]
    rows = {name: read_row(row) for name, row in TABLE.items()}
    return Walk(NAMES, ROWS, rows, found)


def population(drift=0.0):
    """Of 60 robots: the logarithm of the noise scatters by 0.8 from robot to robot and 0.4 from channel to channel."""
    rng = np.random.default_rng(0)
    return [
        walk(rng, 0.1 * np.exp(rng.normal(0.0, 0.8) + rng.normal(0.0, 0.4, 4)), rng.normal(0.0, 3.0, 4), 12, drift)
        for _ in range(60)
    ]


def test_a_population_is_recovered():
    row = rows_of_population(population(), TABLE)["spring"]
    assert row["single"] == pytest.approx(0.1, rel=0.3) and row["double"] == pytest.approx(2.0 * row["single"], rel=0.2)
    assert row["by_robot"] == pytest.approx(0.8, rel=0.25) and row["by_channel"] == pytest.approx(0.4, rel=0.25)
    assert 2.7 < row["robots"] < 4.5 and row["unit"] == "rad"


def test_levels_that_move_are_told_from_noise():
    still, moving = (rows_of_population(population(drift), TABLE)["spring"]["drift"] for drift in (0.0, 0.7))
    assert still < 0.25 and moving == pytest.approx(0.7, abs=0.25)


def test_what_no_robot_shows_stays():
    learnt = rows_of_population(population(), {**TABLE, "late": {"unit": "s", "single": 1.0, "robots": 2.0}})
    assert learnt["late"] == {"unit": "s", "single": 1.0, "robots": 2.0}
    assert learnt["force"]["robots"] == 0.0  # is no law for any robot


def test_one_robot_gets_rows_of_its_own():
    rng, noise = np.random.default_rng(1), np.array([0.01, 0.1, 1.0, 5.0])
    rows = rows_of_robot([walk(rng, noise, np.array([0.5, 0.0, 0.0, 0.0])) for _ in range(3)], TABLE)
    assert rows["spring"] == TABLE["spring"]  # for channels that these recordings do not show
    for name, expected in zip(NAMES, noise, strict=True):
        own = rows[name]
        assert own["single"] == pytest.approx(expected, rel=0.5) or expected <= 0.1  # shrunk to what is usual
        assert own["double"] > own["single"] and own["by_channel"] < 0.12
    assert rows["spring/A"]["single"] < rows["spring/B"]["single"] < 0.3
    assert rows["spring/A"]["usual"] == pytest.approx(0.5, abs=0.02) and rows["spring/A"]["robots"] < 1.0
    assert rows["spring/A"]["usual_load"] == pytest.approx(0.02)
    assert rows["force/z"]["robots"] == 0.0 and "usual" not in rows["force/z"]


def test_a_spring_that_is_softer_than_its_data_sheet_is_usual_at_any_load():
    table = {**TABLE, "spring": {**TABLE["spring"], "robots": 0.002, "by_load": 0.05}}
    rows = {name: read_row(row) for name, row in table.items()}
    walks = [walk(np.random.default_rng(k), np.full(4, 1e-4), 0.001, slope=0.05) for k in range(2)]
    own = rows_of_robot([replace(each, nominal=rows) for each in walks], table)["spring/A"]
    assert own["usual_slope"] == pytest.approx(0.05, rel=0.2) and own["by_load"] < 0.04
    assert own["usual"] == pytest.approx(0.001 + 0.05 * own["usual_load"], rel=0.1)
    assert own["robots"] < 0.5 * rows["spring"].robots


def test_a_robot_that_was_not_well_does_not_make_that_usual():
    walks = [walk(np.random.default_rng(k), np.full(4, 0.1), np.array([9.0, 0.0, 0.0, 0.0])) for k in range(2)]
    row = rows_of_robot(walks, TABLE)["spring/A"]
    assert row["usual"] == pytest.approx(PLAUSIBLE) and row["robots"] <= 1.0


def test_a_support_that_the_recordings_never_show_is_as_noisy_as_the_other():
    rng, noise = np.random.default_rng(1), np.full(4, 10.0)
    rows = rows_of_robot([walk(rng, noise, kinds=(LEFT, RIGHT)) for _ in range(3)], TABLE)
    seen = rows_of_robot([walk(rng, noise) for _ in range(3)], TABLE)["force/z"]
    assert rows["force/z"]["double"] == rows["force/z"]["single"] == pytest.approx(10.0, rel=0.4)
    assert rows["force/z"]["by_channel"] > 2.0 * seen["by_channel"]  # and not as well known


def test_two_recordings_of_three_show_a_channel():
    rng, noise = np.random.default_rng(1), np.ones(4)
    walks = [walk(rng, noise), walk(rng, noise), walk(rng, np.array([1.0, np.nan, 1.0, 1.0]))]
    assert set(NAMES) < set(rows_of_robot(walks, TABLE))
    assert "spring/B" not in rows_of_robot(walks[1:], TABLE)


def test_differences_in_a_row_are_not_independent():
    """White noise that is the same on all channels of all robots scatters by nothing."""
    rng = np.random.default_rng(5)
    learnt = rows_of_population([walk(rng, np.ones(4), phases=8) for _ in range(200)], TABLE)["spring"]
    assert learnt["by_channel"] < 0.09 and learnt["by_robot"] < 0.09


def test_recordings_of_different_robots_are_refused():
    one = walk(np.random.default_rng(0), np.ones(4))
    other = Walk(("spring/A",), ("spring",), one.nominal, [])
    with pytest.raises(BagError, match="not of one robot"):
        rows_of_robot([one, other], TABLE)


def test_learning_from_a_folder_without_robots_says_so(tmp_path):
    with pytest.raises(BagError, match="no clean robot"):
        learn_monitor([tmp_path / "run"], load_nominal(), 1)
