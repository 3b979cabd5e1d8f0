# SPDX-License-Identifier: BSD-3-Clause
"""Expected log Bayes factors: against the mean over robots that are drawn, and what they say of groups."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose_tools import made_up

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.diagnose.inference.another import shown_by
from coman_reduced_model.diagnose.inference.evidence import Evidence, scores
from coman_reduced_model.diagnose.inference.isolability import APART, Expectation, isolability, rivals, shows, taken_for
from coman_reduced_model.diagnose.inference.prior import prior_variance
from coman_reduced_model.diagnose.physics.hypotheses import candidates

KNOWN = [
    made_up("backlash", 0.2, 2.0),
    made_up("hysteresis", 0.2, 2.0),  # in the same direction, nearly
    made_up("payload", 0.0, 1.0, key="mass"),
    made_up("payload", 0.0, 1.0, key="x"),
    made_up("com_offset", 0.0, 1.0),  # what the recordings do not show
    made_up("", 0.5, 0.5, own=True),
]
OPTIONS = candidates(KNOWN)
NAMES = {option.name: option for option in OPTIONS if len(option.unknowns) == 1 or option.effect != "payload"}


def columns() -> np.ndarray:
    A = np.random.default_rng(0).standard_normal((60, len(KNOWN)))
    A[:, 1] = A[:, 0] + 0.05 * A[:, 1]
    A[:, 4] = 0.0
    return A


def evidence(residuals: np.ndarray | None = None) -> Evidence:
    A = columns()
    r = np.zeros(len(A)) if residuals is None else residuals
    return Evidence(KNOWN, np.zeros(len(KNOWN)), A.T @ A, A.T @ r, float(r @ r))


@pytest.mark.slow
@pytest.mark.parametrize("true", [np.array([0.8, 0, 0, 0, 0, 0]), np.array([0, 0, 0.4, -0.6, 0, 0])])
def test_the_expected_evidence_is_its_mean_over_robots(true):
    rng, A, sums = np.random.default_rng(1), columns(), dict.fromkeys(map(id, OPTIONS), 0.0)
    draws = 2000
    for _ in range(draws):
        varies = np.sqrt(prior_variance(KNOWN)) * rng.standard_normal(len(KNOWN))
        residuals = A @ (true + varies) + rng.standard_normal(len(A))
        for score in scores(evidence(residuals), OPTIONS):
            sums[id(score.option)] += score.gain / draws
    for option in OPTIONS:
        assert Expectation(evidence()).of([option], true) == pytest.approx(sums[id(option)], rel=0.05, abs=0.15)


def test_what_looks_alike_is_a_group_and_what_does_not_show_is_in_none():
    found = isolability(evidence(), OPTIONS, 0.8)
    names = [option.effect for option in found.options]
    assert [{names[i] for i in group} for group in found.groups] == [{"backlash", "hysteresis"}]
    assert [names[i] for i in found.hidden] == ["com_offset"]
    payload, play = names.index("payload"), names.index("backlash")
    assert found.factors[payload, play] > APART < found.shown[payload]
    assert found.sizes[play] == {"x": pytest.approx(1.6)}
    assert np.diag(found.factors) == pytest.approx(0.0)


def test_larger_effects_are_told_apart():
    small, large = (isolability(evidence(), OPTIONS, size) for size in (0.8, 20.0))
    assert not large.groups and (large.factors >= small.factors - 1e-9).all()


def test_a_pair_counts_by_the_way_in_which_it_is_less_distinct():
    found = isolability(evidence(), OPTIONS, 0.8)
    (pair,) = found.pairs
    assert {found.options[i].effect for i in pair} == {"backlash", "hysteresis"}
    assert found.apart(pair) == pytest.approx(min(found.factors[pair], found.factors[pair[::-1]])) and (
        found.apart(pair) < APART
    )


def test_what_was_found_could_be_something_like_it():
    values = np.zeros(len(KNOWN))
    values[0] = 1.0
    rivals = taken_for(evidence(), OPTIONS, NAMES["backlash"], values)
    assert [option.effect for option, _ in rivals] == ["hysteresis"] and rivals[0][1] < APART
    values[0] = 30.0
    assert not taken_for(evidence(), OPTIONS, NAMES["backlash"], values)


def play_against_hysteresis(more: np.ndarray | None) -> float:
    """Expected log Bayes factor, if there is play."""
    values = np.zeros(len(KNOWN))
    values[0] = 1.0
    found = rivals(Expectation(evidence(), more), OPTIONS, NAMES["backlash"], values)
    return {option.effect: factor for option, factor in found}["hysteresis"]


def test_an_experiment_that_measures_an_effect_distinguishes_it_from_what_looks_alike():
    """It counts as a measurement of the parameters, as exact as the file says."""
    here = evidence()
    for effect in ("backlash", "hysteresis"):
        more = shown_by([NAMES[effect]], KNOWN, np.zeros_like(here.gram), load_nominal())
        row = np.array([each.effect == effect for each in KNOWN]) / (0.05 * 2.0)
        assert more == pytest.approx(np.outer(row, row))
        assert play_against_hysteresis(more) > APART > play_against_hysteresis(None)


def test_a_walk_without_the_effect_says_more_than_the_same_walk_again(monkeypatch):
    here = evidence()
    monkeypatch.setattr(CATALOGUE["backlash"], "absent", True)
    without = shown_by([NAMES["backlash"]], KNOWN, here.gram, load_nominal())
    assert not without[0].any() and not without[:, 0].any()
    assert without[1:, 1:] == pytest.approx(here.gram[1:, 1:])

    assert play_against_hysteresis(without) > play_against_hysteresis(here.gram) + APART


def test_what_does_not_show_could_be_anything():
    values, expectation = np.zeros(len(KNOWN)), Expectation(evidence())
    assert len(taken_for(evidence(), OPTIONS, NAMES["backlash"], values)) == 3  # all there are
    assert not shows(expectation, NAMES["backlash"], values)
    values[0] = 1.0
    assert shows(expectation, NAMES["backlash"], values)
