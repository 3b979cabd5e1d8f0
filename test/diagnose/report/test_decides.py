# SPDX-License-Identifier: BSD-3-Clause
"""Each group of effects has the manoeuvres that would split it, whatever the verdict, and what more of a walk adds."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from test_diagnosis_page import diagnosis

from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.diagnose.inference.case import Case
from coman_reduced_model.diagnose.inference.explanation import Explanation, Odds
from coman_reduced_model.diagnose.inference.finding import Finding
from coman_reduced_model.diagnose.physics.hypotheses import Candidate, candidates
from coman_reduced_model.diagnose.report import decides as report
from coman_reduced_model.diagnose.report.alike import decides as said
from coman_reduced_model.diagnose.report.decides import decides, manoeuvres
from coman_reduced_model.diagnose.report.page import diagnosis_page
from coman_reduced_model.diagnose.result import Diagnosis
from coman_reduced_model.schemas import schema

GROUP = ("backlash@LKneeSag", "joint_stiffness@RKneeSag")


def entry(kind: str | None = None) -> list[dict[str, Any]]:
    return [{"class": kind}]


def before(finding: Finding) -> list[Case]:
    return [*finding.before[0], *finding.before[1]]


def with_group(made: Diagnosis, names: tuple[str, ...]) -> list[dict[str, Any]]:
    finding = made.finding
    finding.chosen = [replace(finding.chosen[0], group=names)]
    return decides(finding, before(finding), entry(), False)


def test_a_group_has_its_manoeuvres_and_what_more_of_each_recording_adds():
    made = diagnosis()
    (found,) = with_group(made, GROUP)
    assert found["group"] == list(GROUP)
    assert sorted((each["effects"], each["sentence"]) for each in found["manoeuvres"]) == [
        ([name], CATALOGUE[name.partition("@")[0]].experiment) for name in GROUP
    ]
    gains = [each["factor"] for each in found["manoeuvres"]]
    assert gains == sorted(gains, reverse=True) and gains[0] > found["factor"]
    assert {each["bag"] for each in found["again"]} == {"train", "hold"}
    factors = [each["factor"] for each in found["again"]]
    assert factors == sorted(factors, reverse=True) and all(each > found["factor"] for each in factors)
    Draft202012Validator(schema("diagnosis")["properties"]["decides"]).validate([found])
    text = said(found)
    for name in GROUP:
        assert CATALOGUE[name.partition("@")[0]].experiment in text
    assert "backlash of LKneeSag, joint stiffness of RKneeSag" in text and "20 s more like" in text


def test_what_measures_another_effect_is_worth_what_it_says_of_that_one():
    def gains(*names: str) -> dict[str, float]:
        (found,) = with_group(diagnosis(), names)
        return {name: each["factor"] for each in found["manoeuvres"] for name in each["effects"]}

    three, stiffness, encoder = (
        gains(*GROUP, "encoder_bias@LKneeSag"),
        gains(*GROUP),
        gains(GROUP[0], "encoder_bias@LKneeSag"),
    )
    assert three[GROUP[1]] == pytest.approx(stiffness[GROUP[1]]) != pytest.approx(encoder["encoder_bias@LKneeSag"])
    assert three["encoder_bias@LKneeSag"] == pytest.approx(encoder["encoder_bias@LKneeSag"])


def test_what_the_recordings_would_distinguish_is_not_said_to_need_more_of_them():
    (found,) = with_group(diagnosis(), GROUP)
    few, many = (said({**found, "factor": factor}) for factor in (2.9, 3.1))
    assert "; now it is 2.9 nats, and 3 are needed." in few and "several effects" not in few
    assert "3.1 nats, and 3 are enough" in many and "if backlash of LKneeSag alone were there" in many


def test_an_effect_that_nothing_looks_like_needs_no_manoeuvre():
    made = diagnosis()
    assert made.result["decides"] == [] and with_group(made, GROUP[:1]) == []
    assert "To decide between" not in diagnosis_page(made)


@pytest.mark.parametrize("verdict", ["effect", "unknown"])
def test_the_page_says_it_of_what_is_suspected_too(verdict):
    made = diagnosis(against=() if verdict == "effect" else ("backlash@LKneeSag",))
    assert made.result["verdict"] == verdict and bool(made.result["suspected"]) == (verdict == "unknown")
    made.result["decides"] = with_group(made, GROUP)
    html = re.sub(r"\s+", " ", diagnosis_page(made))
    assert "To decide between backlash of LKneeSag, joint stiffness of RKneeSag" in html
    assert CATALOGUE["joint_stiffness"].experiment in html


def test_a_class_is_a_group(monkeypatch):
    monkeypatch.setattr(report, "CLASSES", {"backlash": "loose", "encoder_bias": "loose", "joint_stiffness": "loose"})
    finding = diagnosis().finding
    (found,) = decides(finding, before(finding), entry("loose"), False)
    assert found["group"] == ["backlash@LKneeSag", "encoder_bias@LKneeSag"]  # of the class, at its place


def test_an_effect_of_no_size_is_not_like_any_other():
    """As one that is assumed may turn out to be."""
    finding = diagnosis().finding
    assert finding.fit is not None
    finding.fit = replace(finding.fit, x=np.zeros(len(finding.known)))
    assert decides(finding, before(finding), entry(), False) == []


def likely(*p: float, group: tuple[int, ...] = ()) -> Diagnosis:
    """Nothing was chosen; probabilities of the effects that were compared."""
    made = diagnosis(found=False, unknown=0.8)
    finding = made.finding
    assert finding.fit is not None
    options: list[Candidate | None] = [None, *candidates(finding.known)]
    fit = replace(finding.fit, x=np.array([0.005, 0.01, 0.1]))
    compared = [Explanation(option, fit, 5.0, 4.0, 1, {}, {}, 0.0) for option in options[: len(p) + 1]]
    finding.steps = [(compared, Odds(0.02, 0.98 - sum(p), p, group, 0.1))]
    return made


@pytest.mark.parametrize(
    ("p", "group", "expected"),
    [
        ((0.2, 0.0, 0.4), (2,), ["joint_stiffness@RKneeSag", "backlash@LKneeSag"]),  # as the sentence names them
        ((0.4, 0.05, 0.02), (0, 1), ["backlash@LKneeSag", "encoder_bias@LKneeSag"]),  # alike by their evidence
        ((0.02, 0.01, 0.01), (0, 1), None),  # something outside the catalogue: no manoeuvre is known
        ((0.4, 0.01, 0.01), (0,), None),
    ],
)
def test_where_nothing_was_chosen_what_is_likely_is_a_group(p, group, expected):
    finding = likely(*p, group=group).finding
    found = decides(finding, before(finding), [], True)
    assert [each["group"] for each in found] == ([] if expected is None else [expected])
    assert decides(finding, before(finding), [], False) == []


def test_places_of_one_effect_share_a_manoeuvre():
    (found,) = manoeuvres(["encoder_bias@LKneeSag", "encoder_bias@RKneeSag"])
    assert found["effects"] == ["encoder_bias@LKneeSag", "encoder_bias@RKneeSag"]
