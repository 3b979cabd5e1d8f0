# SPDX-License-Identifier: BSD-3-Clause
"""What another recording would add: against closed forms, and against a recording that goes on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose_tools import made_up, standing, t

from coman_reduced_model.diagnose.data.masks import TICKS, masks
from coman_reduced_model.diagnose.inference.another import Another, best_first, examined, length_of, like
from coman_reduced_model.diagnose.inference.at_size import at_share, at_values
from coman_reduced_model.diagnose.inference.case import Case, examine
from coman_reduced_model.diagnose.inference.evidence import Evidence, Problem, weighed
from coman_reduced_model.diagnose.inference.isolability import isolability
from coman_reduced_model.diagnose.inference.noise import Noise
from coman_reduced_model.diagnose.inference.reference import CLOCKS
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns

REACH, FIRST, MORE = 2.0, 5.0, 3.0  # of both parameters; information of one in the recording, in the candidate
PAIR = [made_up("backlash", 0.0, REACH), made_up("hysteresis", 0.0, REACH)]
NOTHING = np.zeros(2)
ROWS = 2000  # of a recording


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_effects_that_are_parallel_are_distinguished_by_a_recording_in_which_they_are_orthogonal(size):
    parallel = Evidence(PAIR, NOTHING, FIRST * np.ones((2, 2)), NOTHING, 0.0)
    options, x = candidates(PAIR), size * REACH

    def apart(more: np.ndarray | None) -> float:
        return isolability(parallel, options, size, more).apart((0, 1))

    def known(g: float, h: float) -> float:
        """Of two that share g of their information g + h, one of size x and the other absent."""
        return 0.5 * REACH**2 * x**2 * ((g + h) ** 2 - g**2) / (1.0 + REACH**2 * (g + h))

    assert apart(None) == pytest.approx(0.0, abs=1e-6)
    assert apart(FIRST * np.ones((2, 2))) == pytest.approx(0.0, abs=1e-6)  # more of the same does not help
    assert apart(MORE * np.eye(2)) == pytest.approx(known(FIRST, MORE), rel=1e-4)
    assert apart(2.0 * MORE * np.eye(2)) == pytest.approx(known(FIRST, 2.0 * MORE), rel=1e-4)


def test_the_best_candidate_comes_first():
    parallel = Evidence(PAIR, NOTHING, FIRST * np.ones((2, 2)), NOTHING, 0.0)
    options = candidates(PAIR)
    informations = {"again": FIRST * np.ones((2, 2)), "other": 9.0 * np.eye(2), "nothing": np.zeros((2, 2))}
    found = [
        Another(name, False, 20.0, isolability(parallel, options, 1.0, more)) for name, more in informations.items()
    ]
    pairs = isolability(parallel, options, 1.0).pairs
    assert pairs == [(0, 1)]
    assert [(each.name, each.distinguished(pairs)) for each in best_first(found, pairs)][0] == ("other", 1)
    assert [each.distinguished(pairs) for each in found] == [0, 1, 0]


def case(times: int) -> Case:
    """A recording of four strides, or of several times these: one law has phases, the other is one phase in all."""
    rng, rows = np.random.default_rng(3), ROWS
    columns = {key: rng.standard_normal((rows, 3)) for key in ("walks", "stands")}
    stride = np.linspace(0.0, 4.0, rows, endpoint=False)
    columns["walks"] += np.sin(2.0 * np.pi * stride)[:, None]
    columns["stands"] += 0.5
    columns["stands"][:3] = 0.0  # the first values of a phase are weighed otherwise
    known = [*PAIR, made_up("", 0.5, 0.5, own=True)]
    long = {key: np.tile(value, (times, 1)) for key, value in columns.items()}
    pieces = {"walks": np.arange(0, times * rows, rows // 8), "stands": np.array([0])}
    strides = {"walks": np.concatenate([stride + 4.0 * k for k in range(times)])}
    residuals = {key: np.zeros(times * rows) for key in columns}
    problem = Problem(known, residuals, long, pieces, dict.fromkeys(columns, np.arange(times * rows)), {}, strides)
    white = np.array([0.7, 0.0, 0.0, 0.0])
    noise = {"walks": Noise(white, 0.4, 0.6), "stands": Noise(white, 0.02)}
    where: Any = SimpleNamespace(complete=np.ones(times * rows, dtype=bool))
    nothing: Any = None
    evidence = weighed(problem, np.zeros(3), noise)
    return Case(nothing, where, nothing, problem, evidence, noise, nothing)


def test_a_longer_recording_says_what_one_that_goes_on_would():
    once, known = case(1), case(1).problem.unknowns
    assert length_of([once]) == pytest.approx(ROWS / TICKS)
    for times in (1, 2, 5):
        assert like([once], known, times * ROWS / TICKS) == pytest.approx(case(times).evidence.shared().gram, rel=1e-2)
    short = like([once], known, ROWS / TICKS)
    assert (np.diag(like([once], known, 10 * ROWS / TICKS)) < 10.0 * np.diag(short) + 1e-9).all()  # it repeats itself
    parts = like([once, once], known, 2 * ROWS / TICKS)  # of one recording, which has one zero
    assert np.diag(parts)[:2] == pytest.approx(2.0 * np.diag(once.evidence.gram)[:2], rel=0.2)


def test_parameters_that_a_recording_does_not_have_gain_nothing():
    once = case(1)
    more = [PAIR[0], made_up("payload", 0.0, 1.0), PAIR[1], once.problem.unknowns[2]]
    found = like([once], more)
    small = like([once], once.problem.unknowns)
    assert found[np.ix_([0, 2, 3], [0, 2, 3])] == pytest.approx(small) and not found[1].any() and not found[:, 1].any()


def test_a_candidate_says_nothing_of_streams_that_it_or_the_others_lack():
    recording, world = standing()
    prepared = recording, world, masks(recording, world)
    known = unknowns(recording, world)
    full = {each.name for each in examined(prepared, prepared, known, None).problem.unknowns}
    without = recording.changed(motor_q=None)
    less = examined((without, world, masks(without, world)), prepared, known, None)
    assert {each.name for each in less.problem.unknowns} < full
    assert not any(each.effect == "transport_delay" for each in less.problem.unknowns)
    at_hand = without, world, masks(without, world)
    found = examined(prepared, at_hand, unknowns(without, world), None)
    assert found.recording.motor_q is None
    assert like([found], known).shape == (len(known), len(known))


def test_a_delay_and_a_lag_differ_by_their_size():
    """Of motors that move as sines, what both do is known, and about nominal it is the same."""
    recording, world = standing()
    where = masks(recording, world)
    known = [each for each in unknowns(recording, world) if each.effect in ("transport_delay", "motor_lag")]
    assert {each.effect for each in known} <= CLOCKS and [each.where for each in known] == ["", ""]
    nominal = examine((recording, world, where), known, np.zeros(2))
    key = "spring/LKneeSag|any"
    j = world.robot.joint_names.index("LKneeSag")
    w, s = 2.0 * np.pi * (0.3 + 0.02 * j), 5.0 * known[0].reach
    assert known[1].reach == known[0].reach and nominal.problem.columns[key][:, 0] == pytest.approx(
        nominal.problem.columns[key][:, 1], rel=0.1, abs=0.02
    )

    def amplitude(found: Case, i: int) -> float:
        ticks = found.problem.times[key]
        at = t[where.ticks[ticks]]
        late = at > 1.5  # a filter has forgotten where it began
        waves = np.column_stack([np.sin(w * at), np.cos(w * at), np.ones(len(at))])[late]
        (a, b, _), *_ = np.linalg.lstsq(waves, found.problem.columns[key][late, i], rcond=None)
        return float(np.hypot(a, b))

    (found,) = at_share([nominal], 5.0)
    index = {each.effect: i for i, each in enumerate(known)}
    delay, lag = amplitude(found, index["transport_delay"]), amplitude(found, index["motor_lag"])
    assert delay / lag == pytest.approx(np.sin(0.5 * w * s) / (0.5 * w * s) * np.sqrt(1.0 + (w * s) ** 2), rel=2e-3)
    option = next(each for each in candidates(known) if each.effect == "motor_lag")
    (same,) = at_values([nominal], option, np.array([s, s]))
    assert same.problem.columns[key] == pytest.approx(found.problem.columns[key])
    other = next(each for each in candidates(unknowns(recording, world)) if each.effect == "payload")
    assert at_values([found], other, np.zeros(99)) == [found]
