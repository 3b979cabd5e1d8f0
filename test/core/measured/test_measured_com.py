# SPDX-License-Identifier: BSD-3-Clause
"""The measured COM of recorded walks with default noise, against what the simulator knows."""

from pathlib import Path

import numpy as np
import pytest

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.resources import bag_path
from coman_reduced_model.sim.record import load_truth

DATA = Path(__file__).parents[2] / "data"
NAMES = {Foot.LEFT: "T_left", Foot.RIGHT: "T_right"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["test1", "test2"])
def test_encoders_cost_little_and_the_flat_sole_half_a_millimetre_at_most(name):
    truth, config = load_truth(DATA / f"{name}.truth.npz"), Config.replaced(Config(), {"prediction.horizons": ()})
    tilted, level = [], []
    with Session(bag_path(name), config) as session:
        for prediction in session.predictions():
            i = int(np.abs(truth["stamp_ns"] - prediction.stamp_ns).argmin())
            if prediction.support.support_foot == Foot.NONE or abs(truth["stamp_ns"][i] - prediction.stamp_ns) > 1e6:
                continue
            T = truth[NAMES[prediction.support.support_foot]][i]
            true = truth["com"][i] - T[:3, 3]
            heading = np.array([T[0, 0], T[1, 0], 0.0]) / np.hypot(T[0, 0], T[1, 0])
            side = np.array([-heading[1], heading[0], 0.0])
            tilted.append(prediction.measured_com - T[:3, :3].T @ true)
            level.append(prediction.measured_com - [heading @ true, side @ true, true[2]])
    assert len(tilted) > 0.95 * session.pipeline.samples
    assert rms(tilted) == pytest.approx([0.00015, 0.00013, 0.00005], rel=0.15)  # in the sole as it stands: promised 0.4
    assert np.all(rms(level) < [0.0002, 0.0005, 0.0001])  # in a sole taken as flat: loading and unloading, feet roll


def rms(errors):
    return np.sqrt(np.mean(np.square(errors), axis=0))
