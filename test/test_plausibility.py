# SPDX-License-Identifier: BSD-3-Clause
"""Faults of wiring and zeros of sensors that no single message shows, on a synthetic walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import LEFT, RIGHT, robot, walk

from coman_reduced_model.core.config import Config
from coman_reduced_model.core.pipeline import Pipeline


def warnings_of(change):
    pipeline = Pipeline(robot(), Config())
    for stream, message in walk(6.0):
        stream, message = change(stream, message)
        pipeline.feed(stream, message, lambda message: message)
    pipeline.flush()
    return pipeline.status().warnings


def test_wrong_sign_is_told():
    def flipped(stream, message):
        return (stream, replace(message, force=-message.force)) if stream == LEFT else (stream, message)

    assert warnings_of(lambda *item: item) == ()
    (line,) = warnings_of(flipped)
    assert line.startswith(LEFT) and "sign" in line


def test_swapped_feet_are_told():
    def swapped(stream, message):
        if stream in (LEFT, RIGHT):
            stream, frame = (RIGHT, "r_sole") if stream == LEFT else (LEFT, "l_sole")
            message = replace(message, frame_id=frame)
        return stream, message

    (line,) = warnings_of(swapped)
    assert "swapped" in line


@pytest.mark.parametrize("share", [0.03, 0.06, 0.2])
def test_a_foot_in_the_air_that_never_reads_unloaded_is_told(share):
    """Above contact_off, 4 % of the weight, its lift-offs are missed and the robot seems to stand on both feet."""

    def biased(stream, message):
        if stream == RIGHT:
            message = replace(message, force=message.force + np.array([0.0, 0.0, share * robot().mass * 9.81]))
        return stream, message

    lines = warnings_of(biased)
    assert len(lines) == (share > 0.04)
    assert all(line.startswith(RIGHT) and "lift-offs are missed" in line for line in lines)
