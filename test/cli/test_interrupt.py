# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C in `coman diagnose`, which has a second process, leaves no traceback and no process."""

from __future__ import annotations

import os
import time

import pytest

from coman_reduced_model.resources import bag_path


@pytest.mark.parametrize("after", [0.0, 1.5])
def test_ctrl_c_ends_a_diagnosis_in_silence(tmp_path, start, after):
    """The second process is at work; a terminal sends it to both."""
    process = start("coman", "diagnose", bag_path("stand"), "--out", tmp_path / "out")
    process.wait_for("diagnosing:")  # comes with the progress, after two seconds of work
    time.sleep(after)
    process.interrupt(times=2)
    assert process.wait() == 130, process.output
    assert "Traceback" not in process.output and "Exception ignored" not in process.output, process.output
    assert not (tmp_path / "out").exists() and not [*tmp_path.glob(".out.*")]
    with pytest.raises(ProcessLookupError):  # nothing of its group goes on
        for _ in range(100):
            os.killpg(process.pid, 0)
            time.sleep(0.1)
