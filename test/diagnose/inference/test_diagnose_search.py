# SPDX-License-Identifier: BSD-3-Clause
"""What counts as enough, and what is one effect: the rules of the search, one by one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from diagnose_tools import FIGURES, standing, stretched, swaying
from hypothesis import given
from hypothesis import strategies as st
from synthetic import robot

from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.unknown import PLAN
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.inference import gauss_newton, search
from coman_reduced_model.diagnose.inference.case import Case, evidence_of, examine, prepare
from coman_reduced_model.diagnose.inference.case_cache import CaseCache
from coman_reduced_model.diagnose.inference.check import limitations, with_common_streams
from coman_reduced_model.diagnose.inference.effects import effect_entries, with_effects
from coman_reduced_model.diagnose.inference.evidence import Noise, Problem, Score, weighed
from coman_reduced_model.diagnose.inference.finding import ChosenEffect, Finding, size
from coman_reduced_model.diagnose.inference.search import ENOUGH, FEWER, SUSPECTED
from coman_reduced_model.diagnose.inference.verdict import limit_of
from coman_reduced_model.diagnose.physics.hypotheses import Candidate, candidates, unknowns
from coman_reduced_model.diagnose.report.words import effect_sentence


def test_one_of_few_ways_needs_less_than_one_of_many_places():
    needed = search._needed(ENOUGH, candidates(unknowns(*standing())))
    assert needed["backlash"] == needed["joint_stiffness"] == needed["wrench_bias"] == ENOUGH
    assert needed["payload"] == needed["com_offset"] == needed["encoder_delay"] == ENOUGH - FEWER
    # Where something is missing for sure, so little is asked for that few ways make no difference.
    assert set(search._needed(SUSPECTED, candidates(unknowns(*standing()))).values()) == {SUSPECTED}


def test_a_channel_has_the_limit_of_its_own_or_of_its_law():
    most = {"force": 3.5, "force/y": 6.0}
    assert limit_of("force/y|single", most) == 6.0 and limit_of("force/x|single", most) == 3.5
    assert limit_of("plan/x|single", most) is None


@given(st.floats(1e-6, 1e3), st.integers(0, 150))
def test_the_size_of_residuals_ignores_stumbles(sigma, stumbles):
    values = sigma * np.random.default_rng(stumbles).standard_normal(1000)
    values[:stumbles] *= 1e3
    assert size(values) == pytest.approx(sigma, rel=0.1 if stumbles == 0 else 0.5)
    assert size(values[:1]) > 0.0


def test_where_a_robot_staggers_the_laws_of_flat_soles_are_not_judged_unless_it_always_does():
    def case(staggers: bool, tau: object = "torques"):
        return SimpleNamespace(where=SimpleNamespace(staggers=staggers), recording=SimpleNamespace(tau=tau))

    known = unknowns(*standing())
    steady, edgy, without = case(False), case(True), case(True, None)
    finding = Finding(known, np.zeros(len(known)), train=[steady], hold=[edgy, without])
    for key in ("force/y|single", "moment/x", "torque/LAnkLat|double", "tilt/roll|single"):
        assert finding.judged(steady, key) and not finding.judged(edgy, key)
    assert finding.judged(edgy, "spring/LAnkLat|single") and not finding.judged(without, "spring/LAnkLat|single")
    assert finding.judged(edgy, "slide/x|single") and finding.judged(edgy, "unloaded/left/fz|single")
    always = Finding(known, np.zeros(len(known)), train=[edgy])
    assert always.judged(edgy, "force/y|single")


def test_warnings_of_a_recording_are_among_its_limitations():
    prepared = prepare(swaying(Phase.LEFT), robot(), Config())
    lines = limitations([prepared], held_out=True)
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


@pytest.mark.parametrize(
    ("disagrees", "impossible"), [("", ""), ("held-out bags speak against it", ""), ("", "a load without a mass")]
)
def test_a_shifted_com_and_a_mass_are_one_load_if_held_out_bags_agree(monkeypatch, disagrees, impossible):
    known = unknowns(*standing())
    options = candidates(known)
    shift, mass, whole, other = (
        next(o for o in options if o.effect == effect and len(o.unknowns) == count)
        for effect, count in (("com_offset", 1), ("payload", 1), ("payload", 4), ("backlash", 1))
    )
    asked = {}

    def settled(finding, cache, released):
        asked["released"] = released
        return np.ones(len(known)), ["train"], "fit"

    monkeypatch.setattr(search, "evidence_of", lambda cases: None)
    monkeypatch.setattr(search, "scores", lambda e, o, r: [Score(o[0], 30.0, 25.0, np.zeros(4), True)])
    monkeypatch.setattr(search, "settled", settled)
    monkeypatch.setattr(search, "_confirm", lambda *a: (12.0, disagrees))
    monkeypatch.setattr(search, "_impossible", lambda *a: impossible)
    before = [ChosenEffect(shift, 9.0, 9.0), ChosenEffect(other, 50.0, 50.0), ChosenEffect(mass, 9.0, 9.0)]
    finding = Finding(known, np.zeros(len(known)), chosen=list(before))
    search._one_load(finding, SimpleNamespace(at=lambda at, which: ["hold"]), options)
    assert asked["released"] == [*other.unknowns, *whole.unknowns]
    if disagrees or impossible:
        assert finding.chosen == before and not finding.at.any()
    else:
        assert finding.chosen == [before[1], ChosenEffect(whole, 25.0, 12.0)]
        assert finding.at.all() and (finding.train, finding.hold, finding.fit) == (["train"], ["hold"], "fit")


@pytest.mark.parametrize("reference", ["motor", "topic"])
def test_what_measured_motor_states_show_is_named_but_needs_no_change_of_the_model(reference):
    recording, world = standing()
    still = np.zeros((len(recording.t), 2))
    known = unknowns(recording.changed(plan=still, moved=still), world)
    config = Config().replaced({"prediction.reference": reference})
    against_plan = [option for option in candidates(known) if option.where == PLAN]
    assert {option.effect for option in against_plan} == {"motor_compliance", "motor_lag", "transport_delay"}
    fit = SimpleNamespace(x=np.full(len(known), 0.01), covariance=np.eye(len(known)))
    for option in against_plan:
        finding = Finding(known, np.zeros(len(known)), chosen=[ChosenEffect(option, 9.0, 9.0)], fit=fit)
        (entry,) = effect_entries(finding, config)
        added = option.effect in {effect.name for effect in with_effects(config, [entry]).effects}
        assert entry["in_model"] == added == (reference == "topic")
        assert ("the motor states show it" in effect_sentence(entry)) == (reference == "motor")


@pytest.mark.parametrize(("where", "apart"), [("spring/knee|single", False), ("force/x|single", True)])
def test_evidence_is_apart_where_the_chosen_effects_do_nothing(where, apart):
    """One effect makes a spring law's residual, another that of the same law or of a balance that the first leaves."""
    rng, n = np.random.default_rng(1), 200
    groups = ["spring/knee|single", "force/x|single"]
    columns = {key: np.zeros((n, len(FIGURES))) for key in groups}
    columns[groups[0]][:, 0] = rng.standard_normal(n)
    columns[where][:, 2] = rng.standard_normal(n)
    x = np.array([2.0, 0.0, 1.0, 0.0])
    pieces, times = (dict.fromkeys(groups, value) for value in (np.array([0]), np.arange(n)))
    noise = {key: Noise(np.array([0.5, 0.0, 0.0, 0.0]), 0.0) for key in groups}

    def case() -> Case:
        rows = {key: columns[key] @ x + 0.5 * rng.standard_normal(n) for key in groups}
        problem = Problem(FIGURES, rows, columns, pieces, times, {})
        evidence = weighed(problem, np.zeros(len(FIGURES)), noise)
        return Case(None, None, None, problem, evidence, noise, dict.fromkeys(groups, 0.5))

    first, second = Candidate("payload", "", (0,)), Candidate("backlash", "", (2,))
    cases = [case()], [case()]
    finding = Finding(FIGURES, np.zeros(len(FIGURES)), [ChosenEffect(first, 99.0, 99.0)], train=cases[0], hold=cases[1])
    evidence = evidence_of(finding.train)
    finding.fit = evidence.fit(finding.released)
    (score,) = search.scores(evidence, [second], finding.released)
    assert score.gain > ENOUGH
    assert search._apart(finding, finding.hold, evidence.fit([0, 2]), score, ENOUGH) == apart


def test_further_effects_need_more_unless_their_evidence_is_apart(monkeypatch):
    known = unknowns(*standing())
    options = candidates(known)
    needed = search._needed(ENOUGH, options)
    first, second = (next(o for o in options if o.effect == name) for name in ("encoder_delay", "backlash"))
    finding = Finding(known, np.zeros(len(known)), [ChosenEffect(first, 90.0, 90.0)])

    def enough(nats, apart, needed=needed):
        monkeypatch.setattr(search, "_apart", lambda *a: apart)
        return search._enough(finding, [], "fit", Score(second, nats, nats, np.ones(1), True), np.nan, ENOUGH, needed)

    assert enough(8.5, False) and not enough(7.5, False)  # 5 % of 90 beside 4.5, but 8 at most
    assert enough(4.6, True) and not enough(4.4, True)
    little = search._needed(SUSPECTED, options)  # however little is asked for
    assert not enough(ENOUGH - FEWER - 0.1, True, little) and enough(ENOUGH - FEWER + 0.1, True, little)


def test_what_explains_the_same_with_fewer_figures_is_not_compared():
    known = unknowns(*standing())
    both, alone = (
        next(o for o in candidates(known) if o.effect == "joint_friction" and len(o.unknowns) == count)
        for count in (2, 1)
    )
    other = next(o for o in candidates(known) if o.effect == "backlash")
    found = [Score(option, 9.0, 8.0, np.ones(1), True) for option in (alone, both, other)]
    assert [score.option for score in search._no_twins(found)] == [both, other]
    better = Score(alone, 9.5, 8.0, np.ones(1), True)
    assert search._no_twins([better, found[1]]) == [better, found[1]]
    assert known[both.unknowns[1]].shape and not any(known[i].shape for i in alone.unknowns)


def test_one_load_alone_stays_what_it_is():
    known = unknowns(*standing())
    options = candidates(known)
    finding = Finding(known, np.zeros(len(known)), chosen=[ChosenEffect(options[0], 9.0, 9.0)])
    search._one_load(finding, SimpleNamespace(), options)
    assert [effect.option for effect in finding.chosen] == [options[0]]


def test_rivals_that_are_compared_again_converge_to_the_same_values(monkeypatch):
    recording, world = stretched(lambda tau, nominal: 2.0 * nominal), standing()[1]
    cache = CaseCache([(recording, world, masks(recording, world))])
    soft = next(i for i, unknown in enumerate(cache.known) if unknown.name == "joint_stiffness@LKneeSag.scale")
    nothing, steps, near = np.zeros(len(cache.known)), [], cache.near
    monkeypatch.setattr(cache, "near", lambda *a: steps.append(1) or near(*a))
    first = gauss_newton._gauss_newton(cache, [soft], nothing, cache.at(nothing, "train"))
    taken = len(steps)
    again = gauss_newton._gauss_newton(cache, [soft], nothing, cache.at(nothing, "train"))
    assert first[0][soft] == pytest.approx(-0.5, abs=0.02) and taken > 1
    assert len(steps) == taken + 1
    np.testing.assert_array_equal(again[0], first[0])
    np.testing.assert_array_equal(again[2].x, first[2].x)


def test_a_second_search_gets_the_answers_of_the_first_about_the_same_effects():
    recording, world = standing()
    cache = CaseCache([(recording, world, masks(recording, world))])
    options, asked = candidates(cache.known), []
    nothing = np.zeros(len(cache.known))
    bare, beside = (Finding(cache.known, nothing, chosen) for chosen in ([], [ChosenEffect(options[0], 9.0, 9.0)]))

    def conclude(finding, cache, *of):
        asked.append((finding.released, of))
        return len(asked)

    answers = [
        cache.memoize(conclude, finding, *of)
        for finding in (bare, beside, bare, beside)
        for of in (options[:1], options[:2])
    ]
    assert answers == [1, 2, 3, 4] * 2
    assert asked[2] == (list(options[0].unknowns), tuple(options[:1]))


def test_a_case_near_another_needs_no_figure_of_its_own():
    recording, world = standing()
    prepared = recording, world, masks(recording, world)
    known = unknowns(recording, world)
    case = examine(prepared, known, np.zeros(len(known)))
    same = examine(prepared, known, np.zeros(len(known)), case, ())
    for key, columns in case.problem.columns.items():
        np.testing.assert_array_equal(same.problem.columns[key], columns)
    assert same.floor == case.floor
