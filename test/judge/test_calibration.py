# SPDX-License-Identifier: BSD-3-Clause
"""Whether probabilities, intervals and promises of diagnoses are counted as they should be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coman_reduced_model.cli.judge_tables import show_diagnosis
from coman_reduced_model.judge.calibration import calibration, most_likely, power, reliability, roc, truth_of
from coman_reduced_model.judge.score import score


def case(kind: str, probabilities: dict[str, float], *effects: tuple[str, str], **more) -> dict:
    """`more`: level, verdict, and parts of the verdict."""
    level, verdict = more.pop("level", "medium"), more.pop("verdict", "none")
    values = more.pop("values", {})
    answer = {
        "seed": 1000, "kind": kind, "robot": "coman", "attempt": 0, "worlds": {"engine": "mujoco"},
        "wanted": [level] * len(effects), "levels": [level] * len(effects), "families": [name for name, _ in effects],
        "effects": [{"name": n, "where": w, "parameters": values} for n, w in effects],
    }  # fmt: skip
    said = {"verdict": verdict, "effects": [], "probabilities": probabilities, **more}
    return {"name": "one", "answer": answer, "verdict": said}


def test_places_and_members_of_a_class_count_together():
    lag = case("single", {"none": 0.4, "motor_lag": 0.25, "transport_delay@plan": 0.35}, ("transport_delay", ""))
    assert most_likely(lag) == (pytest.approx(0.6), True)
    assert truth_of(lag, alike=False) == pytest.approx(0.6)
    pair = case(
        "pair", {"none": 0.1, "payload": 0.5, "backlash@LKneeSag": 0.4}, ("payload", ""), ("backlash", "RKneeSag")
    )
    assert truth_of(pair, alike=False) == pytest.approx(0.9)


def test_what_cannot_be_distinguished_from_the_truth_counts_in_its_group_alone():
    found = case(
        "single", {"none": 0.2, "payload": 0.3, "com_offset": 0.4, "backlash@left": 0.1}, ("payload", ""),
        groups=[["payload", "com_offset"], ["backlash@left", "backlash"]],
    )  # fmt: skip
    assert truth_of(found, alike=False) == pytest.approx(0.3) and truth_of(found, alike=True) == pytest.approx(0.7)
    assert most_likely(found) == (pytest.approx(0.4), False)


def test_reliability_of_statements_that_are_as_likely_as_they_say():
    rng = np.random.default_rng(3)
    said = [(p, bool(rng.random() < p)) for p in rng.uniform(0.2, 1.0, 4000)]
    rows, error = reliability(said)
    assert error < 0.03 and sum(n for *_, n in rows) == 4000
    assert all(abs(p - right) < 0.1 for p, right, _ in rows)
    assert reliability([(0.95, False)] * 10)[1] == pytest.approx(0.95)
    assert reliability([]) == ([], None)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_the_area_is_the_share_of_pairs_in_the_right_order(clean, others):
    found = roc(clean, others)
    pairs = [(b > a) + 0.5 * (b == a) for a in clean for b in others]
    assert found["area"] == pytest.approx(np.mean(pairs))
    assert all(0.0 <= share <= 1.0 for share in found["found"]) and np.all(np.diff(found["found"]) >= 0.0)


def test_the_size_that_is_seen_nine_times_in_ten():
    rng = np.random.default_rng(4)
    sizes = np.exp(rng.uniform(-1.5, 2.0, 3000))
    seen = rng.random(3000) < 1.0 / (1.0 + np.exp(-3.0 * np.log(sizes / 1.2)))  # of 1.2, every second
    found = power(list(zip(sizes, seen, strict=True)))
    assert found["of"] == 3000
    assert found["factor"] == pytest.approx(1.2 * np.exp(np.log(9.0) / 3.0), rel=0.08)
    assert power([(1.0, True)] * 20)["factor"] is None and power([])["factor"] is None
    small = [(size, hit) for size, hit in zip(sizes, seen, strict=True) if size < 2.0]
    assert power(small) == {"of": len(small), "factor": None}, "no size there is seen nine times in ten"


def test_the_figures_of_a_run_are_printed(capsys, tmp_path):
    seen = {"undetectable_below": {"payload": {"mass": 0.5}}}
    named = [{"name": "payload", "where": "", "parameters": {"mass": {"value": 1.1, "interval": [0.9, 1.3]}}}]
    cases = [
        case("clean", {"none": 0.9, "payload": 0.1}),
        case("clean", {"none": 0.7, "payload": 0.3}),
        case("single", {"none": 0.2, "payload": 0.8}, ("payload", ""), verdict="effect", effects=named,
             values={"mass": 1.0}, **seen),
        case("single", {"none": 0.8, "payload": 0.2}, ("payload", ""), values={"mass": 0.2}, **seen),
        case("unknown", {"none": 0.3, "unknown": 0.7}, ("cogging", "LHipSag"), level="strong", verdict="unknown"),
    ]  # fmt: skip
    found = calibration(cases)
    assert found["truth"] == pytest.approx(0.5) and found["intervals"] == [1, 1]
    assert found["outside"] == {"unknown": 1} and found["roc"]["area"] == pytest.approx(0.75)
    assert found["power"] == {"of": 2, "factor": None}
    assert calibration([{**cases[0], "verdict": None}])["cases"] == 0
    result = score([{**each, "oracle": None, "baselines": {}, "run": None, "ranking": None} for each in cases])
    assert result["calibration"] == found
    more = {"commit": "abc", "verdicts_sha256": "0" * 64, "round": 1}
    show_diagnosis({**result, **more}, tmp_path)
    said = capsys.readouterr().out
    assert "mean probability of the truth, medium and strong: 0.50" in said and "hold 1 of 1 true values" in said
