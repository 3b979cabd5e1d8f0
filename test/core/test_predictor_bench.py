# SPDX-License-Identifier: BSD-3-Clause
"""The bench of an update: what it counts, and what it leaves out."""

from __future__ import annotations

import importlib
import time

import pinocchio as pin
import pytest
from conftest import ROOT

from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.posture import Posture


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "bench")
    return importlib.import_module("predictor")


def test_calls_of_pinocchio_are_those_of_the_run(bench, monkeypatch):
    robot, samples = bench.read_samples(ROOT / "bags/test1")
    config, update, before = Config().replaced({"prediction.horizons": []}), Posture.update, pin.jacobianCenterOfMass
    found, warm = bench.of_pinocchio(robot, config, samples[: bench.WARM + 200]), bench.WARM
    postures = 0

    def counted(self, q, qd):
        nonlocal postures
        postures += 1
        update(self, q, qd)

    predictor = bench.Predictor(robot, config)
    for sample in samples[:warm]:
        predictor.update(sample)
    monkeypatch.setattr(Posture, "update", counted)
    for sample in samples[warm : warm + 200]:
        predictor.update(sample)
    calls, seconds = found["jacobianCenterOfMass"]
    assert calls * 200 == pytest.approx(postures) and calls > 1.0 and 0.0 < seconds < 1e-3
    assert found["updateFramePlacements"][0] == calls and "aba" not in found
    assert pin.jacobianCenterOfMass is before, "nothing is watched any more"


def test_loading_is_no_part_of_an_update(bench, monkeypatch):
    robot, samples = bench.read_samples(ROOT / "bags/test1")
    loaded = []

    class Monitor:
        """Its first update in a process takes long."""

        def __init__(self, *_):
            pass

        def update(self, *_):
            if not loaded:
                loaded.append(time.sleep(0.5))

    monkeypatch.setattr(bench, "Monitor", Monitor)
    assert bench.parts(robot, Config(), samples[:20])["monitor"] < 1e-3
