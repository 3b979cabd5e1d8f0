# SPDX-License-Identifier: BSD-3-Clause
"""`coman judge --baseline`: every diagnosis gets what is usual for its robot, and nothing of what is hidden."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from coman_reduced_model.errors import OutputError
from coman_reduced_model.judge import run as judge_run
from coman_reduced_model.judge.cases import BAGS, HEALTHY, answer, draw_case, write_healthy
from coman_reduced_model.judge.folder import RunFolder
from coman_reduced_model.judge.run import run
from coman_reduced_model.judge.score import score_run

SEEDS = [1001, 1002]
WORKFLOW = """
import json, sys
from pathlib import Path
a = sys.argv[1:]
out = Path(a[a.index("--out") + 1])
out.mkdir()
usual = Path(a[a.index("--baseline") + 1]).read_text() if "--baseline" in a else ""
(out / "diagnosis.json").write_text(json.dumps({"verdict": "none", "effects": [], "gap": {}, "usual": usual}))
"""
LEARN = """
import sys
from pathlib import Path
a = sys.argv[1:]
bags = [Path(each).name for each in a[: a.index("--config")]]
if "FAILS":
    sys.exit("error: a bag hardly stands")
Path(a[a.index("--out") + 1]).write_text(" ".join(bags))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> RunFolder:
    """A run whose bags exist already, as empty files."""
    monkeypatch.setattr(judge_run, "RANK", (sys.executable, "-c", "import sys; sys.exit('no ranking')"))  # empty bags
    folder = RunFolder(tmp_path / "judged")
    folder.sealed.mkdir(parents=True)
    for case in map(draw_case, SEEDS):
        bags = [folder.bags(case.name) / bag for bag in BAGS]
        for bag in [*bags, folder.healthy(case.name) / "slow", folder.healthy(case.name) / "turn"]:
            bag.mkdir(parents=True)
            (bag / "metadata.yaml").write_text("")
        (folder.bags(case.name) / "robot.yaml").write_text("")
        folder.answer(case.name).write_text(json.dumps(answer(case)))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("fails", [False, True])
def test_a_diagnosis_gets_the_baseline_of_its_robot(folder, fails, monkeypatch):
    learn = LEARN.replace("FAILS", "fails" if fails else "")
    monkeypatch.setattr(judge_run, "LEARN_BASELINE", (sys.executable, "-c", learn))
    names = run(folder.out, SEEDS, command=[sys.executable, "-c", WORKFLOW], baselines=(), baseline=True)
    for name in names:
        verdict = json.loads((folder.verdict(name) / "diagnosis.json").read_text())
        assert verdict["usual"] == ("" if fails else "slow turn")
        assert (folder.verdict(name) / "no_baseline.txt").is_file() == fails
    assert score_run(folder.out, names)["with_baseline"] == (0 if fails else len(names))
    with pytest.raises(OutputError, match="begun with --baseline"):
        run(folder.out, SEEDS, command=[sys.executable, "-c", WORKFLOW], baselines=())


@pytest.mark.slow
def test_healthy_recordings_are_of_other_gaits_and_without_what_is_hidden(tmp_path, monkeypatch):
    case = draw_case(SEEDS[0], kind="single", duration_s=4.0, worlds={"engine": "mujoco", "floor": "level"})
    given = []
    from coman_reduced_model.judge import cases

    walks = cases._walks
    monkeypatch.setattr(
        cases, "_walks", lambda world, bag, hidden, seed: given.append(hidden) or walks(world, bag, hidden, seed)
    )
    write_healthy(case.world, case.seed, tmp_path / "healthy")
    assert len(list(Path(tmp_path / "healthy").iterdir())) == HEALTHY
    assert not any(given) and len(given) >= HEALTHY
