# SPDX-License-Identifier: BSD-3-Clause
"""Simpler methods, which the workflow is compared with."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import ROOT

from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.judge import baselines

# --- simpler methods ---


def synthetic(effect: float) -> baselines.Features:
    """Residuals of white noise, and of a payload; features of two effects that have nothing in common."""
    rng = np.random.default_rng(1)
    A = rng.standard_normal((4000, 3))
    terms = (
        baselines.Term("payload", "", ("mass", "x"), np.array([0, 1])),
        baselines.Term("backlash", "LKneeSag", ("width",), np.array([2])),
    )
    y = A[:, :2] @ [effect, -effect] + rng.standard_normal(4000)
    return baselines.Features(y / y.std(), A / y.std(), np.ones(3), terms)


def test_the_naive_criterion_names_what_is_there_and_nothing_in_white_noise():
    verdict = baselines.white_bic(synthetic(0.5))
    assert [(e["name"], e["where"]) for e in verdict["effects"]] == [("payload", "")]
    found = verdict["effects"][0]["parameters"]
    assert (found["mass"]["value"], found["x"]["value"]) == pytest.approx((0.5, -0.5), abs=0.05)
    assert baselines.white_bic(synthetic(0.0))["verdict"] == "none"


def test_sparse_regression_names_what_explains_most():
    pytest.importorskip("pysindy")
    assert baselines.pysindy(synthetic(0.5))["effects"][0]["name"] == "payload"
    assert baselines.pysindy(synthetic(0.0))["verdict"] == "none"


@pytest.mark.slow
def test_the_simpler_methods_read_bags_as_the_workflow_does(capsys):
    baselines.main([str(ROOT / "bags" / "test1"), "--config", str(ROOT / "config" / "coman.yaml")])
    verdicts = json.loads(capsys.readouterr().out)
    # A clean robot, and perfectly nominal: what they name nevertheless is why they are no more than baselines.
    assert verdicts["white_bic"]["verdict"] in ("effect", "none")
    for verdict in verdicts.values():
        assert all(effect["name"] in CATALOGUE for effect in verdict["effects"])
