# SPDX-License-Identifier: BSD-3-Clause
"""A plan over the stance sole, which jumps where the other sole becomes it, behind a lag and later."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.core.base.delays import apart, lagged, shifted

RATE = 200.0


@pytest.mark.parametrize(
    "late", [lambda values: lagged(values, 0.08, RATE), lambda values: shifted(values, -0.06, RATE)]
)
@pytest.mark.parametrize("in_two", [False, True])  # where it changes between two points of the grid
def test_a_plan_is_late_in_one_frame_and_jumps_with_its_sole(late, in_two):
    t = np.arange(0.0, 6.0, 1.0 / RATE)
    com = np.column_stack([0.1 * t, 0.03 * np.sin(3.0 * t)])
    right = (t % 2.0) > 1.0
    sole = np.where(right[:, None], [0.05, -0.145], 0.0)
    if in_two:
        (k,) = np.nonzero(np.diff(right))
        sole[k] = 0.5 * (sole[k] + sole[k + 1])
    values, jumps = apart(com - sole, RATE)
    np.testing.assert_allclose(values + jumps, com - sole, atol=1e-12)
    np.testing.assert_allclose(late(values) + jumps, late(com) - sole, atol=5e-4)


def test_what_does_not_jump_stays_whole():
    values = 0.05 * np.sin(np.arange(400.0)[:, None] / 40.0)
    kept, jumps = apart(values, RATE)
    np.testing.assert_array_equal(kept, values)
    assert not jumps.any()
