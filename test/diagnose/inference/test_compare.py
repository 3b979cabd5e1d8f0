# SPDX-License-Identifier: BSD-3-Clause
"""Explanations compared at their own values, and the probabilities that are made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from diagnose_tools import EXACT_TORQUES, index, softened, standing, stretched

from coman_reduced_model.core.base.delays import shifted
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.effects.unknown import LINKS
from coman_reduced_model.diagnose.data.masks import masks, part_of
from coman_reduced_model.diagnose.data.recording import Recording
from coman_reduced_model.diagnose.data.signals import lagged
from coman_reduced_model.diagnose.inference import compare as comparison
from coman_reduced_model.diagnose.inference.case import Case, evidence_of, examine
from coman_reduced_model.diagnose.inference.case_cache import CaseCache
from coman_reduced_model.diagnose.inference.compare import _settled, compare, confirmation
from coman_reduced_model.diagnose.inference.decide import nats_for_alarm, odds
from coman_reduced_model.diagnose.inference.explanation import (
    Explanation,
    by_law,
    features,
    law_of,
    standing_out,
    worst_leftover,
)
from coman_reduced_model.diagnose.inference.finding import ChosenEffect, Finding
from coman_reduced_model.diagnose.inference.gauss_newton import settled
from coman_reduced_model.diagnose.physics.hypotheses import Candidate, candidates

NOMINAL = load_nominal()
WEIGHTS = {"one": -4.0, "evidence": 2.0, "ways": 1.0, "leftover": 0.5, "apart": 1.0, "pulled": 0.5, "unknown": -3.0}


def explanation(name: str = "", gain: float = 0.0, confirmed: float = 0.0, left: float = 1.0) -> Explanation:
    option = Candidate(name, "", ()) if name else None
    leftover = {"spring/knee|single": left}
    return Explanation(option, None, gain, confirmed, 1, leftover, {}, 0.0)  # type: ignore[arg-type]


@pytest.fixture
def nominal():
    decision = {"selected": WEIGHTS, "alone": {**WEIGHTS, "evidence": 1.0}}
    return replace(
        NOMINAL,
        decision=decision,
        leftover={"spring|single": (1.0, 0.5), "spring|single apart": (2.0, 0.3)},
    )


def test_a_much_softer_spring_is_found_at_its_true_value(factor=0.08):
    """Far from where it is linear: the drive of an ankle's roll that has worn out, its damper as it was."""
    joint, world = "LAnkLat", standing()[1]
    k, d = factor * world.stiffness[index(joint)], world.damping[index(joint)]
    recording = stretched(lambda tau, _: lagged(tau, d / k) / k, joint)
    prepared = recording, world, masks(recording, world)
    cache = CaseCache([prepared], [prepared], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train, finding.hold = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    rivals = [o for o in candidates(cache.known) if o.where == joint and o.effect in ("joint_stiffness", "backlash")]
    nothing, *others = compare(finding, cache, rivals)
    assert nothing.option is None and nothing.gain == nothing.confirmed == 0.0
    best = next(each for each in others if each.option is not None and each.option.effect == "joint_stiffness")
    assert best.option is not None and best.gain > 10.0 < best.confirmed
    (i,) = best.option.unknowns
    assert cache.known[i].value(best.fit.x[i]) == pytest.approx(factor, rel=0.15)


@pytest.mark.slow
def test_another_recording_speaks_for_a_spring_that_is_soft_there_too_and_against_one_that_is_not(joint="LKneeSag"):
    world = standing()[1]
    softer, nominal = softened(joint, 0.6), softened(joint, 1.0)
    cache = CaseCache([(softer, world, masks(softer, world))], [], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train = cache.at(finding.at, "train")
    (option,) = (o for o in candidates(cache.known) if o.where == joint and o.effect == "joint_stiffness")
    at, _, fit = settled(finding, cache, list(option.unknowns))

    def nats(recording: Recording) -> float:
        held = examine((recording, world, masks(recording, world)), cache.known, at)
        return confirmation(cache.known, fit, [held], option, list(option.unknowns), load_nominal())

    assert nats(softer) > 10.0 and nats(nominal) < -10.0
    unknown = np.where(np.arange(softer.q.shape[1]) == index(joint), np.nan, softer.motor_q)
    assert np.isnan(nats(softer.changed(motor_q=unknown)))  # it does not show


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 0.7])
def test_a_softer_spring_is_fitted_at_its_true_value(factor):
    """What is linear about nominal explains nearly as much there, and is far off."""
    joint, world = "LKneeSag", standing()[1]
    recording = softened(joint, factor)
    cache = CaseCache([(recording, world, masks(recording, world))], [], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train = cache.at(finding.at, "train")
    (option,) = (o for o in candidates(cache.known) if o.where == joint and o.effect == "joint_stiffness")
    (i,) = option.unknowns
    _, _, fit = settled(finding, cache, [i])
    assert cache.known[i].value(fit.x[i]) == pytest.approx(factor, rel=0.03)


@pytest.mark.slow
def test_a_shift_in_time_is_judged_by_derivatives_of_the_shifted_streams():
    """By those of the streams as measured, other parameters took up what a wrong shift leaves."""
    recording, world = standing()
    recording = recording.changed(tau=shifted(recording.tau, -0.012, recording.rate))
    prepared = recording, world, masks(recording, world)
    cache = CaseCache([prepared], [prepared], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train, finding.hold = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    late = next(o for o in candidates(cache.known) if o.effect == "encoder_delay" and o.where == LINKS)
    key = "spring/LKneeSag|any"
    for case in (each for several in _settled(finding, cache, late) for each in several):
        assert case.evidence.at[late.unknowns[0]] > 0.005
        again = examine(prepared, cache.known, case.evidence.at)
        np.testing.assert_allclose(case.problem.columns[key], again.problem.columns[key])
        assert np.abs(case.problem.columns[key] - finding.train[0].problem.columns[key]).max() > 1e-3
    # Once it is found, other effects are compared along it: each has values of its own, the shift stays.
    finding.at = case.evidence.at
    finding.chosen = [ChosenEffect(late, 100.0, 100.0)]
    finding.train, finding.hold = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    finding.fit = evidence_of(finding.train).fit(finding.released)
    soft = next(o for o in candidates(cache.known) if o.effect == "joint_stiffness" and o.where == "LKneeSag")
    for beside in (each for several in _settled(finding, cache, soft) for each in several):
        assert beside.evidence.at[late.unknowns[0]] == finding.at[late.unknowns[0]]
        np.testing.assert_allclose(
            beside.problem.columns[key][:, late.unknowns], again.problem.columns[key][:, late.unknowns]
        )


def test_what_fits_better_by_all_else_is_no_evidence(monkeypatch):
    """Where a rival was settled, a tenth less was left of all laws, whatever its value."""
    recording, world = standing()
    noise = 1e-3 * np.random.default_rng(0).standard_normal(recording.q.shape)  # [rad] of encoders
    recording = recording.changed(q=recording.q + noise)
    prepared = recording, world, masks(recording, world)
    cache = CaseCache([prepared], [prepared], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train, finding.hold = cache.at(finding.at, "train"), cache.at(finding.at, "hold")

    def better(case: Case) -> Case:
        return replace(case, problem=replace(case.problem, rows={key: 0.9 * r for key, r in case.problem.rows.items()}))

    def settled(finding: Finding, *_: object) -> tuple[list[Case], list[Case]]:
        return [better(case) for case in finding.train], [better(case) for case in finding.hold]

    monkeypatch.setattr(comparison, "_settled", settled)
    rivals = [o for o in candidates(cache.known) if o.effect == "joint_damping" and o.where in ("LHipLat", "RHipSag")]
    _, *others = compare(finding, cache, rivals)
    assert len(others) == 2 and max(each.gain for each in others) < 1.0
    assert not max(each.confirmed for each in others) > 1.0


@pytest.mark.slow
def test_late_drives_are_no_late_joint_states():
    """Nominal robots' clocks vary less than their drives: judged along its own shift only, a clock was likelier."""
    recording, world = standing()
    noise = 1e-4 * np.random.default_rng(0).standard_normal(recording.q.shape)  # [rad] of encoders
    early = shifted(recording.motor_q, 0.012, recording.rate)
    prepared = recording.changed(motor_q=early, q=recording.q + noise), world, masks(recording, world)
    cache = CaseCache([prepared], [prepared], EXACT_TORQUES)
    finding = Finding(cache.known, np.zeros(len(cache.known)))
    finding.train, finding.hold = cache.at(finding.at, "train"), cache.at(finding.at, "hold")
    drives = [o for o in candidates(cache.known) if o.effect in ("transport_delay", "motor_lag") and not o.where]
    clocks = [o for o in candidates(cache.known) if o.effect == "encoder_delay"]
    _, *found = compare(finding, cache, [*drives, *clocks])
    assert all(each.gain > 30.0 and each.confirmed > 30.0 for each in found[: len(drives)])
    assert all(each.gain < 0.0 for each in found[len(drives) :]) and len(clocks) == 2


def test_probabilities_add_up_and_follow_the_evidence(nominal):
    alone = odds([explanation()], nominal)
    assert alone.none + alone.unknown == pytest.approx(1.0) and alone.none > 0.8 and alone.named == 0.0
    rivals = [explanation("payload", 40.0, 30.0), explanation("backlash", 2.0, -5.0)]
    found = odds([explanation(), *rivals], nominal)
    assert found.none + found.unknown + sum(found.effects) == pytest.approx(1.0)
    assert found.named > 0.8 and found.group == (0,)
    # Evidence of the training recordings that the selecting ones contradict is worth nothing.
    assert odds([explanation(), explanation("payload", 40.0, -30.0)], nominal).named < 0.2
    # What no explanation explains is unknown.
    assert odds([explanation(left=100.0)], nominal).unknown > 0.5


def test_one_joint_that_no_effect_explains_is_unknown(nominal):
    """Where a robot leaves twice as much in all joints, it is the robot; where it does so in one, it is the joint."""
    usual = {f"spring/{joint}|single": 1.0 for joint in "abcdefgh"}

    def left(values: Mapping[str, float]) -> Explanation:
        return replace(explanation(), leftover=values)

    assert features(0.0, 0.0, 1, usual, {}, nominal)["apart"] == 0.0
    assert odds([left(dict.fromkeys(usual, 2.0))], nominal).none > 0.8
    alone = left({**usual, "spring/c|single": 12.0})
    assert alone.features(nominal)["apart"] == pytest.approx(np.log(6.0) / 0.3)
    assert odds([alone], nominal).unknown > 0.5
    few = {key: alone.leftover[key] for key in list(usual)[:5]}
    assert features(0.0, 0.0, 1, few, {}, nominal)["apart"] == 0.0, "of five none stands out"
    axes = {f"unloaded/{foot}/f{axis}|single": 1.0 for foot in ("left", "right") for axis in "xyz"}
    assert not standing_out({**axes, "unloaded/left/fx|single": 9.0}), "axes of a sensor are no joints"
    assert standing_out(alone.leftover) == {"spring/c|single": 12.0}
    assert by_law(by_law(alone.leftover)) == by_law(alone.leftover)
    assert by_law(alone.leftover) == {"spring|single": 12.0, "spring|single apart": 12.0}


def test_no_alarm_without_little_doubt(nominal):
    explanations = [explanation(), explanation("payload", 20.0, 10.0)]
    careful = replace(nominal, decision={"selected": {**WEIGHTS, "alarm": 0.001}})
    assert odds(explanations, nominal).alarms  # weights without an alarm
    found = odds(explanations, careful)
    assert found.named == odds(explanations, nominal).named and found.names and not found.alarms


@pytest.mark.parametrize("ways", [1, 12])
@pytest.mark.parametrize("selected", [True, False])
def test_evidence_for_an_alarm_raises_one(nominal, ways, selected):
    decision = {name: {**weights, "alarm": 0.1} for name, weights in nominal.decision.items()}
    nominal = replace(nominal, decision=decision)
    for times, raised in ((1.01, True), (0.99, False)):
        nats = times * nats_for_alarm(nominal, ways, selected)
        of_effect = replace(explanation("payload", nats, nats if selected else np.nan), ways=ways)
        nothing = explanation(confirmed=0.0 if selected else np.nan)
        assert odds([nothing, of_effect], nominal).alarms == raised


def test_what_cannot_be_told_apart_is_a_group(nominal):
    rivals = [explanation("external_force", 20.0, 10.0), explanation("ground_slope", 19.0, 9.5)]
    found = odds([explanation(), *rivals], nominal)
    assert set(found.group) == {0, 1} and found.named == pytest.approx(sum(found.effects))


def test_what_recordings_tell_apart_the_other_way_is_no_group(nominal):
    """By its evidence the other is ahead, but there are many places at which it could be: they are two, not one."""
    rivals = [explanation("com_offset", 60.0, 60.0), replace(explanation("encoder_bias", 66.0, 66.0), ways=12)]
    found = odds([explanation(), *rivals], nominal)
    assert found.effects[0] > found.effects[1] and found.group == (0,) and found.named == found.effects[0]


def test_what_held_out_walks_do_not_show_is_compared_by_the_others(nominal):
    rivals = [explanation("external_force", 20.0, 10.0), explanation("ground_slope", 19.0, np.nan)]
    assert set(odds([explanation(), *rivals], nominal).group) == {0, 1}
    rivals = [explanation("external_force", 20.0, 10.0), explanation("ground_slope", 30.0, np.nan)]
    assert len(odds([explanation(), *rivals], nominal).group) == 1


def test_without_selecting_recordings_other_weights_count(nominal):
    nothing, rival = explanation(confirmed=np.nan), explanation("payload", 40.0, np.nan)
    assert nothing.features(nominal)["evidence"] == 0.0
    assert (
        0.0
        < odds([nothing, rival], nominal).named
        < odds([explanation(), explanation("payload", 40.0, 40.0)], nominal).named
    )


def test_laws_are_the_same_on_any_robot(nominal):
    assert law_of("spring/l_knee|single") == "spring|single" == law_of("spring|single")
    assert law_of("unloaded/left/fz|single") == "unloaded/f|single" == law_of("unloaded/f|single")
    assert law_of("force/x|double") == "force/x|double"
    assert worst_leftover({"spring/l_knee|single": np.e, "plan/x|single": 1e6}, nominal) == pytest.approx(
        2.0
    )  # a law that no robot showed says nothing
    assert features(0.0, 0.0, 1, {}, {"mass.spread": np.e}, nominal)["pulled"] == pytest.approx(1.0)


def test_a_part_of_a_recording_has_only_its_ticks():
    recording, world = standing()
    where = masks(recording, world)
    first, last = part_of(where, 0.0, 0.5), part_of(where, 0.5, 1.0)
    assert not (first.steady & last.steady).any()
    np.testing.assert_array_equal(first.steady | last.steady, where.steady)


def test_an_effect_is_named_with_its_kin(nominal):
    """A lag and a delay of the drives are of one class, and so are the weights: together they may be likely enough."""
    rivals = [explanation("motor_lag", 60.0, 60.0), explanation("transport_delay", 50.0, 50.0)]
    others = [explanation("encoder_delay", 55.0, 55.0)]
    found = odds([explanation(), *rivals, *others], nominal)
    assert found.group == (0,) and set(found.kin) == {0, 1}
    assert found.named < 0.5 * (1.0 - found.none) < found.effects[0] + found.effects[1] and found.names
    assert not odds([explanation(), rivals[0], *others, *others], nominal).names
