# SPDX-License-Identifier: BSD-3-Clause
"""What the monitor has found stays, whatever else happens to the streams."""

from __future__ import annotations

from dataclasses import replace

import pytest
from monitor_tools import BEGINS, FEET, LEVEL, detected_in_time, watched


@pytest.mark.slow
@pytest.mark.parametrize("imu", [lambda t: None, lambda t: LEVEL], ids=["soles", "imu"])
def test_an_external_force_is_reported_after_a_short_gap_too(imu):
    def change(stream, t, message):
        if 12.0 < t < 12.4:
            return None
        if stream not in FEET.values() or t < BEGINS:
            return message
        return replace(message, force=message.force + [0.0, 0.06 * max(message.force[2], 0.0), 0.0])

    assert "force/y" in {each.channel for each in watched(change, 16.4, imu=imu).mismatches}


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.08, 1.15, 0.8])
def test_gains_that_change_in_mid_walk_are_no_zeros(scale):
    """Feet in the air read nothing: whatever the total is, no zero explains it, and it is not learnt as one."""

    def change(stream, t, message):
        scaled = stream in FEET.values() and t >= BEGINS
        return replace(message, force=scale * message.force, torque=scale * message.torque) if scaled else message

    monitor = watched(change, 16.0, imu=lambda t: LEVEL)
    detected_in_time(monitor.first.values(), "force/z")
    assert "force/z" in {each.channel for each in monitor.mismatches}
