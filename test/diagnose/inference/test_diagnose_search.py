# SPDX-License-Identifier: BSD-3-Clause
"""What counts as enough, and what is one effect: the rules of the search, one by one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from diagnose_tools import EXACT_TORQUES, softened, standing, stretched, swaying
from hypothesis import given
from hypothesis import strategies as st
from synthetic import robot

from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.unknown import PLAN
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.inference import gauss_newton, search
from coman_reduced_model.diagnose.inference import verdict as verdicts
from coman_reduced_model.diagnose.inference.case import examine, prepare
from coman_reduced_model.diagnose.inference.case_cache import CaseCache
from coman_reduced_model.diagnose.inference.check import limitations, with_common_streams
from coman_reduced_model.diagnose.inference.effects import effect_entries, far_from_nominal, with_effects
from coman_reduced_model.diagnose.inference.explanation import Odds
from coman_reduced_model.diagnose.inference.finding import ChosenEffect, Finding, judged, size
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns
from coman_reduced_model.diagnose.report.contents import pulled
from coman_reduced_model.diagnose.report.words import effect_sentence


@given(st.floats(1e-6, 1e3), st.integers(0, 150))
def test_the_size_of_residuals_ignores_stumbles(sigma, stumbles):
    values = sigma * np.random.default_rng(stumbles).standard_normal(1000)
    values[:stumbles] *= 1e3
    assert size(values) == pytest.approx(sigma, rel=0.1 if stumbles == 0 else 0.5)
    assert size(values[:1]) > 0.0


def test_where_a_robot_staggers_the_laws_of_flat_soles_are_not_judged_unless_it_always_does():
    def case(staggers: bool, tau: object = "torques"):
        return SimpleNamespace(where=SimpleNamespace(staggers=staggers), recording=SimpleNamespace(tau=tau))

    steady, edgy, without = case(False), case(True), case(True, None)
    cases = [steady, edgy, without]
    for key in ("force/y|single", "moment/x", "torque/LAnkLat|double", "tilt/roll|single"):
        assert judged(cases, steady, key) and not judged(cases, edgy, key)
    assert judged(cases, edgy, "spring/LAnkLat|single") and not judged(cases, without, "spring/LAnkLat|single")
    assert judged(cases, edgy, "slide/x|single") and judged(cases, edgy, "unloaded/left/fz|single")
    assert judged([edgy], edgy, "force/y|single")


def test_warnings_of_a_recording_are_among_its_limitations():
    prepared = prepare(swaying(Phase.LEFT), robot(), Config())
    lines = limitations([prepared])
    assert any("nearly always on the edge of a foot" in line for line in lines)
    assert any("a foot that slides does not show" in line for line in lines)


def test_without_the_torques_of_one_bag_the_play_of_no_bag_is_seen_by_them():
    recording, world = standing()
    where = masks(recording, world)
    assert where.taken_up.any()
    without = recording.changed(tau=None)
    alike = with_common_streams([(recording, world, where), (without, world, masks(without, world))])
    assert [each.tau for each, _, _ in alike] == [None, None]
    assert not any(masked.taken_up.any() for _, _, masked in alike)
    (kept,) = with_common_streams([(recording, world, where)])
    assert kept[2] is where


@pytest.mark.parametrize("reference", ["motor", "topic"])
def test_what_measured_motor_states_show_is_named_but_needs_no_change_of_the_model(reference):
    recording, world = standing()
    still = np.zeros((len(recording.t), 2))
    known = unknowns(recording.changed(plan=still, moved=still), world)
    config = Config().replaced({"prediction.reference": reference})
    against_plan = [option for option in candidates(known) if option.where == PLAN]
    assert {option.effect for option in against_plan} == {"motor_compliance", "motor_lag", "transport_delay"}
    fit = SimpleNamespace(x=np.full(len(known), 0.01), covariance=np.eye(len(known)), precise=())
    for option in against_plan:
        finding = Finding(known, np.zeros(len(known)), chosen=[ChosenEffect(option, 9.0, 9.0)], fit=fit)
        (entry,) = effect_entries(finding, config)
        added = option.effect in {effect.name for effect in with_effects(config, [entry]).effects}
        assert entry["in_model"] == added == (reference == "topic")
        assert ("the motor states show it" in effect_sentence(entry)) == (reference == "motor")


@pytest.mark.parametrize(
    ("nats", "left", "against", "word", "assumed"),
    [
        ({"payload": 9.0, "encoder_delay": 5.0}, ["payload", "encoder_delay"], (), "effect", False),
        ({"payload": 9.0, "encoder_delay": -5.0}, ["payload"], ("encoder_delay",), "effect", False),
        ({"payload": -9.0, "encoder_delay": 5.0}, ["payload", "encoder_delay"], ("payload",), "unknown", False),
        ({"payload": 9.0, "encoder_delay": -5.0}, ["payload", "encoder_delay"], ("encoder_delay",), "effect", True),
    ],
)
def test_the_confirming_recording_drops_what_it_denies(monkeypatch, nats, left, against, word, assumed):
    """Unless it is what was found first, then something else is missing, or is assumed."""
    recording, world = standing()
    known = unknowns(recording, world)
    options = [next(each for each in candidates(known) if each.effect == name) for name in nats]
    finding = Finding(known, np.zeros(len(known)), fit=SimpleNamespace())
    finding.chosen = [ChosenEffect(option, 9.0, 9.0) for option in options]
    fitted = []

    def settled(finding, cache, released):
        fitted.append(released)
        return np.zeros(len(known)), [], SimpleNamespace()

    monkeypatch.setattr(verdicts, "examine", lambda *_: "confirming")
    monkeypatch.setattr(verdicts, "settled", settled)
    monkeypatch.setattr(
        verdicts, "confirmation", lambda known, fit, held, option, chosen, nominal, unshifted: nats[option.effect]
    )
    cache, checked = SimpleNamespace(known=known, at=lambda at, which: []), SimpleNamespace(confirm=[recording])
    assert verdicts._confirm(finding, cache, checked, [recording], assumed) == against
    assert [effect.option.effect for effect in finding.chosen] == left and finding.hold == ["confirming"]
    assert fitted == ([list(options[0].unknowns)] if len(left) == 1 else [])
    walk = SimpleNamespace(phase=np.array([Phase.LEFT]))
    monkeypatch.setattr(verdicts, "lifts_a_foot", lambda phase: True)
    finding.steps = [([], Odds(0.1, 0.0, (), (), alarm=0.1))]
    assert verdicts.verdict(finding, [walk], assumed, against) == word
    finding.steps = [([], Odds(0.1, 0.0, (), (), alarm=0.05))]
    assert verdicts.verdict(finding, [walk], assumed, against) == ("effect" if assumed else "none")  # suspected
    # An alarm as well: a weight that is off, which a payload explains, and all that varies pulled together.
    assert verdicts.verdict(finding, [walk], assumed, against, off_weight=True) == word
    finding.steps = [([], Odds(0.1, 0.0, (), (), alarm=0.05, pulled=True))]
    assert verdicts.verdict(finding, [walk], assumed, against) == word


@pytest.mark.slow
def test_an_effect_that_a_later_one_explains_is_dropped(joint="LKneeSag", factor=0.6):
    """A softer spring, which was taken for play at first."""
    recording, world = softened(joint, factor), standing()[1]
    cache = CaseCache([(recording, world, masks(recording, world))], [], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train = cache.at(finding.at, "train")
    of_joint = {option.effect: option for option in candidates(cache.known) if option.where == joint}
    finding.chosen = [ChosenEffect(of_joint[name], 9.0, np.nan) for name in ("backlash", "joint_stiffness")]
    finding.at, finding.train, finding.fit = gauss_newton.settled(finding, cache, finding.released)
    verdicts.drop_needless(finding, cache)
    assert [effect.option.effect for effect in finding.chosen] == ["joint_stiffness"]
    (i,) = finding.released
    assert cache.known[i].value(finding.fit.x[i]) == pytest.approx(factor, rel=0.05)
    verdicts.drop_needless(finding, cache)
    assert len(finding.chosen) == 1  # what was found alone is judged by its evidence


def test_what_is_far_from_nominal_beside_the_effects_is_listed():
    recording, world = standing()
    known = unknowns(recording, world)
    soft, biased = (next(i for i, u in enumerate(known) if u.name == name) for name in
                    ("joint_stiffness@LKneeSag.scale", "encoder_bias@RAnkSag.bias"))  # fmt: skip
    own = next(i for i, unknown in enumerate(known) if unknown.own)
    x = np.array([unknown.spread for unknown in known])
    x[soft], x[biased], x[own] = -0.5, 4.0 * known[biased].spread, 9.0 * max(known[own].spread, 1e-3)
    fit = SimpleNamespace(x=x, covariance=1e-8 * np.eye(len(known)), precise=())
    finding = Finding(known, np.zeros(len(known)), fit=fit)
    first, second = far_from_nominal(finding)
    assert (first["name"], first["where"], second["name"]) == ("joint_stiffness", "LKneeSag", "encoder_bias")
    assert second["value"] == pytest.approx(x[biased]) and second["deviations"] == pytest.approx(4.0)
    assert second["interval"][0] < second["value"] < second["interval"][1] and second["unit"] == "rad"
    fit.covariance[biased, biased] = (2.0 * x[biased]) ** 2  # it could be nominal as well
    assert [row["name"] for row in far_from_nominal(finding)] == ["joint_stiffness"]
    fit.covariance[biased, biased] = 1e-8
    option = next(each for each in candidates(known) if each.unknowns == (soft,))
    finding.chosen = [ChosenEffect(option, 9.0, 9.0)]
    assert [row["name"] for row in far_from_nominal(finding)] == ["encoder_bias"]


def test_two_joints_may_have_lost_motion_and_one_joint_has_it_once():
    recording, world = standing()
    known = unknowns(recording, world)
    options = candidates(known)
    worn = next(each for each in options if each.name == "backlash@LKneeSag")
    finding = Finding(known, np.zeros(len(known)), chosen=[ChosenEffect(worn, 9.0, 9.0)])
    left = {option.name for option in search._left(options, finding)}
    assert {"backlash@RAnkSag", "hysteresis@RAnkSag"} <= left
    assert not left & {"backlash@LKneeSag", "hysteresis@LKneeSag", "hysteresis@left", "backlash"}


@pytest.mark.slow
def test_zeros_of_one_recording_are_among_what_is_pulled(newton_metres=5.0):
    recording, world = standing()
    wrench = {foot: each + newton_metres * (np.arange(6) == 4) for foot, each in recording.wrench.items()}
    off = recording.changed(name="off", wrench=wrench)
    made = [(each, world, masks(each, world)) for each in (recording, off)]
    cache = CaseCache(made[:1], made[1:], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train, finding.hold = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    finding.fit = finding.train[0].evidence.fit()
    assert "zero_ty" in pulled(finding)
    finding.hold = finding.train
    assert "zero_ty" not in pulled(finding)


def test_rivals_that_are_compared_again_converge_to_the_same_values(monkeypatch):
    recording, world = stretched(lambda tau, nominal: 2.0 * nominal), standing()[1]
    cache = CaseCache([(recording, world, masks(recording, world))], (), EXACT_TORQUES)
    soft = next(i for i, unknown in enumerate(cache.known) if unknown.name == "joint_stiffness@LKneeSag.scale")
    nothing, steps, near = np.zeros(len(cache.known)), [], cache.near
    monkeypatch.setattr(cache, "near", lambda *a: steps.append(1) or near(*a))
    cases = cache.at(nothing, "train")
    fit = gauss_newton.evidence_of(cases).fit([soft])
    first = gauss_newton._gauss_newton(cache, [soft], nothing, cases, fit)
    taken = len(steps)
    again = gauss_newton._gauss_newton(cache, [soft], nothing, cases, fit)
    # Towards 0.5: all else, by derivatives at nominal, has a part in it here. Its true value: see test_compare.py.
    assert 0.45 < np.exp(first[0][soft]) < 0.75 and taken >= 1
    assert len(steps) == taken + 1
    np.testing.assert_array_equal(again[0], first[0])
    np.testing.assert_array_equal(again[2].x, first[2].x)


def test_a_case_near_another_needs_no_figure_of_its_own():
    recording, world = standing()
    prepared = recording, world, masks(recording, world)
    known = unknowns(recording, world)
    case = examine(prepared, known, np.zeros(len(known)))
    same = examine(prepared, known, np.zeros(len(known)), case, ())
    for key, columns in case.problem.columns.items():
        np.testing.assert_array_equal(same.problem.columns[key], columns)
    assert same.floor == case.floor
