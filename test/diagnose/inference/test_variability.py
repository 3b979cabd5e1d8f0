# SPDX-License-Identifier: BSD-3-Clause
"""How much robots vary, learnt from robots that were drawn with known widths."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from diagnose_tools import made_up, standing

from coman_reduced_model.core.base.nominal import Nominal
from coman_reduced_model.core.effects.unknown import Unknown
from coman_reduced_model.diagnose.inference.case import Case
from coman_reduced_model.diagnose.inference.compare import pulled_together
from coman_reduced_model.diagnose.inference.evidence import Evidence, scores
from coman_reduced_model.diagnose.inference.variability import (
    _parts_of,
    adapted,
    learn_widths,
    means_of,
    widths_of_robot,
    with_widths,
)
from coman_reduced_model.diagnose.physics.hypotheses import Candidate, unknowns

JOINTS = 8
POPULATION = Nominal({"play.spread": 0.1, "zero_f.spread": 1.0}, most={"play.spread": 0.5})


def figures() -> list[Unknown]:
    def of(name: str, i: int, spread: float, own: bool) -> Unknown:
        return replace(made_up("", spread, spread, where=str(i), own=own), widths={"spread": name})

    return [of("play.spread", i, 0.1, False) for i in range(JOINTS)] + [
        of("zero_f.spread", i, 1.0, True) for i in range(JOINTS)
    ]


def recordings(rng, play: float, zero: float, count: int = 3) -> list[Evidence]:
    """Of one robot: its play is the same in each, its zeros are not."""
    known, values = figures(), play * rng.standard_normal(JOINTS)
    out = []
    for _ in range(count):
        x = np.concatenate([values, zero * rng.standard_normal(JOINTS)])
        A = rng.normal(size=(200, 2 * JOINTS))
        r = A @ x + 0.2 * rng.standard_normal(200)
        out.append(Evidence(known, np.zeros(2 * JOINTS), 25.0 * A.T @ A, 25.0 * A.T @ r, 25.0 * float(r @ r)))
    return out


@pytest.mark.parametrize("wider", [1.0, 2.0])
def test_how_far_nominal_robots_are_pulled_together_is_chi_squared(wider):
    """In standard deviations of chi squared, by as many directions as a recording shows; wider robots are beyond it."""
    rng, found = np.random.default_rng(0), []
    for _ in range(400):
        (evidence,) = recordings(rng, 0.1 * wider, wider, count=1)
        case = cast(Case, SimpleNamespace(evidence=evidence))
        found.append(pulled_together([case], evidence.fit(), ()))
    shown = 2 * JOINTS  # by each recording, all of them
    beyond = (wider**2 - 1.0) * np.sqrt(shown / 2.0)
    assert np.mean(found) == pytest.approx(beyond, abs=0.15 * wider**2)
    assert np.std(found) == pytest.approx(wider**2, rel=0.15)


def test_a_population_gets_the_widths_that_it_was_drawn_with():
    rng = np.random.default_rng(0)
    widths = learn_widths([recordings(rng, 0.3, 2.0) for _ in range(40)], POPULATION).widths
    assert widths["play.spread"] == pytest.approx(0.3, rel=0.2)
    assert widths["zero_f.spread"] == pytest.approx(2.0, rel=0.2)


def test_masses_are_as_on_any_robot_on_precise_ones_too():
    """Walks hardly show them: what is learnt of precise robots stays near where it began."""
    known = unknowns(*standing())
    masses = [each for each in known if each.key == "mass" and not each.effect]
    assert masses and all(each.precise is None for each in masses)
    assert "mass.spread" not in _parts_of(known) and "com.spread" in _parts_of(known)


@pytest.mark.slow
def test_precise_robots_of_a_population_have_widths_of_their_own():
    rng = np.random.default_rng(4)
    robots = [recordings(rng, play, 1.0) for play in (0.3, 0.02) for _ in range(30)]
    found = learn_widths(robots, POPULATION)
    assert found.widths["play.spread"] == pytest.approx(0.3, rel=0.2)
    assert found.precise == {"play.spread": pytest.approx(0.02, rel=0.4)}
    assert [widths_of_robot(robot, found)[0] for robot in robots] == [()] * 30 + [("robot",)] * 30
    assert widths_of_robot(robots[-1], found)[1]["play.spread"] == found.precise["play.spread"]


@pytest.mark.parametrize("play", [0.1, 0.001])
def test_what_is_usual_for_most_robots_stands_out_on_a_precise_one(play):
    """A delay of 3, where most have 2 and precise robots 0.05: only where nothing has any play it is an effect."""
    known = [replace(each, precise=0.001) for each in figures()[:JOINTS]]
    known.append(Unknown("encoder_delay", "", "delay", "ms", lambda r, w, x: (r, w), 30.0, spread=2.0, precise=0.05))
    rng, x = np.random.default_rng(5), np.zeros(JOINTS + 1)
    x[:JOINTS], x[-1] = play * rng.standard_normal(JOINTS), 3.0
    gram = 1e8 * np.eye(JOINTS + 1)
    one = Evidence(known, np.zeros(len(x)), gram, gram @ x, float(x @ gram @ x))
    (late,) = scores(one, [Candidate("encoder_delay", "", (JOINTS,))])
    assert (late.gain > 10.0) == (play < 0.01)
    assert one.fit().precise == () and one.fit([JOINTS]).precise == (("robot",) if play < 0.01 else ())
    each = adapted([one], POPULATION)
    assert each[0].spread >= 0.04 and each[0].precise <= 0.001 and each[-1].precise == 0.05


def test_no_width_is_more_than_plausible_and_one_odd_robot_changes_little():
    rng = np.random.default_rng(1)
    assert learn_widths([recordings(rng, 2.0, 1.0) for _ in range(10)], POPULATION).widths["play.spread"] == 0.5
    robots = [recordings(rng, 0.1, 1.0) for _ in range(19)]
    odd = learn_widths([*robots, recordings(rng, 0.1, 300.0)], POPULATION).widths
    assert odd["zero_f.spread"] < 1.6


def test_a_robot_whose_zeros_are_all_large_varies_more_but_one_large_zero_stands_out():
    rng = np.random.default_rng(2)
    known = adapted(recordings(rng, 0.1, 50.0), POPULATION)
    assert known[-1].spread == pytest.approx(50.0, rel=0.5) and known[0].spread == pytest.approx(0.1, rel=0.6)
    single = recordings(rng, 0.1, 1.0)
    for each in single:
        each.moment += 100.0 * each.gram[:, -1]
    assert adapted(single, POPULATION)[-1].spread < 3.0
    assert adapted(recordings(rng, 5.0, 1.0), POPULATION)[0].spread <= 0.5 + 1e-9  # no more than is plausible


@pytest.mark.parametrize(("off", "least"), [(0.005, 1.0), (0.05, 4.0)])
def test_an_imu_that_is_mounted_otherwise_widens_what_an_imu_may_be_off_by(off, least):
    imu = [
        replace(made_up("", 0.004, 0.004, where=axis), widths={"spread": "imu.spread"}) for axis in ("roll", "pitch")
    ]
    known, x = [*figures(), *imu], np.concatenate([np.zeros(2 * JOINTS), [off, 0.0]])
    A = np.random.default_rng(3).normal(size=(200, len(known)))
    one = Evidence(known, np.zeros(len(known)), 1e6 * A.T @ A, 1e6 * A.T @ A @ x, 1e6 * float(x @ A.T @ A @ x))
    found = adapted([one], replace(POPULATION, widths=POPULATION.widths | {"imu.spread": 0.004}))[-2:]
    assert all(least * 0.004 <= each.spread <= 1.5 * off for each in found)


def test_spreads_are_relative_to_what_their_parameter_says():
    (one,) = with_widths([replace(figures()[0], relative=3.0)], {"play.spread": 0.2})
    assert one.spread == pytest.approx(0.6)


@pytest.mark.parametrize("own", [False, True])
def test_what_robots_have_some_of_anyway_is_found_whether_of_a_robot_or_of_each_recording(own):
    rng, known = np.random.default_rng(8), [made_up("", 0.5, 0.5, own=own)]
    known = [replace(known[0], widths={"spread": "knock.spread", "usual": "knock.usual"})]
    robots = []
    for _ in range(60):
        r = 0.3 + 0.1 * rng.standard_normal((2, 50))
        robots.append(
            [
                Evidence(known, np.zeros(1), np.full((1, 1), 5e3), np.array([1e2 * x.sum()]), 1e2 * float(x @ x))
                for x in r
            ]
        )
    assert means_of(robots, Nominal({"knock.spread": 0.5}))["knock.usual"] == pytest.approx(0.3, rel=0.2)
