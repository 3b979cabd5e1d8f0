# SPDX-License-Identifier: BSD-3-Clause
"""Seeds on which something was chosen or reported are known, labelled, and not taken by default."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from conftest import ROOT

from coman_reduced_model.cli.main import run as coman
from coman_reduced_model.judge import seeds as judge_seeds
from coman_reduced_model.judge.cases import BAGS, answer, draw_case
from coman_reduced_model.judge.folder import RunFolder
from coman_reduced_model.judge.run import choose_seeds, run
from coman_reduced_model.judge.seeds import commit_of, describe, entry_to_add, fresh_range, spent
from coman_reduced_model.resources import version

FILE = ROOT / "coman_reduced_model" / "judge" / "seeds.yaml"
NO_VERDICT = [sys.executable, "-c", ""]


@pytest.fixture
def listed(tmp_path, monkeypatch):
    """A list of seeds of its own: worlds 0:40, 70:80 and 75:78."""
    path = tmp_path / "seeds.yaml"
    entries = [
        {"seeds": "0:40", "purpose": "choosing limits", "commit": "1234567"},
        {"seeds": "70:80", "purpose": "reported", "commit": "abc1234"},
        {"seeds": "75:78", "purpose": "looked at again", "commit": "abc1235"},
    ]
    path.write_text(yaml.safe_dump({"worlds": entries}))
    monkeypatch.setattr(judge_seeds, "FILE", path)
    spent.cache_clear()
    yield path
    spent.cache_clear()


def recorded(out: Path, seeds: list[int]) -> None:
    """Cases whose bags are empty files: nothing is recorded."""
    folder = RunFolder(out)
    folder.sealed.mkdir(parents=True)
    for seed in seeds:
        case = draw_case(seed)
        for bag in BAGS:
            (folder.bags(case.name) / bag).mkdir(parents=True)
        (folder.bags(case.name) / "robot.yaml").write_text("")
        folder.answer(case.name).write_text(json.dumps(answer(case)))


def test_every_entry_has_a_range_a_purpose_and_a_commit():
    uses = yaml.safe_load(FILE.read_text())
    assert set(uses) == {"worlds", "judge", "monitor", "walks"}
    for use, entries in uses.items():
        assert [set(entry) for entry in entries] == [{"seeds", "purpose", "commit"}] * len(entries)
        assert len(spent(use)) == len(entries)
        for entry in entries:
            assert entry["purpose"].strip() and re.fullmatch(
                r"[0-9a-f]{7,40}(-dirty(-[0-9a-f]{6})?)?|\d+\.\d+\.\d+", entry["commit"]
            )


@pytest.mark.parametrize(
    ("use", "known"),
    [
        ("worlds", [0, 999, 1000, 1071, 5000]),
        ("judge", [0, 999, 1000, 1280, 1480, 1879, 2079, 2080, 2479, 2559, 2639, 9000, 9079]),
        ("monitor", [600, 1000, 6000, 14000, 33000, 34019, 42019, 42999, 43002]),
        ("walks", [1, 1000, 3000, 5005]),
    ],
)
def test_seeds_of_earlier_figures_are_spent_and_the_default_is_not(use, known):
    assert all("spent" in describe(use, [seed]) for seed in known)
    assert describe(use, fresh_range(use, 200, 40)) == "fresh"


@pytest.mark.parametrize(
    ("size", "step", "fresh"),
    [(30, 1, range(40, 70)), (31, 1, range(80, 111)), (20, 40, range(40, 60)), (40, 40, range(80, 120))],
)
def test_the_next_fresh_range_is_the_first_one_without_a_spent_seed(listed, size, step, fresh):
    assert fresh_range("worlds", size, step) == fresh


def test_a_label_says_how_many_seeds_are_spent_and_on_what(listed):
    assert describe("worlds", range(40, 70)) == "fresh"
    assert describe("worlds", range(60, 80)) == (
        "10 of 20 spent: 70:80 reported (abc1234); 75:78 looked at again (abc1235)"
    )


def test_the_line_to_add_makes_seeds_spent(listed):
    line = entry_to_add(range(40, 70), "abc1236")
    listed.write_text(f"worlds:\n{line}\n")
    spent.cache_clear()
    assert describe("worlds", [40]).startswith("1 of 1 spent: 40:70 reported (")
    assert describe("worlds", [39]) == describe("worlds", [70]) == "fresh"


def test_two_changed_checkouts_are_of_two_versions(tmp_path):
    def git(*command: str) -> None:
        subprocess.run(["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", *command], check=True)

    file = tmp_path / "law.py"
    file.write_text("1")
    assert commit_of(tmp_path) == version()
    git("init", "-q")
    git("add", "law.py")
    git("commit", "-qm", "a")
    clean, found = commit_of(tmp_path), []
    for text in ("2", "3", "1"):
        file.write_text(text)
        found.append(commit_of(tmp_path))
    assert found[2] == clean and len({*found}) == 3 and all(each.startswith(f"{clean}-dirty-") for each in found[:2])
    (tmp_path / "judged").write_text("a run is no version")
    assert commit_of(tmp_path) == clean
    (tmp_path / "coman_reduced_model").mkdir()
    (tmp_path / "coman_reduced_model" / "new.py").write_bytes(b"\xff")
    assert commit_of(tmp_path).startswith(f"{clean}-dirty-")


def test_an_interrupted_run_keeps_its_seeds_when_the_next_fresh_range_has_moved(tmp_path, listed):
    out = tmp_path / "judged"
    assert choose_seeds("", out) == range(80, 280)
    assert choose_seeds("3:5", out) == range(3, 5)
    seeds = [41, 42]
    recorded(out, seeds)
    run(out, seeds, command=NO_VERDICT, baselines=(), oracle=False)
    assert choose_seeds("", out) == seeds
    assert oct(RunFolder(out).seeds.stat().st_mode)[-3:] == "600"


@pytest.mark.slow
def test_coman_validate_records_walks_of_fresh_seeds_by_default(tmp_path, capsys):
    options = ["--quick", "--untuned", "--robots", "small", "--duration", "3", "--processes", "1"]
    assert coman(["validate", "--out", str(tmp_path / "v"), *options]) == 0
    seed = json.loads((tmp_path / "v" / "validation.json").read_text())["seed"]
    assert describe("walks", range(seed, seed + 2)) == "fresh"
    assert f"seeds {seed} to {seed + 1}: fresh" in capsys.readouterr().out


@pytest.mark.parametrize(("seeds", "fresh"), [([41], True), ([39, 40], False)])
def test_coman_judge_labels_spent_seeds_and_prints_the_line_for_fresh_ones(tmp_path, capsys, listed, seeds, fresh):
    recorded(tmp_path / "judged", seeds)
    spy = f'{sys.executable} -c ""'
    arguments = ["judge", "--out", str(tmp_path / "judged"), "--seeds", f"{seeds[0]}:{seeds[-1] + 1}"]
    arguments += ["--workflow", spy, "--no-baselines", "--no-oracle"]
    assert coman(arguments) == 0
    printed, errors = capsys.readouterr()
    if fresh:
        assert "seeds 41 to 41: fresh" in errors and "seeds 41 to 41 (fresh): 1 " in printed
        assert '  - {seeds: "41:42", purpose: "reported", commit: "' in printed and "spent:" not in printed
    else:
        assert "seeds 39 to 40: 1 of 2 spent: 0:40 choosing limits (1234567)" in errors
        assert "(1 of 2 spent)" in printed and "spent: 0:40 choosing limits (1234567)" in printed
    assert coman([*arguments, "--json"]) == 0
    label = json.loads(capsys.readouterr().out)["seeds"]
    assert (label["first"], label["last"], label["fresh"]) == (seeds[0], seeds[-1], 1)
    entry = {"seeds": "0:40", "purpose": "choosing limits", "commit": "1234567"}
    assert label["spent"] == ([] if fresh else [entry])
