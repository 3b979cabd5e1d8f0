# SPDX-License-Identifier: BSD-3-Clause
"""What a verdict is worth, on verdicts that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coman_reduced_model.cli.judge_tables import show_diagnosis
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.judge.by_kind import by_what_was_learnt
from coman_reduced_model.judge.families import of_this_catalogue
from coman_reduced_model.judge.folder import read_verdict
from coman_reduced_model.judge.foreign import measure
from coman_reduced_model.judge.score import by_world, confusion, gap_reduction, outcome, score
from coman_reduced_model.judge.sizes import shown

# --- the score, on verdicts that are known ---


def verdict_of(*effects: tuple[str, str], **values: float) -> dict:
    parameters = {name: {"value": value} for name, value in values.items()}
    return {"verdict": "effect", "effects": [{"name": n, "where": w, "parameters": parameters} for n, w in effects]}


def hidden(kind: str, *effects: tuple[str, str], level: str = "medium", **values: float) -> dict:
    return {
        "seed": 1000,
        "kind": kind,
        "robot": "coman",
        "attempt": 0,
        "worlds": {"engine": "mujoco", "contact": "creeping"},
        "wanted": [level] * len(effects),
        "families": [name for name, _ in effects],
        "levels": [level] * len(effects),
        "effects": [{"name": n, "where": w, "parameters": values} for n, w in effects],
    }


def minor_of(*effects):
    return {**verdict_of(*effects), "verdict": "none", "only_minor": True}


@pytest.mark.parametrize(
    ("answer", "verdict", "result"),
    [
        (hidden("clean"), {"verdict": "none"}, "none"),
        (hidden("clean"), verdict_of(("payload", "")), "wrong"),
        (hidden("clean"), minor_of(("payload", "")), "wrong"),
        (hidden("single", ("payload", "")), minor_of(("payload", "")), "right"),
        (hidden("single", ("backlash", "LKneeSag")), verdict_of(("backlash", "RKneeSag")), "right"),
        (hidden("single", ("backlash", "LKneeSag")), verdict_of(("backlash", "LKneeSag"), ("payload", "")), "wrong"),
        (hidden("single", ("motor_lag", "")), verdict_of(("transport_delay", "")), "right"),
        (hidden("single", ("motor_lag", "")), verdict_of(("motor_compliance", "")), "wrong"),
        (hidden("single", ("ground_slope", "")), verdict_of(("external_force", "")), "right"),
        (hidden("single", ("backlash", "LKneeSag")), {"verdict": "unknown"}, "unknown"),
        (hidden("single", ("backlash", "LKneeSag")), {"verdict": "not_excited"}, "not_excited"),
        (hidden("pair", ("payload", ""), ("backlash", "")), verdict_of(("payload", ""), ("backlash", "")), "right"),
        (hidden("pair", ("payload", ""), ("backlash", "")), verdict_of(("payload", "")), "partly"),
        (hidden("pair", ("payload", ""), ("backlash", "")), verdict_of(("payload", ""), ("com_offset", "")), "wrong"),
        (hidden("single", ("hysteresis", "LKneeSag")), verdict_of(("backlash", "LKneeSag")), "right"),
        (hidden("single", ("wrench_cross_talk", "left")), verdict_of(("sensor_rotation", "left")), "right"),
        (hidden("single", ("body_mass", "")), verdict_of(("payload", "")), "right"),
        (hidden("single", ("body_mass", "RElbow")), verdict_of(("payload", "")), "right"),
        (hidden("single", ("body_mass", "LKneeSag")), verdict_of(("payload", "")), "wrong"),
        (hidden("unknown", ("sloshing_load", "")), {"verdict": "unknown"}, "unknown"),
        (hidden("unknown", ("sloshing_load", "")), verdict_of(("payload", "")), "wrong"),
        (hidden("clean"), None, "failed"),
        (hidden("clean"), {"verdict": "maybe"}, "failed"),
        (hidden("clean"), {"verdict": "effect", "effects": []}, "failed"),
    ],
)
def test_what_a_verdict_is_worth(answer, verdict, result):
    assert outcome(answer, verdict)["result"] == result


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", '{"verdict": 1}', '{"verdict": "effect", "effects": [{}]}',
        '{"verdict": "effect", "effects": ["payload"]}', '{"verdict": "none", "probabilities": {"none": "all"}}',
        '{"verdict": "effect", "effects": [{"name": "payload", "parameters": {"mass": 1.0}}]}',
    ],
)  # fmt: skip
def test_what_another_tool_writes_in_another_form_is_no_verdict(tmp_path, text):
    (tmp_path / "diagnosis.json").write_text(text)
    assert read_verdict(tmp_path / "diagnosis.json") is None


@pytest.mark.parametrize("text", ['{"verdict": "none"}', '{"verdict": "effect", "effects": null}'])
def test_a_verdict_without_effects_has_none(tmp_path, text):
    (tmp_path / "diagnosis.json").write_text(text)
    found = read_verdict(tmp_path / "diagnosis.json")
    assert found["effects"] == []
    assert outcome(hidden("clean"), found)["result"] == ("none" if "none" in text else "failed")


def test_a_clean_robot_without_a_verdict_is_neither_an_alarm_nor_quiet():
    rows = [(hidden("clean"), {"verdict": "none"}), (hidden("clean"), {"verdict": "unknown"}), (hidden("clean"), None)]
    found = score([{"name": str(k), "answer": a, "verdict": v} for k, (a, v) in enumerate(rows)])["workflow"]
    assert (found["false_alarms_on_clean"]["hits"], found["false_alarms_on_clean"]["of"]) == (1, 2)
    assert found["failed"]["hits"] == 1
    others = [{"hidden": None, "result": result, "named": []} for result in ("right", "wrong", "failed")]
    found = measure(others)
    assert (found["false_alarms"]["hits"], found["false_alarms"]["of"], found["failed"]["hits"]) == (1, 2, 1)
    still = measure([{"hidden": None, "result": "miss", "named": ["not_excited"]}])
    assert (still["false_alarms"]["hits"], still["false_alarms"]["of"]) == (0, 1)


def test_what_was_outside_the_catalogue_when_a_case_was_drawn_may_be_in_it():
    assert of_this_catalogue(hidden("unknown", ("body_mass", "LKneeSag")))["kind"] == "single"
    assert of_this_catalogue(hidden("unknown", ("sloshing_load", "")))["kind"] == "unknown"
    assert of_this_catalogue(hidden("clean"))["kind"] == "clean"


def test_place_and_parameters_of_a_right_name():
    answer = hidden("single", ("joint_stiffness", "left"), scale=0.8)
    found = outcome(answer, verdict_of(("joint_stiffness", "left"), scale=0.85))
    assert found["place"] == [True] and found["error"] == {"joint_stiffness.scale": pytest.approx(0.25)}
    assert outcome(answer, verdict_of(("joint_stiffness", ""), scale=0.8))["place"] == [False]


def test_the_figures_of_known_verdicts():
    def gap(after: float) -> dict:
        rms = {"before": {"com_x": 3.0, "com_z": 1.0}, "after": {"com_x": after, "com_z": 1.0}, "floor": {"com_x": 1.0}}
        return {"gap": {"holdout": rms}}

    slosh = hidden("unknown", ("sloshing_load", ""), level="strong")
    rows = [
        (hidden("clean"), {"verdict": "none"}),
        (hidden("clean"), {"verdict": "none"}),
        (hidden("clean"), {"verdict": "unknown"}),
        (hidden("clean"), verdict_of(("payload", ""))),
        (hidden("single", ("backlash", ""), level="weak"), {"verdict": "none"}),
        (hidden("single", ("backlash", "")), {**verdict_of(("backlash", "")), **gap(2.0)}),
        (hidden("single", ("motor_lag", ""), level="strong"), verdict_of(("transport_delay", ""))),
        (hidden("single", ("payload", ""), level="strong"), verdict_of(("com_offset", ""))),
        (hidden("pair", ("payload", ""), ("backlash", "")), verdict_of(("payload", ""), ("backlash", ""))),
        (hidden("pair", ("payload", ""), ("backlash", "")), verdict_of(("payload", ""))),
        (slosh, {"verdict": "unknown"}),
        (slosh, verdict_of(("payload", ""))),
    ]
    judged = [
        {"name": str(k), "answer": answer, "verdict": verdict, "oracle": gap(1.0), "run": {"seconds": 10.0 + k},
         "baselines": {"always": verdict_of(("payload", ""))}}
        for k, (answer, verdict) in enumerate(rows)
    ]  # fmt: skip
    result = score(judged)

    def share(method: dict, key: str) -> tuple[int, int]:
        return method[key]["hits"], method[key]["of"]

    workflow, always = result["workflow"], result["baselines"]["always"]
    assert share(workflow, "right_on_medium_and_strong") == (2, 3)
    assert share(workflow, "wrong_name") == (1, 6)
    assert share(workflow, "false_alarms_on_clean") == (2, 4)
    assert share(workflow, "unknown_recall_on_strong") == (1, 2)
    assert share(workflow, "both_of_a_pair") == share(workflow, "one_of_a_pair") == (1, 2)
    assert share(always, "right_on_medium_and_strong") == (1, 3)
    assert share(always, "false_alarms_on_clean") == (4, 4)
    assert result["gap_reduction"]["median_share_of_oracle"] == pytest.approx(5.0 / 8.0)
    assert result["seconds"] == {"median": 15.5, "largest": 21.0}
    assert result["confusion"]["motor_lag"] == {"drive_delay": 1}
    assert result["confusion"]["clean"] == {"none": 2, "unknown": 1, "payload": 1}
    assert result["confusion"]["payload"] == {"com_offset": 1}
    assert result["confusion"]["pair"] == {"right": 1, "partly": 1}
    assert result["redrawn"] == {"cases": 0, "lowered": 0}
    assert workflow["both_of_a_pair"]["interval"][0] < 0.5 < workflow["both_of_a_pair"]["interval"][1]


def test_what_is_suspected_without_an_alarm_is_counted_apart():
    """It is no name and no false alarm, and shrinks no gap; what it would be is a column of its own."""

    def suspected(name: str, verdict: str = "none") -> dict:
        gap = {"holdout": {"before": {"x": 3.0}, "after": {"x": 1.0}, "floor": {"x": 1.0}}}
        return {"verdict": verdict, "effects": [], "suspected": verdict_of((name, ""))["effects"], "gap": gap}

    rows = [
        (hidden("clean"), suspected("payload")),
        (hidden("single", ("backlash", "")), suspected("backlash")),
        (hidden("single", ("backlash", "")), suspected("payload")),
        (hidden("single", ("backlash", "")), suspected("backlash", "unknown")),  # the confirming walk speaks against it
    ]
    judged = [
        {"name": str(k), "answer": answer, "verdict": verdict, "oracle": suspected("backlash")}
        for k, (answer, verdict) in enumerate(rows)
    ]
    result = score(judged)
    hits = {
        name: [
            result[name][key]["hits"] for key in ("right_on_medium_and_strong", "wrong_name", "false_alarms_on_clean")
        ]
        for name in ("workflow", "or_suspected")
    }
    assert hits == {"workflow": [0, 0, 0], "or_suspected": [1, 1, 1]}
    assert result["gap_reduction"]["median_share_of_oracle"] == 0.0


def test_a_group_of_two_that_holds_what_is_hidden_is_counted_apart():
    def of_group(*group: str) -> dict:
        verdict = verdict_of(("payload", ""))
        verdict["effects"][0]["group"] = ["payload", *group]
        return verdict

    answer = hidden("single", ("backlash", "LKneeSag"))
    rows = [
        of_group(),
        of_group("backlash@LKneeSag"),
        of_group("backlash@LKneeSag", "com_offset"),
        of_group("com_offset"),
    ]
    rows += [of_group("payload@plan", "backlash@LKneeSag")]  # two ways, not two effects
    rows += [verdict_of(("backlash", "LKneeSag")), {"verdict": "none", "effects": []}]
    result = score([{"name": str(k), "answer": answer, "verdict": verdict} for k, verdict in enumerate(rows)])
    assert [row["result"] for row in result["rows"]] == ["wrong"] * 5 + ["right", "none"]
    assert [row["in_group"] for row in result["rows"]] == ["wrong", "right", "wrong", "wrong", "right", "right", "none"]
    assert result["in_group"]["right_on_medium_and_strong"]["hits"] == 3
    assert result["in_group"]["wrong_name"]["hits"] == 3


def test_the_oracle_names_with_as_many_false_alarms_as_the_workflow(capsys):
    """Its limit lies at the evidence of clean robots, of which it too may call as many faulty."""

    def ranked(*rows: tuple[str, float]) -> list[dict]:
        return [{"name": name, "where": "", "evidence": nats, "parameters": {}} for name, nats in rows]

    rows = [
        (hidden("clean"), {"verdict": "unknown"}, ranked(("payload", 9.0))),
        (hidden("clean"), {"verdict": "none"}, ranked(("payload", 4.0))),
        (hidden("clean"), {"verdict": "none"}, ranked(("payload", 3.0))),
        (hidden("single", ("backlash", "")), {"verdict": "none"}, ranked(("backlash", 5.0), ("payload", 1.0))),
        (hidden("single", ("backlash", "")), {"verdict": "none"}, ranked(("backlash", 3.5), ("payload", 1.0))),
        (hidden("single", ("backlash", "")), {"verdict": "none"}, ranked(("payload", 8.0), ("backlash", 7.0))),
    ]
    judged = [
        {"name": str(k), "answer": answer, "verdict": verdict, "ranking": ranking}
        for k, (answer, verdict, ranking) in enumerate(rows)
    ]
    found = score(judged)["ranking"]
    assert found["limit"] == 4.0
    assert (found["first_1"]["hits"], found["named"]["hits"], found["named"]["of"]) == (2, 1, 3)
    without = score([*({**each, "ranking": None} for each in judged[:3]), *judged[3:]])["ranking"]
    assert without["named"]["share"] is None


def test_worlds_of_kinds_that_nothing_was_learnt_on_have_figures_of_their_own(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    nominal = replace(load_nominal(), source={"kinds": {"engine": ["mujoco"], "contact": ["creeping"]}})
    monkeypatch.setattr("coman_reduced_model.judge.score.load_nominal", lambda: nominal)
    drake = {**hidden("clean"), "worlds": {"engine": "drake", "contact": "creeping"}}
    verdicts = [(hidden("clean"), {"verdict": "none"}), (drake, {"verdict": "unknown"})]
    result = score([
        {"name": str(k), "answer": answer, "verdict": verdict} for k, (answer, verdict) in enumerate(verdicts)
    ])  # fmt: skip
    found = by_what_was_learnt(result["rows"], nominal, by_world)
    assert found["new_kinds"] == ["drake"]
    assert found["some_new_kind"]["false_alarms_on_clean"]["share"] == 1.0 and found["some_new_kind"]["cases"] == 1
    assert found["only_learnt_kinds"]["false_alarms_on_clean"]["share"] == 0.0
    assert result["learnt"] == found
    earlier = {key: value for key, value in result.items() if key != "learnt"}
    show_diagnosis({**earlier, "round": 1, "verdicts_sha256": "", "commit": "abc1234"}, Path("judged"))
    assert "never learnt on" in capsys.readouterr().out


def test_how_clearly_its_own_recordings_show_an_effect():
    row = {"name": "joint_stiffness", "where": "LKneeSag", "parameters": {"scale": {"value": 0.1, "deviation": 0.1}}}
    effect = {"name": "joint_stiffness", "where": "LKneeSag", "parameters": {"scale": float(np.exp(-0.6))}}
    assert shown(effect, [row]) == pytest.approx(6.0)
    assert shown(effect, [{**row, "where": "RKneeSag"}]) is None
    assert shown(effect, {"failed": "no step"}) is None
    row = {"name": "sensor_rotation", "where": "left", "parameters": {"roll": {"value": 0.0, "deviation": 0.01}}}
    turned = {"name": "sensor_rotation", "where": "left", "parameters": {"axis": "x", "angle": 0.04}}
    assert shown(turned, [row]) == pytest.approx(4.0)
    assert shown({**turned, "parameters": {"axis": "y", "angle": 0.04}}, [row]) is None


def test_a_gap_that_is_not_given_is_not_zero():
    assert np.isnan(gap_reduction(None)) and np.isnan(gap_reduction({"gap": {}})) and np.isnan(gap_reduction({}))


def test_two_instances_of_one_effect_are_one_truth_in_the_table():
    row = {"kind": "single", "truth": ["wrench_delay"], "named": ["wrench_delay", "wrench_delay"], "result": "right"}
    late = {"kind": "single", "truth": ["motor_lag"], "named": ["transport_delay"], "result": "right"}
    assert confusion([row, late]) == {"motor_lag": {"drive_delay": 1}, "wrench_delay": {"wrench_delay": 1}}
