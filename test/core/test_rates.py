# SPDX-License-Identifier: BSD-3-Clause
"""A recorded walk at 1 kHz, and what is left of the prediction when every fifth or tenth sample is all there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.sim.record import record
from coman_reduced_model.sim.sensors import SensorOptions

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture(scope="module", params=["exact", "usual"])
def walk(request, tmp_path_factory):
    """Robot, samples at 1 kHz, and whether the sensors are exact."""
    path, config = tmp_path_factory.mktemp("walk") / "bag", Config()
    exact = request.param == "exact"
    sensors = (SensorOptions.exact if exact else SensorOptions)(rate_hz=1000.0)
    record("test1", path, sensors=sensors, duration_s=5.0)
    with Session(path, config) as session:
        return session.robot, list(session.samples()), exact


@pytest.mark.parametrize("every", [0, 1])
@pytest.mark.parametrize("trunk", ["without", "with"])
def test_the_rate_does_not_matter_on_a_recorded_walk(walk, every, trunk):
    """In shares of the deflection. At 100 Hz the kinks of the motors' motion between two samples are lost for good.

    A turning trunk lands on corners of its feet, between two steps of the integration: sooner or later by up to 5 ms.
    """
    robot, samples, exact = walk
    config = Config().replaced(
        {"prediction.reset_every_steps": every, "prediction.horizons": [], "model.trunk_rotation": trunk}
    )

    def run(step):
        predictor = Predictor(robot, config)
        return {each.stamp_ns: predictor.update(replace(each)) for each in samples[::step]}

    fine = run(1)
    limits = (0.1, 0.2) if trunk == "with" else (0.02 if exact else 0.035, 0.06)
    for step, allowed in zip((5, 10), limits, strict=True):
        pairs = [(fine[stamp], p) for stamp, p in run(step).items()]
        same = [(a, b) for a, b in pairs if (a.frame_id, a.support.phase) == (b.frame_id, b.support.phase)]
        assert len(same) > 0.97 * len(pairs)
        error = np.array([b.predicted_com - a.predicted_com for a, b in same])
        deflection = np.array([a.predicted_com - a.reference_com for a, _ in same])
        ratio = np.sqrt(np.nanmean(error**2, axis=0) / np.nanmean(deflection**2, axis=0))
        print(f"{1000 // step} Hz: x {ratio[0]:.4f}, z {ratio[2]:.4f}")
        assert ratio[[0, 2]].max() < allowed
