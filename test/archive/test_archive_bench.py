# SPDX-License-Identifier: BSD-3-Clause
"""What the page of the archive computes from what was measured."""

from __future__ import annotations

import importlib

import pytest
from conftest import ROOT


def test_many_bags_cost_their_diagnoses_too(monkeypatch):
    """500 bags of 0.72 s and 100 diagnoses of 3.6 s: of 100,000 bags, 20 and 20 core hours; 2.4 minutes of 1024."""
    monkeypatch.syspath_prepend(ROOT / "bench")
    bench = importlib.import_module("archive")
    everything = bench.Cost(wall=360.0, processor=720.0, result={"bags": {"ok": 490, "bad": 10}, "diagnoses": 100})
    assert bench.of_a_diagnosis(everything, 0.72) == pytest.approx(3.6)
    text = bench.arithmetic(0.72, everything, 0.002, 0.98)
    assert "3.6 s for a diagnosis" in text and "20,000 diagnoses" in text
    assert "20 core hours for predictions and 20 for diagnoses, 2.4 minutes of all nodes" in text
    assert "by processes of this machine, without Ray" in text
