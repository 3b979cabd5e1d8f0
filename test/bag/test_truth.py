# SPDX-License-Identifier: BSD-3-Clause
"""The truth beside a bag."""

import numpy as np
import pytest

from coman_reduced_model.bag.truth import true_motion
from coman_reduced_model.core.base.types import Foot


def test_it_is_read_where_there_is_one(tmp_path):
    stamps = np.arange(5) * 10_000_000
    pose = np.tile(np.eye(4), (5, 1, 1))
    com = np.tile([0.1, 0.2, 0.5], (5, 1))
    np.savez(tmp_path / "walk.truth.npz", stamp_ns=stamps, com=com, T_left=pose, T_right=pose)
    motion = true_motion(tmp_path / "walk")
    assert motion is not None and motion.at(15_000_000, Foot.LEFT)[0] == pytest.approx([0.1, 0.2, 0.5])


@pytest.mark.parametrize("content", [None, b"", b"no archive at all"])
def test_what_is_no_truth_is_none(tmp_path, content):
    if content is not None:
        (tmp_path / "walk.truth.npz").write_bytes(content)
    assert true_motion(tmp_path / "walk") is None


def test_a_file_of_other_shapes_is_none(tmp_path):
    np.savez(tmp_path / "walk.truth.npz", stamp_ns=np.arange(5), com=np.zeros((4, 3)), T_left=0, T_right=0)
    assert true_motion(tmp_path / "walk") is None
