# SPDX-License-Identifier: BSD-3-Clause
"""The bench of start-up: processes as they are, ratios of the same round."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
from conftest import ROOT


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "bench")
    return importlib.import_module("startup")


def test_a_process_is_measured_with_bytecode_whatever_the_environment_says(bench, monkeypatch):
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    wall, cpu = bench.taken(
        [sys.executable, "-c", "import sys, time; time.sleep(0.3); sys.exit(sys.dont_write_bytecode)"]
    )
    assert wall >= 0.3 and 0.0 < cpu < wall


def test_ratios_are_those_of_the_same_round(bench):
    """The second round was twice as slow, for all."""
    bare = np.array([[1.0, 0.5], [2.0, 1.0], [1.0, 0.5]])
    assert bench.rows({"bare": bare, "more": 3.0 * bare}, "bare") == [
        ["bare", "1.00", "0.50", "1.0", "1.0"],
        ["more", "3.00", "1.50", "3.0", "3.0"],
    ]
