# SPDX-License-Identifier: BSD-3-Clause
"""Where in its stride a robot is."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.diagnose.data.strides import in_stride, repeating

RATE = 200.0
STRIDE = [Phase.DOUBLE] * 20 + [Phase.LEFT] * 80 + [Phase.DOUBLE] * 20 + [Phase.RIGHT] * 80


def test_strides_are_counted_by_the_landings_of_the_left_foot():
    stride = in_stride(np.array(STRIDE * 5), RATE)
    assert stride[200] == pytest.approx(0.0)  # the first landing of the left foot
    assert stride == pytest.approx((np.arange(1000) - 200) / 200.0)  # also before the first and after the last


def test_a_foot_that_chatters_does_not_land():
    phase = np.array(STRIDE * 5)
    phase[230:234] = Phase.RIGHT
    assert in_stride(phase, RATE) == pytest.approx((np.arange(1000) - 200) / 200.0)


def test_a_robot_that_stands_has_no_strides():
    for phase in (np.full(1000, Phase.DOUBLE), np.array(STRIDE * 2)):
        assert np.isnan(in_stride(phase, RATE)).all()


def test_functions_repeat_and_have_one_size():
    waves = repeating(np.arange(1000) / 100.0)
    assert waves[100:] == pytest.approx(waves[:-100])
    assert np.mean(waves**2, axis=0) == pytest.approx(1.0)
