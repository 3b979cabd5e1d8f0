# SPDX-License-Identifier: BSD-3-Clause
"""The statistics behind a diagnosis, against what they abbreviate: normal distributions written out in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_tools import FIGURES
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, toeplitz
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.diagnose.data.strides import repeating
from coman_reduced_model.diagnose.inference.evidence import Evidence, Problem, scores, weigh
from coman_reduced_model.diagnose.inference.floor import least
from coman_reduced_model.diagnose.inference.noise import (
    ORDER,
    Noise,
    free_of_offsets,
    free_of_repeats,
    independent,
    mean_offset,
    repeated,
    whiten,
    yule_walker,
)
from coman_reduced_model.diagnose.inference.prior import prior_variance
from coman_reduced_model.diagnose.physics.hypotheses import Candidate, candidates

ROWS = 40
seeds = st.integers(0, 10_000)
few = settings(max_examples=15)


def evidence_of(A, r, at=None, known=FIGURES) -> Evidence:
    at = np.zeros(A.shape[1]) if at is None else at
    return Evidence(known, at, A.T @ A, A.T @ r, float(r @ r))


def log_normal(r, mean, covariance) -> float:
    """But for the constant that the package leaves out."""
    return multivariate_normal(mean, covariance).logpdf(r) + 0.5 * len(r) * np.log(2.0 * np.pi)


@few
@given(seeds)
def test_posterior_and_log_evidence_are_those_of_the_normal_distribution(seed):
    rng = np.random.default_rng(seed)
    A, r = rng.normal(size=(ROWS, 4)), 2.0 * rng.normal(size=ROWS)
    at, mean, variance = rng.normal(size=4), rng.normal(size=4), rng.uniform(0.1, 3.0, 4)
    fit = evidence_of(A, r, at).posterior(mean, variance)
    C = np.eye(ROWS) + A * variance @ A.T
    gain = (variance[:, None] * A.T) @ np.linalg.inv(C)
    assert fit.x == pytest.approx(mean + gain @ (r - A @ (mean - at)), abs=1e-6)
    assert fit.covariance == pytest.approx(np.diag(variance) - gain @ A * variance, abs=1e-6)
    assert fit.log == pytest.approx(log_normal(r, A @ (mean - at), C), abs=1e-4)


@few
@given(seeds)
def test_a_figure_that_one_recording_has_to_itself_is_integrated_out(seed):
    rng = np.random.default_rng(seed)
    parts = [(rng.normal(size=(ROWS, 4)), 2.0 * rng.normal(size=ROWS)) for _ in range(2)]
    fit = (evidence_of(*parts[0]).shared() + evidence_of(*parts[1]).shared()).fit([0])
    # The joint model: three unknowns in common, and the fourth twice.
    A = np.hstack([np.vstack([a[:, :3] for a, _ in parts]), block_diag(*(a[:, 3:] for a, _ in parts))])
    r, variance = np.concatenate([r for _, r in parts]), prior_variance(FIGURES, [0])[[0, 1, 2, 3, 3]]
    C = np.eye(len(r)) + A * variance @ A.T
    x = (variance[:, None] * A.T) @ np.linalg.solve(C, r)
    assert fit.x[:3] == pytest.approx(x[:3], abs=1e-6)
    assert fit.log == pytest.approx(log_normal(r, np.zeros(len(r)), C), abs=1e-4)


@few
@given(seeds)
def test_scores_are_what_a_new_fit_with_wider_priors_gains(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(ROWS, 4))
    evidence = evidence_of(A, A @ rng.normal(size=4) + rng.normal(size=ROWS))
    for score in scores(evidence, [*candidates(FIGURES), Candidate("both", "", (0, 2))], released=[1]):
        mine = [1, *score.option.unknowns]
        wide = evidence.fit(mine)
        assert score.gain == pytest.approx(wide.log - evidence.fit([1]).log, abs=1e-3)
        assert score.values == pytest.approx(wide.x[list(score.option.unknowns)], abs=1e-4)


def test_evidence_speaks_for_what_is_there_and_against_what_is_not():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(400, 4))
    r = A @ np.array([0.8, 0.2, 0.0, 0.3]) + rng.normal(size=400)
    found = {score.option.effect: score for score in scores(evidence_of(A, r), candidates(FIGURES))}
    assert found["payload"].gain > 50.0 and found["payload"].values == pytest.approx([0.8], abs=0.15)
    assert found["encoder_bias"].gain < 0.0 > found["backlash"].gain  # the one within its spread, the other absent


AR = np.array([0.5, 1.2, -0.6, 0.1])  # standard deviation and coefficients, stable


def coloured(n: int, pieces: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of an AR process, each in its steady state, and where they begin."""
    each = [lfilter([AR[0]], [1.0, *-AR[1:]], rng.normal(size=n + 200))[200:] for _ in range(pieces)]
    return np.concatenate(each), n * np.arange(pieces)


def test_whitening_makes_an_autoregressive_process_white():
    values, pieces = coloured(400, 10, np.random.default_rng(2))
    white = whiten(values[:, None], pieces, AR)[0][:, 0]
    inside = np.concatenate([white[a + ORDER : a + 400] for a in pieces])
    assert inside.std() == pytest.approx(1.0, abs=0.04)
    for lag in (1, 2, 3, 5):
        assert abs(np.corrcoef(inside[lag:], inside[:-lag])[0, 1]) < 0.06


@few
@given(seeds, st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_independent_rows_are_those_of_the_covariance_of_the_noise_written_out(seed, offset, repeats):
    rng = np.random.default_rng(seed)
    lengths, stride = (1, 2, 9, 28), np.arange(ROWS) / 13.0
    pieces, noise = np.array([0, 1, 3, 12]), Noise(AR, offset, repeats)
    innovations = lfilter([AR[0]], [1.0, *-AR[1:]], np.eye(1, 2000)[0])  # the response to one
    covariance = np.correlate(innovations, innovations, "full")[len(innovations) - 1 :]
    C = block_diag(*(toeplitz(covariance[:n]) + offset**2 for n in lengths))
    waves = repeating(stride)
    C += repeats**2 / waves.shape[1] * waves @ waves.T
    rows = rng.normal(size=(ROWS, 2))
    white, log = independent(rows, stride, pieces, noise)
    assert white.T @ white == pytest.approx(rows.T @ np.linalg.solve(C, rows), rel=1e-5)
    assert log == pytest.approx(np.linalg.slogdet(C)[1], abs=1e-6)


def test_single_values_have_no_offset_beside_their_noise():
    assert mean_offset(np.arange(5.0), np.arange(5)) == 0.0
    assert mean_offset(np.repeat([1.0, -1.0, 1.0], 4), np.array([0, 4, 8])) == pytest.approx(1.0)


def test_the_noise_is_estimated_over_pieces_that_do_not_touch():
    values, pieces = coloured(500, 12, np.random.default_rng(3))
    values[pieces[6] :] *= -1.0
    assert yule_walker(values, pieces) == pytest.approx(AR, abs=0.08)


@few
@given(seeds, st.floats(0.0, 5.0))
def test_offsets_of_pieces_are_part_of_the_noise(seed, offset):
    rng = np.random.default_rng(seed)
    pieces, noise = np.array([0, 9, 30]), np.array([0.7, 0.4, 0.0, 0.0])
    white = rng.normal(size=(ROWS, 2))
    out, _ = free_of_offsets(white, pieces, Noise(noise, offset))
    one = whiten(np.ones((ROWS, 1)), pieces, noise)[0][:, 0]
    C = np.eye(ROWS)
    for a, b in ((0, 9), (9, 30), (30, ROWS)):
        C[a:b, a:b] += offset**2 * np.outer(one[a:b], one[a:b])
    assert out.T @ out == pytest.approx(white.T @ np.linalg.solve(C, white), abs=1e-8)


@few
@given(seeds, st.floats(0.1, 5.0))
def test_what_repeats_with_each_stride_is_part_of_the_noise(seed, repeats):
    rng = np.random.default_rng(seed)
    pieces, noise, stride = np.array([0]), np.array([0.7, 0.4, 0.0, 0.0]), np.arange(ROWS) / 13.0
    white = rng.normal(size=(ROWS, 2))
    out, _ = free_of_repeats(white, stride, pieces, Noise(noise, 0.0, repeats))
    waves, _ = whiten(repeating(stride), pieces, noise)
    C = np.eye(ROWS) + repeats**2 / waves.shape[1] * waves @ waves.T
    assert out.T @ out == pytest.approx(white.T @ np.linalg.solve(C, white), abs=1e-6)


def test_strides_without_end_say_no_more_than_one_where_the_model_is_off_in_each():
    """An effect that has the form of what repeats is known no better than that, however long the robot walks."""
    noise, information = np.array([1.0, 0.0, 0.0, 0.0]), []
    for strides in (10, 1000):
        stride = np.arange(25 * strides) / 25.0
        column = np.cos(2.0 * np.pi * stride)[:, None]
        white, _ = free_of_repeats(column, stride, np.array([0]), Noise(noise, 0.0, 1.0))
        information.append(float((white.T @ white)[0, 0]))
    assert information[1] == pytest.approx(information[0], rel=0.1)


def test_what_repeats_is_told_from_noise_that_does_not():
    rng, stride = np.random.default_rng(5), np.arange(500) / 25.0
    noise = rng.normal(size=len(stride))
    assert repeated(noise, stride) < 0.3
    assert repeated(noise + 2.0 * np.sin(2.0 * np.pi * stride), stride) == pytest.approx(np.sqrt(2.0), abs=0.3)
    assert repeated(noise, np.full(len(stride), np.nan)) == 0.0  # it stands


def problem(values, pieces) -> Problem:
    n = len(values)
    columns = np.random.default_rng(0).normal(size=(n, 4))
    return Problem(FIGURES, {"a|single": values}, {"a|single": columns}, {"a|single": pieces}, {}, {})


def test_short_pieces_have_a_noise_too():
    """Double support may last two ticks only: then there are no second differences within a piece."""
    values = np.random.default_rng(4).normal(size=60)
    evidence, noise = weigh(problem(values, np.arange(0, 60, 2)), np.zeros(4))
    assert np.isfinite(evidence.gram).all() and np.isfinite(evidence.energy)
    assert noise["a|single"].autoregression[0] == pytest.approx(1.0, abs=0.5)


def test_a_channel_that_never_moves_breaks_nothing():
    """A driver that writes zeros for a foot in the air."""
    evidence, _ = weigh(problem(np.zeros(60), np.array([0])), np.zeros(4))
    assert np.isfinite(evidence.fit([0]).log)


def test_a_prior_never_gets_narrower_when_a_figure_is_released():
    known = [replace(FIGURES[1], spread=2.0), *FIGURES[:1]]
    assert (prior_variance(known, [0, 1]) >= prior_variance(known)).all()


def test_no_sensor_is_believed_to_be_without_noise():
    floors = load_nominal().floor
    assert least("unloaded/left/fz|single", floors) == least("unloaded/right/fx", floors) == floors["unloaded/f"] > 0.0
    assert least("unloaded/left/ty|single", floors) == floors["unloaded"] < floors["unloaded/f"]
    assert least("force/x|double", floors) == floors["force"] > 0.0 and least("what|single", floors) == 0.0
