# SPDX-License-Identifier: BSD-3-Clause
"""What hypotheses are computed along: wrenches as sensors with other gains read them, and what is taken over."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose_tools import standing
from hypothesis import given, settings
from hypothesis import strategies as st

from coman_reduced_model.core.effects.unknown import applied
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import FEET
from coman_reduced_model.diagnose.inference.reference import _as_read, gains_of, reference
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import unknowns

gain = st.floats(-0.4, 0.6)


@pytest.fixture(scope="module")
def robot():
    recording, world = standing()
    return recording, world, masks(recording, world), unknowns(recording, world)


def hypothesis_of(known, values):
    """(P,) of the first gains of foot sensors: of each foot and of both, and turns about three axes."""
    at = np.zeros(len(known))
    gains = np.flatnonzero(gains_of(known, np.ones(len(known))))
    at[gains[: len(values)]] = values
    return at


@settings(max_examples=10)
@given(values=st.lists(gain, min_size=1, max_size=12))
def test_taking_a_gain_back_from_what_is_read_gives_the_truth(robot, values):
    recording, world, where, known = robot
    at = hypothesis_of(known, values)
    read = _as_read(evaluate(recording, world, where), where, known, at)
    true, _ = applied(known, at, read.recording, world)
    for foot in FEET:
        np.testing.assert_allclose(true.wrench[foot], recording.wrench[foot], atol=1e-6)


def test_a_reference_is_taken_over_as_far_as_clocks_and_gains_are_the_same(robot):
    recording, world, where, known = robot
    nothing, other = np.zeros(len(known)), hypothesis_of(known, [0.2])
    first = reference(recording, world, where, known, nothing)
    mass = np.array([0.01 * (unknown.key == "mass") for unknown in known])
    assert reference(recording, world, where, known, mass, first) is first
    second = reference(recording, world, where, known, other, first)
    assert second is not first and second.measured is first.measured
    late = np.array([0.01 * (unknown.effect == "wrench_delay" and not unknown.where) for unknown in known])
    assert reference(recording, world, where, known, late, first).measured is not first.measured
