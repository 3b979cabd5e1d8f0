# SPDX-License-Identifier: BSD-3-Clause
"""What is learnt from cases with known answers, on made-up comparisons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.judge.learn import (
    AXES,
    Example,
    _features,
    interval_factor,
    learn_decision,
    learn_leftover,
    outcome,
    summary,
)
from coman_reduced_model.judge.learn_variability import learn_repeats

NOMINAL = replace(load_nominal(), leftover={"spring|single": (1.0, 0.3)})


def example(kind: str, gain: float, left: float = 1.0, error: float = 0.0) -> Example:
    """A case with a payload, or none, whose evidence is `gain`; its mass is wrong by `error` deviations."""
    effects = [{"name": "payload", "where": "", "parameters": {"mass": 1.0}}] if kind in ("single", "pair") else []
    answer = {"kind": kind, "levels": ["strong"], "effects": effects, "worlds": dict.fromkeys(AXES, "usual")}

    def row(name: str, gain: float) -> dict:
        parameters = {"mass": [0.0, 1.0 + 0.1 * error, 0.1, False]} if name else {}
        leftover = {"spring|single": left}
        return {
            "name": name, "where": "", "gain": gain, "confirmed": gain, "ways": 1, "leftover": leftover,
            "pulled": {}, "parameters": parameters,
        }  # fmt: skip

    return Example(answer, NOMINAL, [row("", 0.0), row("payload", gain)])


@pytest.fixture(scope="module")
def examples():
    rng = np.random.default_rng(0)
    clean = [example("clean", rng.normal(0.0, 2.0), np.exp(0.3 * rng.normal())) for _ in range(30)]
    single = [example("single", rng.uniform(10.0, 60.0)) for _ in range(20)]
    outside = [example("unknown", rng.normal(0.0, 2.0), np.exp(rng.uniform(1.5, 3.0))) for _ in range(10)]
    return [*clean, *single, *outside]


def test_weights_separate_what_the_features_separate(examples):
    weights = learn_decision(examples, selected=True)
    found = [(each, outcome(_features(each), each, weights)) for each in examples]
    assert all(sum(p.values()) == pytest.approx(1.0) for _, p in found)
    said = summary(found)
    assert said["medium, strong: right"] == "20/20" and said["wrong"] == "0/20" and said["outside: none"] == "0/10"
    assert int(said["false alarms"].split("/")[0]) <= 2
    assert all(weights[name] >= 0.0 for name in ("train", "select", "leftover", "pulled"))


def test_without_selecting_recordings_their_evidence_has_no_weight(examples):
    assert learn_decision(examples, selected=False)["select"] == 0.0


def test_what_laws_leave_is_learnt_from_clean_robots_alone(examples):
    median, scatter = learn_leftover(examples)["spring|single"]
    assert median == pytest.approx(1.0, rel=0.25) and 0.15 <= scatter < 0.6


def test_what_repeats_is_the_median_of_clean_robots():
    robots = [{"spring|any": 1e-4, "torque|any": 0.0}, {"spring|any": 2e-4, "torque|any": 0.0}, {"spring|any": 1.0}]
    assert learn_repeats(robots) == {"spring|any": 2e-4}


def test_intervals_become_as_long_as_they_must_be():
    assert interval_factor([]) == 1.0
    exact = [example("single", 30.0, error=0.1) for _ in range(20)]
    assert interval_factor(exact) == 1.0
    rough = [example("single", 30.0, error=float(e)) for e in np.linspace(-6.0, 6.0, 41)]
    assert interval_factor(rough) == pytest.approx(0.95 * 6.0 / 1.96, rel=0.1)
