# SPDX-License-Identifier: BSD-3-Clause
"""Recordings with flaws that loggers and drivers make: what is read of them, and what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import JOINTS, walk, write_bag

from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.diagnose.data.reading import refuse_repeated
from coman_reduced_model.diagnose.data.recording import load
from coman_reduced_model.errors import BagError


def test_of_a_bag_whose_time_goes_back_the_longest_run_is_read(tmp_path):
    once = walk(6.0)
    recording, _ = load(write_bag(tmp_path / "bag", [*walk(3.0), *once]), Config())
    assert recording.t[-1] == pytest.approx(6.0, abs=0.05)
    assert any("time goes back" in line for line in recording.warnings)
    alone, _ = load(write_bag(tmp_path / "alone", once), Config())
    assert np.abs(recording.q - alone.q[: len(recording.q)]).max() < 1e-9


def zeros(stream, message):
    return stream, replace(message, effort=np.zeros_like(message.effort)) if stream == JOINTS else message


def test_efforts_that_a_driver_fills_with_zeros_are_not_measured(tmp_path):
    recording, _ = load(write_bag(tmp_path / "bag", [zeros(*each) for each in walk(6.0)]), Config())
    assert recording.tau is None


def test_joint_states_at_25_hz_are_read(tmp_path):
    recording, _ = load(write_bag(tmp_path / "bag", walk(6.0, rate=25.0)), Config())
    assert recording.valid.mean() > 0.95


def test_a_bag_and_its_file_are_one_bag(tmp_path):
    bag = write_bag(tmp_path / "bag", walk(0.1))
    (file,) = bag.glob("*.mcap")
    with pytest.raises(BagError, match="given twice"):
        refuse_repeated([bag, file])
    refuse_repeated([bag, tmp_path / "other"])
