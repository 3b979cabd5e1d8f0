# SPDX-License-Identifier: BSD-3-Clause
"""Velocities from positions and stamps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coman_reduced_model.core.streams.differentiate import Differentiator

MS, T0 = 1_000_000, 1_700_000_000_000_000_000


@given(st.lists(st.floats(0.0005, 0.03), min_size=5, max_size=60), st.floats(-10.0, 10.0), st.floats(0.002, 0.5))
def test_a_steady_velocity_is_found_exactly_whatever_the_stamps(intervals, speed, window):
    differentiator = Differentiator(window, 0.25, 2)
    stamp = T0
    assert differentiator.update(stamp, np.array([0.0, 3.0])) is None
    for interval in intervals:
        stamp += round(interval * 1e9)
        t = (stamp - T0) * 1e-9
        found = differentiator.update(stamp, np.array([speed * t, 3.0]))
        assert found == pytest.approx([speed, 0.0], abs=1e-6)


def test_differentiation_is_half_a_window_late_and_starts_afresh_after_a_gap():
    differentiator = Differentiator(0.04, 0.25, 1)
    for k in range(2000):
        found = differentiator.update(T0 + k * MS, np.array([0.5 * (k * 1e-3) ** 2]))
    assert found == pytest.approx([1.999 - 0.02], abs=1e-9)
    assert differentiator.update(T0 + 3000 * MS, np.zeros(1)) is None
    assert differentiator.update(T0 + 2990 * MS, np.zeros(1)) is None
