# SPDX-License-Identifier: BSD-3-Clause
"""What the robot weighs beyond its URDF is found whole, and no baseline takes it for usual."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose_tools import standing

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.effects.unknown import Unknown
from coman_reduced_model.diagnose.inference.evidence import Evidence
from coman_reduced_model.diagnose.inference.weight import weight
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns

OFF = 0.08


def is_mass(unknown: Unknown) -> bool:
    return not unknown.effect and unknown.key == "mass"


def case(
    known: list[Unknown], truth: np.ndarray, at: np.ndarray, walks: bool = True, carried: float = 1.0 + OFF
) -> SimpleNamespace:
    """A recording of which each unknown is seen to some of its spread; deviations `truth` (P,) from nominal.

    `carried`: vertical force over that of the nominal weight.
    """
    recording, world = standing()
    gram = np.diag([1.0 / max(unknown.spread, 1e-6) ** 2 for unknown in known])
    moment = gram @ (truth - at - [unknown.usual for unknown in known])
    phase = np.where(recording.t < 2.0, Phase.LEFT, Phase.RIGHT) if walks else recording.phase
    evidence = Evidence(known, at, gram, moment, 0.0)
    return SimpleNamespace(
        evidence=evidence,
        said_by=lambda laws: evidence,
        state=SimpleNamespace(world=world),
        recording=recording.changed(
            phase=phase, wrench={foot: carried * wrench for foot, wrench in recording.wrench.items()}
        ),
    )


def heavy(known: list[Unknown]) -> np.ndarray:
    """(P,) deviations of a robot whose links are all heavier by OFF; all else is as the population has it."""
    return np.array([OFF if is_mass(each) else each.usual for each in known])


@pytest.mark.parametrize("usual", [0.0, 0.03, 0.06])
def test_links_that_are_all_too_heavy_are_too_heavy_whatever_is_usual(usual):
    known = unknowns(*standing())
    truth = heavy(known)
    own = [
        replace(each, usual=usual, spread=0.01) if each.key == "mass" and not each.effect else each for each in known
    ]
    found = weight([case(own, truth, np.zeros(len(own)))] * 2)
    assert found.share == pytest.approx(OFF, abs=3.0 * found.deviation) and found.share > 0.075
    assert 0.0 < found.deviation < 0.01 and found.allowed == load_nominal().most["mass.spread"]


def test_a_payload_that_was_found_is_weight():
    known = unknowns(*standing())
    option = next(each for each in candidates(known) if each.effect == "payload" and len(each.unknowns) == 1)
    truth, at = np.array([each.usual for each in known]), np.zeros(len(known))
    at[option.unknowns[0]] = truth[option.unknowns[0]] = 1.4  # [kg]
    found = weight([case(known, truth, at)], option.unknowns)
    assert found.share == pytest.approx(1.4 / standing()[1].robot.mass, abs=0.01)


def test_a_robot_that_only_stands_does_not_say_what_it_weighs():
    known = unknowns(*standing())
    found = weight([case(known, heavy(known), np.zeros(len(known)), walks=False)])
    assert np.isnan(found.share) and np.isnan(found.deviation)


def test_what_the_vertical_forces_deny_is_no_weight():
    """As on a robot whose torques and clocks are off: other laws ask for masses that its feet do not carry."""
    known = unknowns(*standing())
    found = weight([case(known, heavy(known), np.zeros(len(known)), carried=0.99)])
    assert np.isnan(found.share) and np.isnan(found.deviation)
