# SPDX-License-Identifier: BSD-3-Clause
"""Runs of the judge that are killed go on to the same score, and a case that cannot be recorded ends none."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from coman_reduced_model.errors import ConfigError, OutputError
from coman_reduced_model.judge import run as judge
from coman_reduced_model.judge.cases import draw_case
from coman_reduced_model.judge.folder import RunFolder, stored
from coman_reduced_model.judge.prediction import run_predictions, score_predictions
from coman_reduced_model.judge.score import score_run

# Its verdict goes by the bytes of a bag.
TOOL = """
import json, sys, zlib
from pathlib import Path
a = sys.argv[1:]
out, (bag,) = Path(a[a.index("--out") + 1]), Path(a[0]).glob("*.mcap")
out.mkdir()
verdict = ("none", "unknown")[zlib.crc32(bag.read_bytes()) % 2]
(out / "diagnosis.json").write_text(json.dumps({"verdict": verdict, "effects": [], "gap": {}}))
"""
WORLD = ("mujoco", "short", "level", "legs")
KNOWN = ("kind", "named", "result", "seed", "truth", "attempt", "levels", "worlds")


@pytest.fixture
def tool(tmp_path) -> Path:
    path = tmp_path / "tool.py"
    path.write_text(TOOL)
    return path


def begin(out: Path, tool: Path) -> subprocess.Popen[bytes]:
    """A run of two clean cases and one with a hidden effect, as a process group of its own."""
    command = [sys.executable, "-m", "coman_reduced_model.cli.main", "judge", "--out", str(out), "--seeds", "11:15"]
    options = [part for kind in WORLD for part in ("--world", kind)]
    options += ["--only", "clean,single", "--jobs", "2", "--no-oracle", "--no-baselines"]
    return subprocess.Popen([*command, *options, "--workflow", f"{sys.executable} {tool}"], start_new_session=True)


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on_to_the_same_score(tmp_path, tool):
    straight, broken = tmp_path / "straight", tmp_path / "broken"
    assert begin(straight, tool).wait(500) == 0
    for sign in ("bags/.*/*/*.mcap", "verdicts/*/run.json"):  # in the middle of a recording; some have a verdict
        process = begin(broken, tool)
        while process.poll() is None and not list(broken.glob(sign)):
            time.sleep(0.01)
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert begin(broken, tool).wait(500) == 0
    scores = [stored(out / "score.json") for out in (straight, broken)]
    assert scores[0]["cases"] == {"clean": 2, "single": 1}
    assert scores[0]["workflow"] == scores[1]["workflow"] and scores[0]["by_kind"] == scores[1]["by_kind"]
    rows = [[{key: row[key] for key in KNOWN} for row in score["rows"]] for score in scores]
    assert rows[0] == rows[1]
    bags = [{path.name: path.read_bytes() for path in out.glob("bags/[!.]*/*/*.mcap")} for out in (straight, broken)]
    assert bags[0] == bags[1] and len(bags[0]) == 3


def test_files_that_were_left_unfinished_are_made_again(tmp_path, tool, monkeypatch):
    made = []

    def record(seed, folder, force=False, **fixed):
        case = draw_case(seed)
        made.append(seed)
        for bag in ("train", "hold1", "hold2"):
            (folder / case.name / bag).mkdir(parents=True, exist_ok=True)
            (folder / case.name / bag / "a.mcap").write_bytes(bytes([seed]))
        (folder / case.name / "robot.yaml").write_text("")
        return case, judge.answer(case)

    monkeypatch.setattr(judge, "write_seed", record)
    folder, case, nothing = RunFolder(tmp_path / "run"), draw_case(3), (sys.executable, "-c", "print('{}')")
    task, verdict = (folder, 3, (sys.executable, str(tool)), nothing, {}), folder.verdict(case.name)
    judge._judge_case(*task)  # noqa: SLF001
    said = stored(verdict / "diagnosis.json")
    for path in (folder.answer(case.name), verdict / "run.json", verdict / "baselines.json"):
        whole = stored(path)
        for broken in (path, verdict / "run.json", verdict / "diagnosis.json"):
            broken.write_text(broken.read_text()[:1])
        judge._judge_case(*task)  # noqa: SLF001
        assert set(stored(path)) == set(whole) and stored(verdict / "diagnosis.json") == said
    assert made == [3, 3]
    folder.seeds.write_text("[1, 2")
    with pytest.raises(ConfigError, match="seeds.json: cannot be read: give the seeds of this run by --seeds"):
        judge.choose_seeds("", folder.out)


def test_a_case_that_cannot_be_recorded_has_no_verdict_and_the_run_goes_on(tmp_path, tool, monkeypatch):
    def fails(*_, **__):
        raise ValueError("no contact\nat all")

    monkeypatch.setattr(judge, "write_seed", fails)
    seeds, command = [0, 1, 3], (sys.executable, str(tool))
    names = judge.run(tmp_path / "run", seeds, command=command, jobs=1)
    result = score_run(tmp_path / "run", names)
    assert result["cases"] == {"clean": 2, "single": 1} and result["workflow"]["failed"]["hits"] == 3
    assert stored(RunFolder(tmp_path / "run").answer(names[0]))["failed"] == "ValueError: no contact at all"
    monkeypatch.setattr(judge, "write_seed", None)  # not tried again
    assert judge.run(tmp_path / "run", seeds, command=command, jobs=1) == names
    clean = run_predictions(tmp_path / "run", seeds)
    assert score_predictions(tmp_path / "run", clean)["all"]["failed"] == 6

    def no_space(*_, **__):
        raise OutputError("no space")

    monkeypatch.setattr(judge, "write_seed", no_space)
    with pytest.raises(OutputError, match="no space"):
        judge.run(tmp_path / "other", seeds, command=command, jobs=1)
