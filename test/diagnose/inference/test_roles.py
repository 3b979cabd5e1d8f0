# SPDX-License-Identifier: BSD-3-Clause
"""Which recordings effects are fitted to, which help to choose, and which confirms."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose_tools import swaying
from synthetic import robot

from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.diagnose.data.reading import Reading
from coman_reduced_model.diagnose.inference.check import check_recordings


def test_a_walk_that_ends_in_standing_is_parted_by_its_steps():
    recording = swaying(Phase.DOUBLE)
    walks = recording.t < 0.7 * recording.t[-1]
    stepping = np.where(recording.t % 1.0 < 0.5, Phase.LEFT, Phase.RIGHT)
    recording = recording.changed(phase=np.where(walks, stepping, Phase.DOUBLE), up=None)
    checked = check_recordings([Reading(name, recording, robot()) for name in "ab"], 1, Config(), [])
    for part in (checked.train, checked.select):
        ((_, _, where),) = part
        assert (where.steady & ~where.double).sum() > 10


@pytest.mark.parametrize(
    ("train", "hold", "whole", "roles"),
    [
        (["a"], [], False, (["a"], ["a"], ["a"])),  # parts of one recording
        (["a"], ["b"], False, (["a"], ["a"], ["b"])),
        (["a"], ["b", "c"], False, (["a"], ["b"], ["c"])),
        (["a", "b"], ["c"], False, (["a", "b"], ["b"], ["c"])),
        (["a"], [], True, (["a"], [], [])),
        (["a"], ["b"], True, (["a"], [], ["b"])),
    ],
)
def test_each_recording_has_one_role(train, hold, whole, roles):
    readings = [Reading(name, swaying(Phase.LEFT).changed(name=name), robot()) for name in [*train, *hold]]
    checked = check_recordings(readings, len(train), Config(), [], whole)
    found = [[recording.name for recording, _, _ in part] for part in (checked.train, checked.select, checked.confirm)]
    assert tuple(found) == roles
    used = [
        where.steady
        for part in (checked.train, checked.select, checked.confirm)
        for r, _, where in part
        if r.name == "a"
    ]
    assert sum(steady.astype(int) for steady in used).max() == 1  # no moment has two roles
