# SPDX-License-Identifier: BSD-3-Clause
"""What is learnt from cases with known answers, on made-up comparisons."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coman_reduced_model.cli.judge_tables import show_left_out
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.diagnose.inference.decide import NO_ALARM, odds
from coman_reduced_model.diagnose.inference.explanation import Explanation
from coman_reduced_model.diagnose.physics.hypotheses import Candidate
from coman_reduced_model.judge.learn import (
    coverage,
    interval_factors,
    learn_leftover,
    parameter_errors,
    with_leftover,
)
from coman_reduced_model.judge.learn_variability import learn_repeats
from coman_reduced_model.judge.score import rate
from coman_reduced_model.judge.weights import (
    AXES,
    Example,
    by_left_out,
    learn_alarm,
    learn_decision,
    outcome,
    summary,
    verdict_of,
)

NOMINAL = replace(load_nominal(), leftover={"spring|single": (1.0, 0.3)})


def example(kind: str, gain: float, left: float = 1.0, error: float = 0.0) -> Example:
    """A case with a payload, or none, whose evidence is `gain`; its mass is wrong by `error` deviations."""
    effects = [{"name": "payload", "where": "", "parameters": {"mass": 1.0}}] if kind in ("single", "pair") else []
    answer = {"kind": kind, "levels": ["strong"], "effects": effects, "worlds": dict.fromkeys(AXES, "usual"),
              "wanted": ["strong"], "attempt": 0}  # fmt: skip

    def row(name: str, gain: float) -> dict:
        parameters = {"mass": [0.0, 1.0 + 0.1 * error, 0.1, False]} if name else {}
        leftover = {"spring|single": left}
        return {
            "name": name, "where": "", "gain": gain, "confirmed": gain, "ways": 1, "leftover": leftover,
            "pulled": {}, "together": 0.0, "parameters": parameters,
        }  # fmt: skip

    return Example(answer, NOMINAL, [row("", 0.0), row("payload", gain)])


@pytest.fixture(scope="module")
def examples():
    rng = np.random.default_rng(0)
    clean = [example("clean", rng.normal(0.0, 2.0), np.exp(0.3 * rng.normal())) for _ in range(30)]
    single = [example("single", rng.uniform(10.0, 60.0)) for _ in range(20)]
    outside = [example("unknown", rng.normal(0.0, 2.0), np.exp(rng.uniform(1.5, 3.0))) for _ in range(10)]
    return [*clean, *single, *outside]


def test_weights_separate_what_the_features_separate(examples):
    decision = learn_decision(examples)
    weights = decision["selected"]
    found = [(each, outcome(each, decision)) for each in examples]
    assert all(sum(p.values()) == pytest.approx(1.0) for _, p in found)
    said = summary([(example, p, verdict_of(p, {"alarm": 0.5})) for example, p in found])
    assert said["cases"] == 60
    assert said["right"]["share"] == 1.0 and said["right"]["of"] == 20 and said["wrong"]["share"] == 0.0
    assert said["false_alarms"]["hits"] <= 2 and said["false_alarms"]["of"] == 30 and said["unknown"]["of"] == 10
    assert all(weights[name] >= 0.0 for name in ("evidence", "leftover", "pulled"))


def test_kinds_of_worlds_are_left_out_one_by_one(examples, capsys):
    """On soft floors, where the evidence for an effect is large also on clean robots, the other kinds say too much."""
    rng = np.random.default_rng(1)
    soft = [example("clean", rng.uniform(20.0, 40.0)) for _ in range(10)]
    soft = [
        replace(each, answer={**each.answer, "worlds": {**each.answer["worlds"], "contact": "soft"}}) for each in soft
    ]
    again = [replace(each, answer={**each.answer, "attempt": 5}) for each in examples[:5]]
    again[:3] = [replace(each, answer={**each.answer, "wanted": ["none"]}) for each in again[:3]]
    found = by_left_out([*again, *examples[5:], *soft])
    assert list(found) == ["contact"]  # the only axis with two kinds, and each with enough others
    kinds = found["contact"]
    assert kinds["soft"]["false_alarms"] == rate(10, 10) and kinds["usual"]["cases"] == len(examples)
    assert kinds[""]["cases"] == len(examples) + 10
    show_left_out({"population": found, "with_baseline": {}, "source": {"commit": "0", "cases": 70}}, Path("x.json"))
    printed = capsys.readouterr().out
    lines = [line.rstrip() for line in printed.splitlines() if line.startswith(" contact")]
    assert [line.split()[1] for line in lines] == ["all,", "soft", "usual"]
    assert [line[-5:].strip() for line in lines] == ["5, 3", "0, 0", "5, 3"]
    assert printed.count("by weights that were learnt on all others") == 1  # nothing with a baseline, no table


def test_an_alarm_is_what_one_clean_robot_in_a_hundred_raises(examples):
    decision = learn_decision(examples)
    none = sorted(outcome(each, decision)["none"] for each in examples[:30])
    assert none[0] < decision["selected"]["alarm"] < none[1]  # of thirty the lowest, about
    assert learn_alarm(examples[30:], decision) == NO_ALARM  # without a clean robot nothing is known of alarms


def test_what_is_pulled_as_on_no_clean_robot_is_an_alarm(examples):
    decision = learn_decision(examples)
    assert decision["selected"]["together"] == 0.0
    nothing, *rivals = examples[0].rows
    pulled = replace(examples[0], rows=[{**nothing, "together": 0.5}, *rivals])
    weights, together = decision["selected"], pulled.rows[0]["together"]
    assert verdict_of({"none": 0.9, "unknown": 0.1}, weights) == "none"
    assert verdict_of({"none": 0.9, "unknown": 0.1}, weights, together) == "unknown"
    assert verdict_of({"none": 0.4, "payload": 0.6, "unknown": 0.0}, {**weights, "alarm": 0.1}, together) == "payload"
    assert "together" not in learn_decision(examples[30:])["selected"]


@pytest.mark.parametrize("confirmed", [30.0, np.nan])
def test_probabilities_are_those_of_the_diagnosis(examples, confirmed):
    """Of an effect that selecting recordings show, and of one that they do not."""
    decision = learn_decision(examples)
    case = examples[35]
    case = replace(case, rows=[case.rows[0], {**case.rows[1], "confirmed": confirmed}])
    given = [(row["gain"], row["confirmed"], row["ways"], row["leftover"], row["pulled"], 0.0) for row in case.rows]
    options = [None, Candidate("payload", "", ())]
    explanations = [Explanation(option, None, *values) for option, values in zip(options, given, strict=True)]
    found = odds(explanations, replace(case.nominal, decision=decision))
    p = outcome(case, decision)
    assert (found.none, found.unknown, *found.effects) == pytest.approx((p["none"], p["unknown"], p["payload"]))


@pytest.mark.parametrize(
    ("none", "payload", "alarm", "said"),
    [(0.2, 0.7, 0.1, "none"), (0.05, 0.7, 0.1, "payload"), (0.05, 0.4, 0.1, "unknown"), (0.55, 0.4, 0.6, "payload")],
)
def test_a_name_needs_an_alarm_and_to_be_as_likely_as_all_else_that_may_be_missing(none, payload, alarm, said):
    p = {"none": none, "payload": payload, "unknown": 1.0 - none - payload}
    assert verdict_of(p, {"alarm": alarm}) == said


def test_a_fold_is_compared_with_what_laws_leave_on_the_others(examples):
    worse = [
        replace(each, rows=[{**row, "leftover": {"spring|single": 9.0}} for row in each.rows]) for each in examples
    ]
    compared = [*((0, each) for each in examples), *((1, each) for each in worse)]
    _, others, found = with_leftover(NOMINAL, [NOMINAL, NOMINAL], compared)
    assert others[0].leftover["spring|single"][0] == pytest.approx(9.0) == found[0].nominal.leftover["spring|single"][0]
    assert others[1].leftover["spring|single"][0] == pytest.approx(1.0, rel=0.25) and found[-1].nominal is others[1]


def test_without_selecting_recordings_their_evidence_has_no_weight(examples):
    other = [replace(each, rows=[{**row, "confirmed": -5.0} for row in each.rows]) for each in examples]
    assert learn_decision(other)["alone"] == learn_decision(examples)["alone"]


def test_training_and_selecting_recordings_must_both_show_an_effect():
    case = example("single", 40.0)
    denied = replace(case, rows=[case.rows[0], {**case.rows[1], "confirmed": -3.0}])
    alone = replace(case, rows=[case.rows[0], {**case.rows[1], "confirmed": None}])
    assert denied.features[1]["evidence"] < 0.0 < alone.features[1]["evidence"] == case.features[1]["evidence"]


def test_what_laws_leave_is_learnt_from_clean_robots_alone(examples):
    median, scatter = learn_leftover(examples)["spring|single"]
    assert median == pytest.approx(1.0, rel=0.25) and 0.15 <= scatter < 0.6


def test_what_repeats_is_the_median_of_clean_robots():
    robots = [{"spring|any": 1e-4, "torque|any": 0.0}, {"spring|any": 2e-4, "torque|any": 0.0}, {"spring|any": 1.0}]
    assert learn_repeats(robots) == {"spring|any": 2e-4}


def test_intervals_become_as_long_as_they_must_be():
    assert interval_factors([]) == {"all": 1.0}
    exact = [example("single", 30.0, error=0.1) for _ in range(20)]
    assert interval_factors(exact) == {"all": 1.0, "payload": 1.0}
    rough = [example("single", 30.0, error=float(e)) for e in 3.0 * np.random.default_rng(2).normal(size=400)]
    found = interval_factors(rough)
    assert found["payload"] == pytest.approx(3.0, rel=0.1) == found["all"]


def test_where_a_load_is_is_judged_by_its_moment_as_it_is_fitted():
    case = example("single", 30.0)
    load = {"name": "payload", "where": "", "parameters": {"mass": 2.0, "x": 0.05}}
    row = {**case.rows[1], "parameters": {"mass": [0.0, 2.3, 0.1, False], "x": [0.0, 0.12, 0.01, False]}}
    found = parameter_errors([replace(case, answer={**case.answer, "effects": [load]}, rows=[case.rows[0], row])])
    assert found["payload"] == pytest.approx([3.0, 2.0])


def test_an_effect_that_could_be_in_two_ways_is_judged_by_its_better_one():
    cases = [example("single", 30.0, error=float(e)) for e in np.random.default_rng(2).normal(size=100)]
    other = example("single", -3.0, error=70.0).rows[1]
    for ways in ([0, 1], [1, 0]):
        both = [replace(each, rows=[each.rows[0], *((each.rows[1], other)[k] for k in ways)]) for each in cases]
        assert interval_factors(both) == interval_factors(cases)


def test_intervals_of_one_effect_do_not_become_longer_by_those_of_another():
    rough = [example("single", 30.0, error=float(e)) for e in np.linspace(-8.0, 8.0, 40)]
    other = {"name": "backlash", "where": "", "parameters": {"mass": 1.0}}
    exact = [
        replace(
            each, answer={**each.answer, "effects": [other]}, rows=[each.rows[0], {**each.rows[1], "name": "backlash"}]
        )
        for each in (example("single", 30.0, error=float(e)) for e in np.random.default_rng(3).normal(size=40))
    ]
    found = interval_factors([*rough, *exact])
    assert found["backlash"] < 1.5 < 2.0 < found["all"] < found["payload"]
    both = [replace(each, answer={**each.answer, "seed": seed}) for seed, each in enumerate([*rough, *exact])]
    assert 0.9 <= coverage(both)["share"] <= 1.0 and coverage(both)["of"] == 80
