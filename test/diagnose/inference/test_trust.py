# SPDX-License-Identifier: BSD-3-Clause
"""How far laws are trusted, learnt from robots of which some laws are off by more than they know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_tools import made_up, standing

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.effects.unknown import Unknown
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.inference.case import examine
from coman_reduced_model.diagnose.inference.evidence import Part, pooled, weighed
from coman_reduced_model.diagnose.inference.trust import ByLaw, agreement, learn_trust
from coman_reduced_model.diagnose.physics.hypotheses import unknowns

SHARED, OWN = 3, 2
SIZE = SHARED + OWN
WIDTHS = {"spring.spread": 1.0, "zero.spread": 0.5}


def figures() -> list[Unknown]:
    names = ["spring"] * SHARED + ["zero"] * OWN
    return [
        replace(made_up("", 1.0, 1.0, where=str(i), own=name == "zero"), widths={"spread": f"{name}.spread"})
        for i, name in enumerate(names)
    ]


def recordings(rng: np.random.Generator, off: dict[str, float], count: int = 3) -> list[ByLaw]:
    """Of one robot. Each law claims noise of 0.1; its model is off by `off` of each parameter, other in each walk."""
    x = np.concatenate([rng.standard_normal(SHARED), np.zeros(OWN)])
    out = []
    for _ in range(count):
        x[SHARED:] = 0.5 * rng.standard_normal(OWN)
        parts = []
        for law, error in off.items():
            A = rng.normal(size=(20, SIZE))
            r = A @ (x + error * rng.standard_normal(SIZE)) + 0.1 * rng.standard_normal(20)
            parts.append(Part(law, np.arange(SIZE), 100.0 * A.T @ A, 100.0 * A.T @ r, 100.0 * float(r @ r)))
        out.append(ByLaw(figures(), parts))
    return out


def trust_of(robots: list[list[ByLaw]]) -> dict[str, float]:
    """Learnt from robots that vary by WIDTHS."""
    laws = sorted({part.law for robot in robots for recording in robot for part in recording.parts})
    return learn_trust(laws, lambda trust: [agreement(robot, WIDTHS, trust) for robot in robots])


def test_evidence_about_other_values_is_that_of_the_shifted_residuals():
    rng = np.random.default_rng(3)
    A, r, x = rng.normal(size=(20, SIZE)), rng.normal(size=20), rng.normal(size=SIZE)

    def by_law(r: np.ndarray) -> ByLaw:
        return ByLaw(figures(), [Part("law", np.arange(SIZE), A.T @ A, A.T @ r, float(r @ r))])

    (moved,), (wanted,) = by_law(r).about(x).parts, by_law(r - A @ x).parts
    np.testing.assert_allclose(moved.moment, wanted.moment)
    assert moved.energy == pytest.approx(wanted.energy)


@pytest.mark.parametrize("error", [0.1, 0.3, 1.0])
def test_a_law_that_its_next_recording_denies_is_trusted_as_far_as_it_holds(error):
    rng = np.random.default_rng(0)
    robots = [recordings(rng, {"good": 0.0, "bad": error}) for _ in range(40)]
    trust = trust_of(robots)
    assert trust["good"] > 0.7
    # Its estimates have a standard deviation of 0.1 / sqrt(20) by its noise, and `error` by its model.
    assert np.log(trust["bad"]) == pytest.approx(np.log((0.1**2 / 20.0) / error**2), abs=np.log(4.0))


def test_few_robots_that_agree_with_nothing_change_little():
    rng = np.random.default_rng(1)
    robots = [recordings(rng, {"law": 0.0}) for _ in range(20)]
    odd = recordings(rng, {"law": 0.0}, 1) + recordings(rng, {"law": 0.0}, 1)  # two robots, taken for one
    assert trust_of([*robots, odd])["law"] > 0.5


def test_a_law_without_evidence_keeps_full_trust_and_none_has_more():
    nothing = Part("law", np.arange(SIZE), np.zeros((SIZE, SIZE)), np.zeros(SIZE), 0.0)
    silent = [[ByLaw(figures(), [nothing])] * 2] * 3
    assert trust_of(silent)["law"] == pytest.approx(1.0, abs=0.02)
    rng = np.random.default_rng(2)
    assert max(trust_of([recordings(rng, {"a": 0.0, "b": 0.0})] * 4).values()) <= 1.0


def test_agreement_is_the_log_bayes_factor_of_one_robot_and_its_slope_a_difference_quotient():
    robot = recordings(np.random.default_rng(3), {"a": 0.1, "b": 0.5})
    robot = [
        ByLaw([replace(u, spread=WIDTHS[u.widths["spread"]]) for u in each.unknowns], each.parts) for each in robot
    ]
    trust = {"a": 0.8, "b": 0.1}
    value, slopes = agreement(robot, WIDTHS, trust)
    evidences = [each.evidence(trust) for each in robot]
    assert value == pytest.approx(pooled(evidences).fit().log - sum(each.fit().log for each in evidences))
    for law in trust:
        more = agreement(robot, WIDTHS, trust | {law: trust[law] * np.exp(1e-5)})[0]
        assert slopes[law] == pytest.approx((more - value) / 1e-5, rel=1e-3, abs=1e-3)


def test_a_recording_is_the_sum_of_its_laws_each_with_its_trust():
    recording, world = standing()
    known = unknowns(recording, world)
    nominal = replace(load_nominal(), trust={"spring|any": 0.5, "force/x|double": 0.01})
    case = examine((recording, world, masks(recording, world)), known, np.zeros(len(known)), nominal=nominal)
    found, full = ByLaw.of(case).evidence(nominal.trust), ByLaw.of(case).evidence({})
    whole = weighed(case.problem, case.evidence.at, case.noise)
    np.testing.assert_allclose(found.gram, whole.gram, atol=1e-9 * np.abs(full.gram).max())
    np.testing.assert_allclose(found.moment, whole.moment, atol=1e-9 * np.abs(full.moment).max())
    assert found.energy == pytest.approx(whole.energy)
    assert not np.allclose(found.gram, full.gram)
