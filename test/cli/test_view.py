# SPDX-License-Identifier: BSD-3-Clause
"""`coman view`: what the file for the viewer holds, and what is said where there is no viewer."""

from __future__ import annotations

import importlib.util
import json
import sys

import pytest
from synthetic import walk, write_bag

from coman_reduced_model.cli.main import run

THERE = importlib.util.find_spec("rerun") is not None


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "walk", walk(2.0))


@pytest.mark.skipif(not THERE, reason="rerun-sdk is optional")
def test_robot_com_soles_predictions_ahead_and_residuals_are_in_the_file(bag, tmp_path, capsys):
    out = tmp_path / "walk.rrd"
    assert run(["view", str(bag), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"samples": 400, "file": str(out)}
    from rerun.experimental import RrdReader

    paths = {str(chunk.entity_path).lstrip("/") for chunk in RrdReader(out).stream()}
    assert {"com/measured", "com/predicted", "com/horizon", "trail/measured", "trail/predicted"} <= paths
    assert {"soles/left", "soles/right", "residual", "rigid", "left_share", "tf/base_link", "tf/l_foot"} <= paths
    assert any(path.startswith("robot/") for path in paths)
    before = out.read_bytes()
    assert run(["view", str(bag), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err and out.read_bytes() == before


def test_without_the_viewer_one_line_says_how_to_install_it(bag, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)  # as if it were not installed
    assert run(["view", str(bag), "--out", str(tmp_path / "walk.rrd")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert 'pip install "rerun-sdk' in line and not (tmp_path / "walk.rrd").exists()
