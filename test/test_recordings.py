# SPDX-License-Identifier: BSD-3-Clause
"""Tests that need recordings of other robots say that they were skipped without them."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest
from conftest import ROOT, child_environment

TESTS = """
import pytest
from conftest import recording

@pytest.mark.parametrize("name", ["real/walk", "other_robot/walk"])
def test_on_a_recording(name):
    recording(name)

def test_skipped_for_another_reason():
    pytest.skip("another reason")

def test_without_a_recording():
    pass
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("present", "processes", "line"),
    [([], ["-n", "2"], "2 tests"), (["real/walk"], [], "1 test"), (["real/walk", "other_robot/walk"], [], "")],
)
def test_one_line_at_the_end_says_how_many_tests_had_no_recording(tmp_path, present, processes, line):
    folder = tmp_path / "project" / "test"
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "test" / "conftest.py", folder)
    (folder / "test_it.py").write_text(TESTS)
    for name in present:
        (tmp_path / "shared" / name).mkdir(parents=True)
    environment = child_environment(PYTHONPATH=str(ROOT / "test"))  # for the plugins of conftest.py
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-ra", *processes, str(folder)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    said = [text for text in done.stdout.splitlines() if "not beside the project" in text and "SKIPPED" not in text]
    expected = [f"{line} skipped: the recordings of other robots are not beside the project"] if line else []
    assert said == expected
    assert not line or done.stdout.splitlines()[-2] == expected[0]
