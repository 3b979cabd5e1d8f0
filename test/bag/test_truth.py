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


def test_a_damaged_file_is_read_or_none(tmp_path):
    stamps, pose = np.arange(5) * 10_000_000, np.tile(np.eye(4), (5, 1, 1))
    path = tmp_path / "walk.truth.npz"
    np.savez_compressed(path, stamp_ns=stamps, com=np.full((5, 3), 0.1), T_left=pose, T_right=pose)
    good = path.read_bytes()
    for k in range(0, len(good), 3):
        path.write_bytes(good[:k] + bytes([good[k] ^ 0xFF]) + good[k + 1 :])
        true_motion(tmp_path / "walk")  # and no traceback


def test_a_file_of_other_shapes_is_none(tmp_path):
    np.savez(tmp_path / "walk.truth.npz", stamp_ns=np.arange(5), com=np.zeros((4, 3)), T_left=0, T_right=0)
    assert true_motion(tmp_path / "walk") is None


def test_the_rotation_of_the_trunk_is_to_gravity(tmp_path):
    """The floor slopes by 0.1 rad, the trunk stands upright on it; x of the level frame is above that of the sole."""
    stamps, pose = np.arange(5) * 10_000_000, np.tile(np.eye(4), (5, 1, 1))
    arrays = {"stamp_ns": stamps, "com": np.zeros((5, 3)), "T_left": pose, "T_right": pose}
    arrays["base_orientation"] = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)).astype(np.float32)
    gravity = 9.81 * np.array([np.sin(0.1), 0.0, -np.cos(0.1)])  # downhill ahead
    np.savez(tmp_path / "sloping.truth.npz", **arrays, gravity=gravity)
    np.savez(tmp_path / "before.truth.npz", **arrays)
    for name, pitch in (("sloping", 0.1), ("before", 0.0)):  # files of earlier versions are of level ground
        motion = true_motion(tmp_path / name)
        assert motion is not None and motion.rotation is not None
        R, rate = motion.rotation.at(0.02, Foot.LEFT)
        assert np.arctan2(-R[2, 0], R[2, 2]) == pytest.approx(pitch, abs=1e-6)
        assert rate == pytest.approx(np.zeros(3))
