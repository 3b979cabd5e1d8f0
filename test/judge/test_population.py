# SPDX-License-Identifier: BSD-3-Clause
"""The judge by kind of world: prediction, monitor, cases of others, the oracle that knows the variability."""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import ROOT

from coman_reduced_model.cli.judge_tables import show_monitor, show_prediction
from coman_reduced_model.cli.main import run as coman
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.errors import ConfigError, OutputError
from coman_reduced_model.judge.by_kind import by_kind, kinds_of, new_kinds
from coman_reduced_model.judge.cases import draw_case, write_case
from coman_reduced_model.judge.folder import RunFolder
from coman_reduced_model.judge.foreign import judge_folder, outcome
from coman_reduced_model.judge.prediction import measure
from coman_reduced_model.judge.run import chosen_cases
from coman_reduced_model.judge.seeds import commit, spent
from coman_reduced_model.resources import bag_path, config_path
from coman_reduced_model.sim.worlds import AXES, draw_world
from coman_reduced_model.sim.worlds.draw import plain_kinds

SHORT = {"duration_s": 4.0, "worlds": plain_kinds() | {"contact": "creeping"}}
SHARED = ROOT.parent / "shared" / "other_robot_cases"


# --- kinds ---


def test_figures_by_kind_are_of_the_rows_of_that_kind_only():
    rows = [
        {"worlds": {"contact": "firm", "engine": "mujoco"}, "value": 1},
        {"worlds": {"contact": "creeping", "engine": "mujoco"}, "value": 2},
        {"worlds": {"contact": "creeping", "engine": "drake"}, "value": 4},
    ]
    found = by_kind(rows, lambda those: sum(row["value"] for row in those))
    assert found == {"engine": {"mujoco": 3, "drake": 4}, "contact": {"firm": 1, "creeping": 6}}
    learnt = replace(load_nominal(), source={"kinds": kinds_of(rows[:1], {"gait": ["test1"]})})
    assert learnt.source["kinds"] == {"engine": ["mujoco"], "contact": ["firm"], "gait": ["test1"]}
    assert [set(new_kinds(row, learnt)) for row in rows] == [set(), {"creeping"}, {"drake", "creeping"}]
    assert new_kinds({"worlds": {"length": "120 s", "contact": "firm"}}, learnt) == []
    of_monitor = replace(learnt, source={**learnt.source, "monitor": {"kinds": {"engine": ["drake"]}}})
    assert new_kinds(rows[2], of_monitor, "monitor") == ["creeping"]
    assert new_kinds(rows[2], learnt, "monitor") == new_kinds(rows[2], learnt)


def test_the_shipped_file_says_on_which_kinds_it_was_learnt():
    """All kinds that are drawn, but for the second engine, by judge/seeds.yaml."""
    drawn = {axis: [name for name, kind in of.items() if kind.weight] for axis, of in AXES.items()}
    assert load_nominal().source["kinds"] == {**drawn, "engine": ["mujoco"]}
    *_, last = [entry.purpose for entry in spent("worlds") if "learning all again" in entry.purpose]
    assert "MuJoCo alone" in last


# --- runs ---


def test_a_run_goes_on_with_its_own_commit_only(tmp_path):
    chosen_cases(tmp_path / "run", [0])
    (tmp_path / "run" / "commit.txt").write_text("0000000\n")
    with pytest.raises(OutputError, match="was begun at commit 0000000, and this is .* not pooled"):
        chosen_cases(tmp_path / "run", [0])
    chosen_cases(tmp_path / "run", [0], again=True)
    assert (tmp_path / "run" / "commit.txt").read_text().strip() != "0000000"


def test_a_run_goes_on_with_its_own_worlds_only(tmp_path):
    chosen_cases(tmp_path / "run", [0], worlds={"engine": "mujoco"})
    chosen_cases(tmp_path / "run", [0, 1], worlds={"engine": "mujoco"})
    folder, (case, _) = chosen_cases(tmp_path / "run", [0, 1], worlds={"engine": "mujoco"})
    folder.verdict(case.name).mkdir(parents=True)
    with pytest.raises(OutputError, match="was begun with --world mujoco: go on so, or take another folder"):
        chosen_cases(tmp_path / "run", [2], again=True)
    assert folder.verdict(case.name).exists() and json.loads(folder.seeds.read_text()) == [0, 1]  # nothing has changed


@pytest.fixture(scope="module")
def clean_run(tmp_path_factory) -> Path:
    """A run with the bags of one clean case, of short walks."""
    out = tmp_path_factory.mktemp("judge") / "run"
    seed = next(seed for seed in range(40) if draw_case(seed).kind == "clean")
    folder, (case,) = chosen_cases(out, [seed], **SHORT)
    answer = write_case(case, folder.bags(case.name))
    assert answer is not None
    folder.answer(case.name).write_text(json.dumps(answer))
    return out


@pytest.mark.slow
def test_the_prediction_is_judged_on_clean_robots_by_kind(clean_run, capsys):
    from coman_reduced_model.judge.prediction import run_predictions, score_predictions

    seeds = json.loads(RunFolder(clean_run).seeds.read_text())
    names = run_predictions(clean_run, seeds, **SHORT)
    result = score_predictions(clean_run, names)
    assert result["walks"] == 3 and result["all"]["failed"] == 0
    assert set(result["by_kind"]["contact"]) == {"creeping"} and len(result["by_kind"]["gait"]) == 3
    assert [found["walks"] for found in result["by_kind"]["length"].values()] == [1]  # held-out walks: of their own
    assert result["seeds"]["first"] == seeds[0] and result["commit"] == commit()
    model, rigid = result["all"]["rmse_m"], result["all"]["rigid_m"]
    assert 0.0 < model[2] < rigid[2] < 0.01
    for row in result["rows"]:
        assert row["seconds"] > 2.5
    before = {path: path.stat().st_mtime_ns for path in (clean_run / "predictions").rglob("*.json")}
    run_predictions(clean_run, seeds, **SHORT)
    assert {path: path.stat().st_mtime_ns for path in before} == before  # resumed: nothing is done twice


def test_errors_that_are_missing_are_not_zero():
    skill = {"0.1": [None] * 3, "0.2": [0.5, None, 0.1], "0.4": [0.2, 0.3, -0.4]}
    good = {"failed": "", "rmse_m": [1e-3, 2e-3, 3e-3], "rigid_m": [2e-3, 1e-3, None], "skill": skill, "attempt": 0}
    found = measure([good, {"failed": "no clock", "attempt": 1}])
    assert found["walks"] == 2 and found["failed"] == 1 and found["redrawn"] == 1
    assert found["worse_than_rigid"] == [0.0, 1.0, None]
    assert found["skill"] == skill


def test_kinds_are_shown_worst_first_with_all_horizons(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    skill = {"0.1": [0.11, 0.12, 0.13], "0.2": [0.21, 0.22, 0.23], "0.4": [0.41, 0.42, 0.43]}
    walk = {"failed": "", "rigid_m": [2e-3] * 3, "skill": skill, "attempt": 1}
    good, bad = ({**walk, "rmse_m": [error] * 3} for error in (1e-3, 5e-3))
    without_rigid = {**walk, "rmse_m": [9e-3] * 3, "rigid_m": [None] * 3}
    streams = {"all_streams": [good], "no_imu": [bad], "no_motors": [without_rigid],
               "bare": [{"failed": "no topic", "attempt": 0}]}  # fmt: skip
    by = {"streams": {kind: measure(rows) for kind, rows in streams.items()}}
    show_prediction({"all": measure([good, bad]), "by_kind": by}, Path("judged"))
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith(" streams")]
    free_run, ahead = lines[:4], lines[4:]
    assert [line[1] for line in free_run] == ["bare", "no_motors", "no_imu", "all_streams"]
    assert free_run[0][2:] == ["1", "-,", "-,", "-", "-,", "-,", "-", "-,", "-,", "-", "1", "0"]
    assert free_run[3][-2:] == ["0", "1"]  # none, redrawn
    assert " ".join(ahead[3][2:]) == "0.11, 0.12, 0.13 0.21, 0.22, 0.23 0.41, 0.42, 0.43"
    learnt = {"new_kinds": ["drake"], "some_new_kind": measure([bad]), "only_learnt_kinds": measure([])}
    show_prediction({"all": measure([bad]), "by_kind": {}, "learnt": learnt}, Path("judged"))
    shown = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "never learnt on drake 1 5.00, 5.00, 5.00 2.00, 2.00, 2.00 100 %, 100 %, 100 % 0 1" in shown
    assert "all learnt on 0 -, -, - -, -, - -, -, - 0 0" in shown


def test_results_of_earlier_versions_are_shown(capsys):
    """They had one horizon, and did not count robots that were drawn again."""
    found = {"walks": 1, "failed": 0, "rmse_m": [1e-3] * 3, "rigid_m": [2e-3] * 3, "worse_than_rigid": [0.0] * 3,
             "skill": [0.1, 0.2, 0.3], "redrawn": 0}  # fmt: skip
    show_prediction({"all": found, "by_kind": {}}, Path("judged"))
    nothing = {"hits": 0, "of": 0, "share": None}
    clean = {"hours": 0.5, "alarms_per_hour": 4.0, "walks_with_alarm": nothing, "channels": {}}
    late = {"walks": 1, "detected": nothing, "median_s": None}
    show_monitor({"alarms": clean, "delays": late, "alarms_by_kind": {}, "delays_by_family": {}}, Path("judged"))
    printed = capsys.readouterr().out
    assert "0.10, 0.20, 0.30" in printed and "4.00" in printed


def test_the_line_of_the_readme_says_how_many_cases_were_drawn_again(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "bench")
    share = {"share": 0.1, "hits": 1, "of": 10}
    workflow = {"false_alarms_on_clean": share, "right_on_medium_and_strong": share}
    found = {"workflow": workflow, "cases": {"clean": 12, "pair": 8}, "redrawn": {"cases": 5, "lowered": 3}}
    line = importlib.import_module("markdown").honest_line(found)
    assert "5 of 20 cases were drawn again" in line and "3 have a lower level" in line


# --- monitor ---


@pytest.mark.slow
def test_the_monitor_is_judged_by_one_command(clean_run, capsys, monkeypatch):
    from coman_reduced_model.judge import monitor
    from coman_reduced_model.judge.prediction import run_predictions

    monkeypatch.setenv("COLUMNS", "150")
    monkeypatch.setattr(monitor, "SECONDS", 11.0)
    seeds = json.loads(RunFolder(clean_run).seeds.read_text())
    monitor.run_onsets(clean_run, seeds, worlds=SHORT["worlds"])
    names = run_predictions(clean_run, seeds, **SHORT)
    result = monitor.score_monitor(clean_run, names, seeds)
    assert result["alarms"]["hours"] > 6.0 / 3600.0
    assert result["delays"]["walks"] == 1 and set(result["delays_by_kind"]["contact"]) == {"creeping"}
    learnt = result["learnt"]["alarms"]  # MuJoCo's worlds, all of which were learnt on
    assert learnt["only_learnt_kinds"] == result["alarms"] and learnt["new_kinds"] == []
    show_monitor(result, clean_run)
    assert "never learnt on" in capsys.readouterr().out
    assert json.loads((clean_run / "monitor.json").read_text())["onsets"][0]["seed"] == seeds[0]


# --- cases of others ---

SAYS = """
import json, sys
from pathlib import Path
a = sys.argv[1:]
out = Path(a[a.index("--out") + 1])
out.mkdir()
name = {"a": "payload", "b": "backlash"}.get(Path(a[0]).read_text() if Path(a[0]).is_file() else
        (Path(a[0]) / "what").read_text(), "")
verdict = {"verdict": "effect", "effects": [{"name": name}]} if name else {"verdict": "none", "effects": []}
(out / "diagnosis.json").write_text(json.dumps(verdict))
"""


@pytest.fixture
def foreign(tmp_path) -> Path:
    """Three cases of somebody else: payload named, a clean one with a false alarm, one missed."""
    folder = tmp_path / "cases"
    answers = {
        "one": {"hidden": "a bag of sand", "right": ["payload"], "soles": "soft", "parameters": {"mass": 2}},
        "two": {"hidden": None, "right": ["none"], "soles": "soft"},
        "three": {"hidden": "a loose knee", "right": ["backlash"], "soles": "hard"},
    }
    for name, what in (("one", "a"), ("two", "b"), ("three", "c")):
        for bag in ("train", "heldout_1"):
            (folder / name / bag).mkdir(parents=True)
            (folder / name / bag / "what").write_text(what)
    (folder / "answers.json").write_text(json.dumps({"cases": answers}))
    return folder


def test_recordings_of_others_are_judged_by_their_kinds(tmp_path, foreign, capsys):
    tool = tmp_path / "says.py"
    tool.write_text(SAYS)
    arguments = ["judge", "--cases", str(foreign), "--out", str(tmp_path / "out"), "--jobs", "1", "--json"]
    assert coman([*arguments, "--workflow", f"{sys.executable} {tool}"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["all"]["right"]["hits"] == 1 and result["all"]["miss"]["hits"] == 1
    assert result["all"]["false_alarms"]["hits"] == result["all"]["false_alarms"]["of"] == 1
    assert result["by_kind"]["soles"]["hard"]["miss"]["hits"] == 1
    assert {row["case"]: row["result"] for row in result["rows"]} == {"one": "right", "two": "wrong", "three": "miss"}


def test_recordings_of_others_are_judged_by_one_commit(tmp_path, foreign, capsys):
    tool, out = tmp_path / "says.py", tmp_path / "out"
    tool.write_text(SAYS)
    arguments = ["judge", "--cases", str(foreign), "--out", str(out), "--jobs", "1", "--workflow"]
    arguments += [f"{sys.executable} {tool}"]
    assert coman(arguments) == 0 and (out / "commit.txt").read_text().strip() == commit()
    (out / "commit.txt").write_text("0000000\n")
    assert coman(arguments) == 2 and "was begun at commit 0000000" in capsys.readouterr().err
    (out / "commit.txt").unlink()  # of an earlier version, which did not write it
    assert coman(arguments) == 2 and "(not known)" in capsys.readouterr().err


def test_a_run_goes_on_with_its_own_cases_data_sheet_and_workflow_only(tmp_path, foreign, capsys):
    tool, out = tmp_path / "says.py", tmp_path / "out"
    tool.write_text(SAYS)
    workflow = ["--workflow", f"{sys.executable} {tool}"]
    assert coman(["judge", "--cases", str(foreign), "--out", str(out), "--jobs", "1", *workflow]) == 0
    others = shutil.copytree(foreign, tmp_path / "others")
    for cases, options, words in (
        (foreign, [], f"was begun with --workflow {sys.executable}"),
        (foreign, [*workflow, "--config", str(config_path())], "was begun with the default of --config"),
        (others, workflow, f"was begun with --cases {foreign}"),
    ):
        assert coman(["judge", "--cases", str(cases), "--out", str(out), *options]) == 2
        assert words in capsys.readouterr().err.splitlines()[-1]
    with pytest.raises(OutputError, match="was begun with --cases"):
        chosen_cases(out, [0])


@pytest.mark.slow
def test_prediction_and_monitor_are_judged_on_recordings_of_others(tmp_path, foreign, capsys):
    """A clean walk, one that cannot be read, and robots with an effect, which count for the monitor alone."""
    for name, bag in (("one", "train"), ("two", "train"), ("three", "heldout_1")):
        shutil.rmtree(foreign / name / bag)
        (foreign / name / bag).symlink_to(bag_path("test1"))
    out = tmp_path / "out"
    arguments = ["--cases", str(foreign), "--out", str(out), "--jobs", "1"]
    assert coman(["judge", "prediction", *arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["prediction"]
    assert (found["all"]["walks"], found["all"]["failed"]) == (2, 1) and found["all"]["rmse_m"][0] < 1e-3
    assert set(found["by_kind"]["soles"]) == {"soft"}
    assert coman(["judge", "monitor", *arguments, "--json"]) == 0  # of what was predicted before
    found = json.loads(capsys.readouterr().out)["monitor"]
    assert found["all"]["clean"]["walks_with_alarm"]["of"] == 1
    assert (
        found["all"]["faulty"]["walks_with_alarm"]["of"] == 2
        and not found["by_kind"]["soles"]["hard"]["clean"]["hours"]
    )
    for what in ("prediction", "monitor"):
        assert coman(["judge", what, *arguments]) == 0
        assert "walks.json" in capsys.readouterr().out


def test_a_name_that_is_true_of_the_kind_is_a_miss_and_no_mistake():
    answer = {"hidden": "x", "right": ["payload"]}
    verdict = {"verdict": "effect", "effects": [{"name": "foot_slip"}]}
    assert outcome(answer, verdict, set())["result"] == "wrong"
    assert outcome(answer, verdict, {"foot_slip"})["result"] == "miss"
    both = {"verdict": "effect", "effects": [{"name": "foot_slip"}, {"name": "payload"}]}
    assert outcome(answer, both, {"foot_slip"})["result"] == "right"
    assert outcome(answer, None, set())["result"] == "failed"


@pytest.mark.parametrize("text", ["", "[]", '{"cases": {"one": {}}}', '{"cases": 3}'])
def test_answers_of_another_form_are_refused_in_one_line(tmp_path, foreign, capsys, text):
    tool = tmp_path / "says.py"
    tool.write_text(SAYS)
    (foreign / "answers.json").write_text(text)
    arguments = ["judge", "--cases", str(foreign), "--out", str(tmp_path / "out"), "--jobs", "1"]
    assert coman([*arguments, "--workflow", f"{sys.executable} {tool}"]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert "answers.json" in message and "not of the form" in message


@pytest.mark.parametrize("what", ["diagnosis", "prediction"])
def test_a_case_without_an_answer_is_refused_before_any_work(tmp_path, foreign, capsys, what):
    (foreign / "four" / "train").mkdir(parents=True)
    assert coman(["judge", what, "--cases", str(foreign), "--out", str(tmp_path / "out")]) == 2
    assert "answers.json: no answer to four" in capsys.readouterr().err


def test_a_folder_without_cases_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no case in it"):
        judge_folder(tmp_path, tmp_path / "out")


@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not here")
def test_the_shared_cases_have_the_form_that_is_read():
    from coman_reduced_model.judge.foreign import read_answers

    answers = read_answers(SHARED)
    assert {path.parent.name for path in SHARED.glob("*/train")} <= set(answers)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["prophecy"], "allowed: diagnosis, prediction, monitor"),
        (["--world", "moon"], "no kind"),
        (["--world", "creeping", "--world", "holding"], "both of the axis contact"),
        (["--world", "drake", "--world", "creeping"], "drake and creeping exclude each other"),
        (["monitor", "--cases", "x"], "--seeds: has no effect with monitor --cases (allowed: --config)"),
        (["--only", "dirty"], "allowed: clean"),
        (["prediction", "--again"], "--again: has no effect with prediction"),
        (["prediction", "--hours", "1"], "--hours: has no effect with prediction"),
        (["monitor", "--only", "clean"], "--only: has no effect with monitor (allowed: --seeds, --world, --hours)"),
        (["monitor", "--baseline"], "--baseline: has no effect with monitor"),
        (["--workflow", "tool 'x"], "--workflow: No closing quotation"),
        (["monitor", "--workflow", "true"], "--workflow: has no effect with monitor"),
        (["--hours", "1"], "--hours: has no effect with diagnosis"),
        (["--cases", "x"], "--seeds: has no effect with diagnosis --cases (allowed: --config, --workflow)"),
    ],
)
def test_what_the_judge_cannot_do_is_said_in_one_line(tmp_path, capsys, options, words):
    assert coman(["judge", *options, "--out", str(tmp_path / "out"), "--seeds", "0:1"]) == 2
    message = capsys.readouterr().err
    assert words in message.splitlines()[-1]


def test_worlds_of_a_kind_are_all_of_that_kind():
    for seed in range(10):
        case = draw_case(seed, worlds={"contact": "holding"})
        assert case.world.kinds["contact"] == "holding"
        assert case.kind == draw_case(seed).kind and case.families == draw_case(seed).families
        assert draw_world(seed, {"contact": "holding"}).contact.friction >= 0.6
