# SPDX-License-Identifier: BSD-3-Clause
"""Effects that remember what was: points of the plan to come do not move what the free run knows of now."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from coman_reduced_model import Predictor, Session, bag_path, load_config
from coman_reduced_model.core.effects.base import EffectConfig


@pytest.mark.slow
def test_planned_steps_do_not_move_the_slips_of_the_free_run():
    """The free run knows motors and phases alone: that the plan says how feet will step must not change it."""
    lost = tuple(
        EffectConfig("hysteresis", knee, {"width": 0.02, "friction": 0.5}) for knee in ("LKneeSag", "RKneeSag")
    )
    config = replace(load_config(), effects=lost)
    with Session(bag_path("test1")) as session:
        robot, samples = session.robot, list(islice(session.samples(), 700))
    assert samples[-1].reference.steps is not None
    found = []
    for steps in (True, False):
        predictor = Predictor(robot, config)
        for sample in samples:
            reference = sample.reference if steps else replace(sample.reference, steps=None)
            prediction = predictor.update(replace(sample, q=sample.q.copy(), reference=reference))
        found.append(prediction.predicted_com)
    np.testing.assert_array_equal(*found)
    predictor.reset()  # as after a gap
    again = Predictor(robot, config)
    for sample in samples[:300]:
        both = [each.update(replace(sample, q=sample.q.copy())) for each in (predictor, again)]
    np.testing.assert_array_equal(*(each.predicted_com for each in both))
