# SPDX-License-Identifier: BSD-3-Clause
"""Cases that this project did not make: a folder of recordings with their answers.

    DIR/CASE/train, DIR/CASE/heldout_*   bags
    DIR/CASE/robot.yaml or DIR/robot.yaml  the robot's data sheet; else the configuration that is given
    DIR/answers.json                     {"cases": {CASE: {"hidden": text or null, "right": [names or verdicts], ...}}}

Every other value of a case that is one word or text, such as its soles, is a kind by which the result is reported. A
name that is right for the clean case of a kind is true of that kind: named instead of the hidden effect, it is a miss
and not a wrong name.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import ConfigError, OutputError
from ..output import to_json, write_file
from ..progress import Progress
from ..resources import config_path, version
from .by_kind import by_kind
from .commands import run_diagnosis
from .folder import RunFolder, names_effects, read_verdict, stored
from .monitor import alarms
from .prediction import figures_of, predict_walk
from .prediction import measure as measure_walks
from .run import DIAGNOSE, keep_to_one_commit, run_all, workflow_of
from .score import OTHER, rate

NOT_KINDS = ("hidden", "right", "parameters")


def read_answers(folder: Path) -> dict[str, dict[str, Any]]:
    """The answers of a folder, by case.

    Raises:
        ConfigError: the folder has none, or they are of another form.
    """
    path = folder / "answers.json"
    try:
        cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
        for answer in cases.values():
            answer["hidden"], list(answer["right"])
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: not of the form that judge/foreign.py describes: {error!r}") from None
    return dict(cases)


def judge_folder(
    folder: Path,
    out: Path,
    config: Path | None = None,
    jobs: int = 1,
    command: Sequence[str] = DIAGNOSE,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Diagnose every case of a folder, then open its answers; writes OUT/score.json.

    Args:
        folder: of the cases.
        out: gets `verdicts/` and `commit.txt`; what exists is kept.
        config: data sheet of a robot that has none in the folder; default: the shipped one.
        jobs: processes at a time.
        command: the workflow, to which bags and options are appended.
        progress: called with the fraction done and a text.

    Raises:
        ConfigError: the folder holds no cases.
        OutputError: `out` cannot be written, or the run was begun at another commit.
    """
    cases = _cases_in(folder, out, "verdicts", config, workflow=workflow_of(command))
    tasks = [(case, out / "verdicts" / case.name, _data_sheet(case, config), tuple(command)) for case in cases]
    run_all(_diagnose, tasks, jobs, progress, "cases")
    return score_folder(folder, out, [case.name for case in cases])


def _cases_in(folder: Path, out: Path, part: str, config: Path | None, **options: str) -> list[Path]:
    """The cases of a folder, and a part of `out` made for them."""
    cases = sorted(path.parent for path in folder.glob("*/train"))
    if not cases:
        raise ConfigError(f"{folder}: no case in it (wanted: CASE/train, CASE/heldout_*, answers.json)")
    if missing := {case.name for case in cases}.difference(read_answers(folder)):
        raise ConfigError(f"{folder / 'answers.json'}: no answer to {', '.join(sorted(missing))}")
    try:
        (out / part).mkdir(parents=True, exist_ok=True)
        data_sheet = str(config.absolute()) if config else ""
        RunFolder(out).keep_to_options({"cases": str(folder.absolute()), "config": data_sheet, **options})
        keep_to_one_commit(RunFolder(out))
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be written: {error.strerror}") from None
    return cases


def watch_folder(
    folder: Path, out: Path, config: Path | None = None, jobs: int = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Predict and watch every recording of a folder, and say which were clean by its answers; writes OUT/walks.json.

    Args: as of judge_folder.

    Returns:
        prediction: as `score_predictions`, of the clean robots. monitor: by kind, as `alarms` of the clean robots
        (`clean`), and of those with an effect from the beginning (`faulty`); how many walks `failed`.

    Raises:
        ConfigError: the folder holds no cases.
        OutputError: `out` cannot be written, or the run was begun at another commit.
    """
    cases = _cases_in(folder, out, "predictions", config)
    answers = read_answers(folder)
    bags = [(case, bag) for case in cases for bag in sorted(each for each in case.iterdir() if each.is_dir())]
    tasks = [(bag, _data_sheet(case, config), _target(out, case, bag)) for case, bag in bags]
    run_all(predict_walk, tasks, jobs, progress, "walks")
    rows = []
    for case, bag in bags:
        answer, found = answers[case.name], stored(_target(out, case, bag))
        assert found is not None
        row = {"case": case.name, "bag": bag.name, "hidden": answer["hidden"], "worlds": _kinds_of(answer)}
        rows.append({**row, "attempt": 0, **figures_of(found)})
    clean = [row for row in rows if row["hidden"] is None]

    def watched(some: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        parts = {"clean": [row for row in some if row["hidden"] is None]}
        parts["faulty"] = [row for row in some if row["hidden"] is not None]
        return {**{name: alarms(rows) for name, rows in parts.items()}, "failed": sum(bool(r["failed"]) for r in some)}

    result = {
        "version": version(),
        "prediction": {"all": measure_walks(clean), "by_kind": by_kind(clean, measure_walks)},
        "monitor": {"all": watched(rows), "by_kind": by_kind(rows, watched)},
        "rows": rows,
    }
    write_file(out / "walks.json", to_json(result))
    return result


def _target(out: Path, case: Path, bag: Path) -> Path:
    return out / "predictions" / case.name / f"{bag.name}.json"


def _data_sheet(case: Path, config: Path | None) -> Path:
    for path in (case / "robot.yaml", case.parent / "robot.yaml"):
        if path.is_file():
            return path
    return config or config_path()


def _diagnose(case: Path, verdict: Path, config: Path, command: Sequence[str]) -> None:
    if stored(verdict / "run.json") is None:
        held_out = sorted(path for path in case.iterdir() if path.is_dir() and path.name != "train")
        run_diagnosis([case / "train", *held_out], config, verdict, command)


def score_folder(folder: Path, out: Path, names: Sequence[str]) -> dict[str, Any]:
    """Outcomes by kind; writes OUT/score.json."""
    answers = read_answers(folder)
    rows = []
    for name in names:
        answer, verdict = answers[name], read_verdict(out / "verdicts" / name / "diagnosis.json")
        kinds = _kinds_of(answer)
        rows.append({
            "case": name,
            "hidden": answer["hidden"],
            "right": list(answer["right"]),
            "worlds": kinds,
            **outcome(answer, verdict, _true_of(kinds, answers)),
        })  # fmt: skip
    result = {"version": version(), "all": measure(rows), "by_kind": by_kind(rows, measure), "rows": rows}
    write_file(out / "score.json", json.dumps(result, indent=1))
    return result


def _kinds_of(answer: Mapping[str, Any]) -> dict[str, str]:
    texts = {key: value for key, value in answer.items() if key not in NOT_KINDS and isinstance(value, str)}
    return {key: value for key, value in texts.items() if not key.startswith("said")}


def _true_of(kinds: Mapping[str, str], answers: Mapping[str, Mapping[str, Any]]) -> set[str]:
    """Names that are right for a clean case of the same kind."""
    clean = [
        a for a in answers.values() if a["hidden"] is None and any(a.get(key) == kind for key, kind in kinds.items())
    ]
    return {name for answer in clean for name in answer["right"]}.difference(OTHER)


def outcome(answer: Mapping[str, Any], verdict: Mapping[str, Any] | None, also_true: set[str]) -> dict[str, Any]:
    """`right`, `miss`, `wrong` or `failed`, and what was named, minor or not.

    Args:
        answer: hidden and right.
        verdict: of diagnosis.json; None: there is none.
        also_true: names that are no mistake.
    """
    kind = (verdict or {}).get("verdict")
    if verdict is None or kind not in ("effect", *OTHER):
        return {"result": "failed", "named": []}
    if not names_effects(verdict):
        return {"result": "right" if kind in answer["right"] else "miss", "named": [kind]}
    named = sorted({str(effect["name"]) for effect in verdict["effects"]})
    right = set(answer["right"])
    if not right.intersection(named):
        result = "miss" if set(named) <= also_true else "wrong"
    else:
        result = "right" if set(named) <= right | also_true else "wrong"
    return {"result": result, "named": named}


def _lacks_something(row: Mapping[str, Any]) -> bool:
    return row["result"] in ("miss", "wrong") and row["named"] != ["not_excited"]


def measure(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Shares of right, missed and wrong ones, false alarms on clean robots that have a verdict, and those without."""
    hidden, clean = ([row for row in rows if (row["hidden"] is None) == is_clean] for is_clean in (False, True))

    def share(of: Sequence[Mapping[str, Any]], *results: str) -> dict[str, Any]:
        return rate(sum(row["result"] in results for row in of), len(of))

    said = [row for row in clean if row["result"] != "failed"]
    return {
        "right": share(hidden, "right"),
        "miss": share(hidden, "miss", "failed"),
        "wrong": share(hidden, "wrong"),
        "false_alarms": rate(sum(_lacks_something(r) for r in said), len(said)),
        "failed": share(rows, "failed"),
    }
