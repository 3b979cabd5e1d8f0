# SPDX-License-Identifier: BSD-3-Clause
"""The page of a diagnosis, from a small made-up finding: a knee with play."""

from __future__ import annotations

import json
import re
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from diagnose_tools import standing, swaying
from jsonschema import Draft202012Validator
from robots import robot_of
from synthetic import robot

from coman_reduced_model.cli.diagnose import _show
from coman_reduced_model.core.base.parameter import Parameter
from coman_reduced_model.core.base.types import Array, Foot, Phase
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.base import Effect
from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.core.effects.unknown import About, Unknown, world_plus
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.diagnose.data.reading import Reading
from coman_reduced_model.diagnose.data.recording import Recording
from coman_reduced_model.diagnose.data.signals import Smoothed
from coman_reduced_model.diagnose.inference.case import Case
from coman_reduced_model.diagnose.inference.check import Checked, check_recordings, limitations
from coman_reduced_model.diagnose.inference.effects import with_structure
from coman_reduced_model.diagnose.inference.evidence import Problem, scores, weighed
from coman_reduced_model.diagnose.inference.explanation import Odds
from coman_reduced_model.diagnose.inference.finding import ChosenEffect, Finding
from coman_reduced_model.diagnose.inference.noise import Noise
from coman_reduced_model.diagnose.inference.predicted_com import FreeRun, FreeRuns
from coman_reduced_model.diagnose.inference.prediction import predict_com
from coman_reduced_model.diagnose.inference.verdict import Found, verdict
from coman_reduced_model.diagnose.inference.weight import Weight
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns
from coman_reduced_model.diagnose.report.contents import build_diagnosis, confirmed_on
from coman_reduced_model.diagnose.report.page import diagnosis_page
from coman_reduced_model.diagnose.report.words import effect_sentence, sentence
from coman_reduced_model.diagnose.result import Diagnosis
from coman_reduced_model.output import to_json
from coman_reduced_model.schemas import schema

WIDTH, FLOOR = 0.012, 3e-4  # [rad]
WITH_PLAY = 0.5  # of the error of the predicted COM without the play in the model
JOINTS = ["LKneeSag", "RKneeSag"]
STILL = lambda recording, world, x: (recording, world)  # noqa: E731
KNOWN = [
    Unknown("backlash", "LKneeSag", "width", "rad", STILL, 0.01, spread=0.001, step=1e-3, low=0.0),
    Unknown("encoder_bias", "LKneeSag", "bias", "rad", STILL, 0.02, 0.001, step=1e-3),
    Unknown("joint_stiffness", "RKneeSag", "scale", "1", STILL, 0.3, 0.05, nominal=1.0, step=0.01),
]


@cache
def coman() -> Robot:
    return robot_of("coman")


def case(
    name: str,
    width: float,
    at: Array,
    walks: bool = True,
    efforts: bool = True,
    stiffer: float = 0.0,
    clocks: tuple[str, ...] = (),
) -> Case:
    """A recording whose left knee has a play `width` and whose right one is `stiffer`, seen with the unknowns `at`."""
    t = np.arange(0.0, 8.0, 0.005)
    phase = np.where(t % 1.0 < 0.3, 3, np.where(t % 2.0 < 1.0, 1, 2)) if walks else np.full(len(t), 3)
    robot = coman()
    left, right = (robot.joint_names.index(name) for name in JOINTS)
    tau = np.zeros((len(t), len(robot.joint_names)))
    tau[:, left], tau[:, right] = 20.0 * np.sin(np.pi * t), 15.0 * np.cos(np.pi * t)
    q, wrench = np.zeros_like(tau), {foot: np.zeros((len(t), 6)) for foot in (Foot.LEFT, Foot.RIGHT)}
    recording = Recording(
        name, t, q, tau if efforts else None, q, wrench, None, None, None, phase,
        np.full(len(t), 0.5), np.ones(len(t), dtype=bool), np.zeros(tau.shape[1]),
        {foot: np.zeros(len(t)) for foot in wrench}, clocks=clocks,
    )  # fmt: skip
    ticks = np.arange(10, len(t) - 10, 8)
    jump, noise = 0.5 * np.sign(tau[ticks, left]), FLOOR * np.random.default_rng(1).standard_normal((2, len(ticks)))
    columns = {
        "spring/LKneeSag": np.column_stack([jump, -np.ones(len(ticks)), np.zeros(len(ticks))]),
        "spring/RKneeSag": np.column_stack([np.zeros((len(ticks), 2)), tau[ticks, right] / 180.0]),
    }
    residuals = {
        "spring/LKneeSag": (width - at[0]) * jump + noise[0],
        "spring/RKneeSag": (stiffer - at[2]) * tau[ticks, right] / 180.0 + noise[1],
    }
    problem = Problem(KNOWN, {}, {}, {}, {}, {})
    for channel, values in residuals.items():
        for part, mine in (("double", phase[ticks] == 3), ("single", phase[ticks] != 3)):
            if mine.any():
                key, index = f"{channel}|{part}", np.flatnonzero(mine)
                problem.rows[key], problem.columns[key], problem.times[key] = (
                    values[mine],
                    columns[channel][mine],
                    index,
                )
                problem.pieces[key] = np.flatnonzero(np.diff(index, prepend=-9) > 1)
    noises = {key: Noise(np.array([FLOOR, 0.0, 0.0, 0.0]), 0.0) for key in problem.rows}
    world = SimpleNamespace(robot=robot, gravity=9.81)
    motion = SimpleNamespace(qd=np.zeros((len(ticks), len(robot.joint_names))))
    state: Any = SimpleNamespace(
        recording=recording, world=world, motion=motion, residuals=residuals, smoothed=Smoothed()
    )
    where: Any = SimpleNamespace(ticks=ticks, staggers=False, complete=np.ones(len(ticks), dtype=bool))
    evidence = weighed(problem, at, noises)
    base: Any = None
    return Case(recording, where, state, problem, evidence, noises, base, dict.fromkeys(problem.rows, FLOOR))


def free_run(config: Config, made_worse: bool) -> FreeRun:
    """Ten steps; 2 mm off without the play in the model, with it 1 mm, or 3 mm where it makes that worse."""
    n = 1600
    with_play = 1.5 if made_worse else WITH_PLAY
    size = 0.002 * (with_play if any(each.name == "backlash" for each in config.effects) else 1.0)
    predicted = size * (1.0 + 0.1 * np.sin(np.outer(np.arange(n), (0.1, 0.2, 0.3))))
    phase = np.where(np.arange(n) % 160 < 40, Phase.DOUBLE, Phase.LEFT)
    return FreeRun(
        np.arange(n) * 5_000_000, np.full(n, Foot.LEFT), phase, np.arange(n) // 160, np.zeros((n, 3)), predicted,
        np.zeros((n, 12)), coman(), (),
    )  # fmt: skip


def diagnosis(
    width: float = WIDTH,
    found: bool = True,
    hold: int = 1,
    unknown: float = 0.1,
    against: tuple[str, ...] = (),
    made_worse: bool = False,
    group: tuple[str, ...] = (),
    weight: float = 0.0,
    **recording: Any,
) -> Diagnosis:
    """The last two steps on made-up recordings and findings; the play makes the predicted COM better or worse."""
    nothing, options = np.zeros(len(KNOWN)), candidates(KNOWN)
    before = [case(name, width, nothing, **recording) for name in ("train", "hold")[: 1 + hold]]
    finding = Finding(KNOWN, nothing, before=(before[:1], before[1:]), train=before[:1], hold=before[1:])
    finding.first = finding.last = scores(before[0].evidence, options)
    if found:
        finding.at = np.array([width, 0.0, 0.0])
        option = next(each for each in options if each.effect == KNOWN[0].effect)
        finding.chosen = [ChosenEffect(option, 300.0, 200.0 if hold else np.nan, 0.71, group)]
        after = [case(name, width, finding.at, **recording) for name in ("train", "hold")[: 1 + hold]]
        finding.train, finding.hold = after[:1], after[1:]
    finding.fit = finding.train[0].evidence.fit(finding.released)
    config, where = with_structure(load_config(ROOT / "config/coman.yaml")), SimpleNamespace(slides=())
    prepared: Any = [(each.recording, each.state.world, where) for each in before]
    checked = Checked(
        prepared[:1], [], prepared[1:], ["bags/train"], ["bags/hold"][:hold], [each.recording for each in before],
        limitations(prepared),
    )  # fmt: skip
    with ThreadPoolExecutor(1) as helper:
        free_runs = FreeRuns(helper, predict=lambda path, config, *_: free_run(config, made_worse))
        predicted = predict_com(finding, checked, config, free_runs)
    finding.steps.append(([], Odds(0.02 if found else 0.9 - unknown, unknown, (), (), 0.5)))
    word = verdict(finding, checked.recordings[:1], False, against)
    probabilities = {"none": 0.9 - unknown, "unknown": unknown, "backlash@LKneeSag": 0.1}
    result = Found(finding, finding.leftover(), word, probabilities, against, Weight(weight, 0.01, 0.03))
    return build_diagnosis(checked, result, predicted, config, began=0.0)


def test_a_page_is_one_file_that_says_what_is_missing_first_and_shows_it():
    html = diagnosis_page(diagnosis())
    assert not re.search(r"https?:|@import|<script|<img|<link", html)
    headline = re.search(r"<h1>(.*?)</h1>", html)[1]  # type: ignore[index]
    assert headline.startswith("The left knee (LKneeSag) has 0.690 ± ")
    assert headline.endswith("degrees of backlash.")
    for told in ("model.yaml", "spring law, LKneeSag", "backlash of LKneeSag", "opened once"):
        assert told in html
    assert html.count("<svg") == 4  # the law, residuals, COM, heat map


@pytest.mark.slow
@pytest.mark.parametrize("hold", [0, 1])
@pytest.mark.parametrize(
    ("verdict", "told"),
    [
        ("none", "nominal robots leave"),
        ("unknown", "no effect of the catalogue"),
        ("not_excited", "both feet must leave the ground"),
        ("effect", "could hide below"),
    ],
)
def test_each_verdict_has_a_page(verdict, told, hold):
    width = WIDTH if verdict in ("unknown", "effect") else 0.0
    unknown = 0.8 if verdict == "unknown" else 0.1
    made = diagnosis(width, verdict == "effect", hold, unknown=unknown, walks=verdict != "not_excited")
    assert made.result["verdict"] == verdict
    html = diagnosis_page(made)
    assert told in html
    assert html.count("<svg") >= 3
    assert ("no held-out bag" in html.lower()) == (not hold)


@pytest.mark.parametrize(
    ("train", "hold", "on"), [(["a"], ["b"], "b"), (["a"], [], "the same recording"), (["a", "b"], [], "b")]
)
def test_the_result_says_what_confirms(train, hold, on):
    readings = [Reading(name, swaying(Phase.LEFT).changed(name=name), robot()) for name in [*train, *hold]]
    assert confirmed_on(check_recordings(readings, len(train), Config(), [])) == on


@pytest.mark.parametrize("made_worse", [False, True])
@pytest.mark.parametrize("hold", [0, 1])
def test_an_effect_that_makes_the_predicted_com_worse_is_named_but_not_in_the_model(hold, made_worse):
    made = diagnosis(hold=hold, made_worse=made_worse)
    (effect,) = made.result["effects"]
    assert made.result["verdict"] == "effect" and effect["name"] == "backlash"
    assert effect["in_model"] == ("backlash" in [each.name for each in made.model.effects]) == (not made_worse)
    com = effect["com"]
    for axis in "xyz":
        assert com["after"][axis] == pytest.approx(com["before"][axis] * (1.5 if made_worse else 0.5))
        low, high = com["change"][axis]
        assert low > 0.0 if made_worse else high < 0.0
    # What is written is what model.yaml does.
    gap = made.result["gap"]["holdout" if hold else "train"]
    for axis in "xyz":
        assert gap["after"][f"com/{axis}"] == pytest.approx(gap["before"][f"com/{axis}"] * (1.0 if made_worse else 0.5))
    walks = "held-out walks" if hold else "training walks"
    assert (f"it makes the predicted COM of {walks} worse, x 2.007 to 3.011" in made.result["sentence"]) == made_worse


@pytest.mark.parametrize("made_worse", [False, True])
def test_the_page_shows_the_com_before_and_after_each_effect(made_worse):
    html = diagnosis_page(diagnosis(made_worse=made_worse))
    table = html.partition("with it [mm]")[2].partition("</table>")[0]
    rows = [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in re.findall(r"<tr.*?</tr>", table, re.S)]
    rows = [row for row in rows if row and row[0] == "backlash"]
    assert [row[2] for row in rows] == ["x", "y", "z"]
    assert {(row[3][:3], row[4][:3]) for row in rows} == {("2.0", "3.0" if made_worse else "1.0")}
    assert {row[-1] for row in rows} == {"no" if made_worse else "yes"}
    assert ("worse, x" in html) == made_worse


def test_what_the_confirming_recording_speaks_against_is_not_named():
    made = diagnosis(against=("backlash@LKneeSag",))
    assert made.result["verdict"] == "unknown" and made.result["effects"] == []
    assert [each["name"] for each in made.result["suspected"]] == ["backlash"]
    assert "backlash of LKneeSag would explain it, but the confirming recording" in made.sentence
    assert "The confirming recording speaks against backlash of LKneeSag" in diagnosis_page(made)


def test_what_recordings_cannot_distinguish_from_an_effect_is_in_the_headline_with_its_place(capsys):
    group = "backlash@LKneeSag", "transport_delay@plan", "transport_delay", "foot_slip@right", "payload"
    made = diagnosis(group=group)
    others = "transport delay or foot slip of the right foot or payload"
    said = f"degrees of backlash, or {others}, which these recordings cannot distinguish (together 71%)"
    assert made.sentence.endswith(said)
    assert made.result["effects"][0]["group"] == list(group)
    Draft202012Validator(schema("diagnosis")).validate(json.loads(to_json(made.result)))
    headline, _, rest = diagnosis_page(made).partition("</h1>")
    assert said in headline and rest.count(f">{others}<") == 1
    assert rest.count(said) == 1  # what is still open
    _show(made.result, Path("found"))
    assert said in capsys.readouterr().out
    suspected = diagnosis(group=group, against=("backlash@LKneeSag",))
    _show(suspected.result, Path("found"))
    assert f"what is suspected: backlash of the left knee (LKneeSag), or {others}, which" in capsys.readouterr().out


def test_a_recording_without_torques_has_a_page_that_says_so():
    html = diagnosis_page(diagnosis(efforts=False))
    assert "No joint torques were recorded" in html


@pytest.mark.parametrize("size", [0.999, 1.5])
def test_what_explains_next_to_nothing_is_listed_as_minor_and_is_no_verdict(monkeypatch, size):
    monkeypatch.setitem(globals(), "WITH_PLAY", size)  # it explains 0.2 % of the COM's squared error, or spoils it
    made = diagnosis()
    (effect,) = made.result["effects"]
    minor = size < 1.0
    assert effect["minor"] and made.result["only_minor"] == minor == bool(made.model.effects)
    assert made.verdict == ("none" if minor else "effect") and not made.result["suspected"]
    assert made.sentence.startswith("no effect that matters to the prediction was found; minor: the left knee") == minor
    assert ("degrees of backlash (it explains 0% of the error of the predicted COM)" in made.sentence) == minor
    html = diagnosis_page(made)
    assert ("Nothing that matters to the prediction" in html) == minor == ("What is missing" not in html)
    assert ("What was found is there, but" in html) == minor


def test_beside_what_is_minor_a_sentence_says_what_is_unexplained(monkeypatch):
    monkeypatch.setitem(globals(), "WITH_PLAY", 0.999)
    result = {**diagnosis().result, "too_much": ["force/y|single"], "apart": {}, "contradicted": ["payload"]}
    said = sentence(result)
    assert "the confirming recording speaks against payload" in said
    assert said.endswith("; but more is left in the force balance, y, than on nominal robots, unexplained")


def test_what_explains_the_weight_is_no_minor_matter(monkeypatch):
    monkeypatch.setitem(globals(), "WITH_PLAY", 0.999)
    made = diagnosis(weight=0.09)
    assert made.verdict == "effect" and not made.result["only_minor"]
    assert made.sentence.startswith("the left knee") and "(minor: it explains 0% of" in made.sentence
    assert made.sentence.endswith("by its forces, the robot weighs 9% more than by its URDF")


def test_a_robot_that_only_stands_is_not_said_to_be_far_from_nominal():
    """The same residuals of its right knee mean a stiffer spring only where it walks."""
    walking = diagnosis(0.0, found=False, stiffer=0.5).result
    assert [row["where"] for row in walking["far_from_nominal"]] == ["RKneeSag"]
    made = diagnosis(0.0, found=False, stiffer=0.5, walks=False)
    assert made.verdict == "not_excited" and made.result["far_from_nominal"] == []
    assert "further from nominal than nominal robots have them" not in diagnosis_page(made)


@pytest.mark.parametrize("found", [True, False])
def test_clocks_that_are_apart_are_said_first(found):
    line = "left_foot/wrench: its clock is 1.000 s behind joint_states, or it arrives at another time"
    made = diagnosis(found=found, clocks=(line,))
    assert made.result["clocks_apart"] == [f"train: {line}", f"hold: {line}"]
    then = "the left knee" if found else "nothing is missing"
    assert made.sentence.startswith(f"check the clocks first: train: {line} (and 1 more); beside that, {then}")
    assert f"<h1>Check the clocks first: train: {line}" in diagnosis_page(made)


class KneePlay(Effect):
    """An effect in one file: this one."""

    name = "knee_play"
    place = "joint"
    parameters = (Parameter("gap", "float", 0.0, "rad", "between the knee's motor and its link", 0.0, 0.5),)
    sentence = "{at} has a gap of {gap}"
    experiment = "the knee turned to and fro by hand"
    exact = False
    law = ("spring", "torque")

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("backlash.width", "spread", "reach")
        return [cls.unknown("gap", world_plus("play", about.joints["LKneeSag"]), "LKneeSag", low=0.0, **prior)]


def test_an_effect_of_one_file_has_its_hypothesis_its_sentence_and_its_part_of_the_page(monkeypatch):
    monkeypatch.setitem(CATALOGUE, "knee_play", KneePlay)
    recording, world = standing()
    (gap,) = [each for each in unknowns(recording, world) if each.effect == "knee_play"]
    assert [each.name for each in candidates([gap])] == ["knee_play@LKneeSag"]
    _, believed = gap.apply(recording, world, 0.02)
    assert believed.play[world.robot.joint_names.index("LKneeSag")] == 0.02

    monkeypatch.setitem(globals(), "KNOWN", [gap, *KNOWN[1:]])
    made = diagnosis()
    (effect,) = made.result["effects"]
    assert (effect["name"], effect["where"], set(effect["parameters"])) == ("knee_play", "LKneeSag", {"gap"})
    assert effect_sentence(effect).startswith("the left knee (LKneeSag) has a gap of 0.69")
    html = diagnosis_page(made)
    assert "Residual of LKneeSag before and after knee play" in html
    assert KneePlay.experiment not in html
    effect["class"] = "play"  # as if another effect explained as much
    assert KneePlay.experiment in diagnosis_page(made)
