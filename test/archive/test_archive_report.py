# SPDX-License-Identifier: BSD-3-Clause
"""The report names the robot that changed, since when, and what it was; of robots that did not change, nothing."""

from __future__ import annotations

from datetime import date, timedelta

import numpy as np
import pytest

from coman_reduced_model.archive.change import SURE, find_change
from coman_reduced_model.archive.report.trends import ask
from coman_reduced_model.archive.store import Store
from coman_reduced_model.archive.tables import write_table
from coman_reduced_model.cli.main import run

BEGIN, WEEKS, AT = date(2026, 3, 2), 12, 7  # the change is between week 6 and week 7


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Tables of two robots: `anna` changes and has a payload since, `bert` has one bag that stands out."""
    folder, noise = tmp_path_factory.mktemp("results"), np.random.default_rng(1)
    bags, findings = [], []
    for robot in ("anna", "bert"):
        for week in range(WEEKS):
            changed = robot == "anna" and week >= AT
            error = np.exp(0.1 * noise.normal(size=3)) * 1e-3 * (1.6 if changed else 1.0)
            if (robot, week) == ("bert", 4):
                error[2] = 5e-3
            day = BEGIN + timedelta(weeks=week)
            common = {"robot": robot, "date": day, "bag": f"{robot}/{day}", "archive": "walks", "status": "ok"}
            bags.append({**common, "start_ns": week, **{f"rmse_{a}_m": e for a, e in zip("xyz", error, strict=True)}})
            if week % 2:
                found = {"verdict": "none", "kind": "diagnosis", "period": f"{day:%Y-%m}"}
                if changed:
                    mass = {"name": "mass", "value": 2.0, "low": 1.8, "high": 2.2, "unit": "kg"}
                    found |= {"verdict": "effect", "effect": "payload", "place": "", "parameters": [mass]}
                findings.append({**common, **found})
    bags.append({"robot": "bert", "bag": "bert/lost", "archive": "walks", "status": "bad", "reason": "no messages"})
    store = Store(str(folder))
    write_table(store, "bags", bags)
    write_table(store, "phases", [])
    write_table(store, "findings", findings)
    return folder


def test_the_report_names_robot_effect_and_week(results, capsys):
    assert run(["archive", "report", str(results)]) == 0
    lines = capsys.readouterr().out.splitlines()
    since, week = BEGIN + timedelta(weeks=AT), "2026-W17"
    assert any(line.startswith("anna: error in") and f"since {since} (week {week}" in line for line in lines)
    assert not any(line.startswith("bert") for line in lines)
    page = (results / "report.html").read_text()
    assert f"anna has changed since week {week}" in page and "payload found" in page
    assert "bert/2026-03-30" in page and "error in z 5.00 mm" in page and "no messages" in page
    assert (results / "errors.png").stat().st_size > 1000 and (results / "diagnoses.png").stat().st_size > 1000


def test_diagnoses_of_one_day_are_counted_one_by_one(tmp_path):
    store, day = Store(str(tmp_path)), date(2026, 3, 2)
    common = {"robot": "anna", "date": day, "archive": "walks", "status": "ok", "kind": "diagnosis"}
    findings = [
        {**common, "bag": "before", "hash": "a", "verdict": "none"},
        {**common, "bag": "since", "hash": "b", "verdict": "effect", "effect": "payload", "place": ""},
    ]
    write_table(store, "bags", [{**common, "bag": each["bag"], "hash": each["hash"]} for each in findings])
    write_table(store, "phases", [])
    write_table(store, "findings", findings)
    (row,) = ask(str(tmp_path)).effects
    assert (row["times"], row["since"] + row["before"]) == (1, 2)


def test_a_report_needs_tables(tmp_path, capsys):
    assert run(["archive", "report", str(tmp_path)]) == 2
    assert "no bags.parquet" in capsys.readouterr().err


def test_changes_are_found_where_they_are_and_nowhere_else():
    noise = np.random.default_rng(2)
    alarms = [find_change(noise.normal(size=30)).evidence > SURE for _ in range(500)]
    assert np.mean(alarms) < 0.01
    covered = []
    for _ in range(300):
        found = find_change(noise.normal(size=30) + 1.5 * (np.arange(30) >= 18))
        covered.append(found.earliest <= 18 <= found.latest)
    assert np.mean(covered) > 0.93


def test_too_few_or_equal_values_have_no_change():
    assert find_change(np.arange(4.0)) is None and find_change(np.ones(20)) is None
