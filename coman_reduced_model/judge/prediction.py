# SPDX-License-Identifier: BSD-3-Clause
"""The prediction on clean robots of all kinds of worlds: its free run and horizons against their baselines.

    OUT/predictions/CASE/BAG.json   what `coman predict` says of each bag of a clean case

The same runs serve the monitor, whose false alarms they hold.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..bag.session import Session
from ..core.base.nominal import load_nominal
from ..core.config.files import load_config
from ..errors import ComanError
from ..offline import predict_bag
from ..output import to_json, write_file
from ..progress import Progress
from ..resources import version
from .by_kind import by_kind, by_what_was_learnt
from .cases import BAGS
from .folder import RunFolder, stored
from .run import chosen_cases, make_case, run_all
from .seeds import commit, summary

AXES_XYZ = ("x", "y", "z")
HORIZONS = ("0.1", "0.2", "0.4")  # [s] of the skills that are reported


def run_predictions(
    out: str | Path, seeds: Sequence[int], jobs: int = 1, progress: Progress | None = None, **fixed: Any
) -> list[str]:
    """Predict every bag of the clean cases; what exists is kept.

    Args:
        out: folder of the run.
        seeds: one for each case.
        jobs: processes at a time.
        progress: called with the fraction done and a text.
        fixed: see draw_case.

    Returns:
        The names of the clean cases.

    Raises:
        ConfigError: no clean case is among the seeds.
        OutputError: `out` cannot be written.
    """
    folder, cases = chosen_cases(out, seeds, ["clean"], **fixed)
    run_all(_predict_case, [(folder, case.seed, fixed) for case in cases], jobs, progress, "cases")
    return [case.name for case in cases]


def _predict_case(folder: RunFolder, seed: int, fixed: Mapping[str, Any]) -> None:
    name, failed = make_case(folder, seed, **fixed)
    for bag in BAGS:
        target = folder.out / "predictions" / name / f"{bag}.json"
        predict_walk(folder.bags(name) / bag, folder.bags(name) / "robot.yaml", target, failed)


def predict_walk(bag: Path, config: Path, target: Path, failed: str = "") -> None:
    """Write what `predicted` says of a bag, or why it could not be recorded; what exists is kept."""
    if stored(target) is None:
        write_file(target, to_json({"failed": failed} if failed else predicted(bag, config)))


def predicted(bag: Path, config: Path) -> dict[str, Any]:
    """What `coman predict` says of a bag, without the configuration; `failed` and why, if it says nothing."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            with Session(bag, load_config(config)) as session:
                summary = predict_bag(session, Path(folder) / "out")
        except ComanError as error:
            return {"failed": str(error).replace(str(bag.parent), "")}
    return {key: value for key, value in summary.items() if key not in ("config", "bag", "robot", "streams")}


def score_predictions(out: str | Path, names: Sequence[str]) -> dict[str, Any]:
    """Errors and skills by kind of world; writes OUT/prediction.json."""
    folder = RunFolder(Path(out).absolute())
    rows = prediction_rows(folder, names)
    result = {
        "version": version(),
        "commit": folder.begun or commit(),
        "seeds": summary("worlds", [row["seed"] for row in rows]),
        "took": folder.took("prediction"),
        "cases": len(names),
        "walks": len(rows),
        "all": measure(rows),
        "by_kind": by_kind(rows, measure),
        "learnt": by_what_was_learnt(rows, load_nominal(), measure),
        "rows": rows,
    }
    write_file(folder.out / "prediction.json", to_json(result))
    return result


def prediction_rows(folder: RunFolder, names: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each walk of the clean cases; held-out ones have a length of their own."""
    rows = []
    for name in names:
        answer = stored(folder.answer(name))
        for bag in BAGS:
            found = stored(folder.out / "predictions" / name / f"{bag}.json")
            worlds = {**answer["worlds"], "gait": answer["gaits"][bag]}
            if bag != BAGS[0]:
                del worlds["length"]
            row = {"case": name, "seed": answer["seed"], "bag": bag, "worlds": worlds, "attempt": answer["attempt"]}
            rows.append({**row, **figures_of(found)})
    return rows


def figures_of(found: Mapping[str, Any]) -> dict[str, Any]:
    """Of what `predicted` says: errors [m], skills by horizon and alarms; `failed` and why, if it says nothing."""
    if "failed" in found:
        return {"failed": found["failed"]}
    skill = {horizon: found["skill"].get(horizon, {}) for horizon in HORIZONS}
    return {
        "failed": "",
        "seconds": found["duration_s"],
        "rmse_m": [found["rmse_m"][axis] for axis in AXES_XYZ],
        "rigid_m": [found["rmse_rigid_m"][axis] for axis in AXES_XYZ],
        "skill": {horizon: [by_axis.get(axis) for axis in AXES_XYZ] for horizon, by_axis in skill.items()},
        "alarms": [f"{each['channel']}" for each in found["mismatches"]],
    }


def measure(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Medians over walks, by axis x, y, z: errors of the free run and of the rigid robot, skills by horizon.

    A skill is 1 - error / error of the best baseline that knows no more than the prediction does.
    `worse_than_rigid` is the share of walks on which the free run is worse than to assume no springs, by axis.
    """
    good = [row for row in rows if not row["failed"]]
    error, rigid = (_array([row[key] for row in good]) for key in ("rmse_m", "rigid_m"))
    known = np.isfinite(error) & np.isfinite(rigid)
    return {
        "walks": len(rows),
        "failed": len(rows) - len(good),
        "rmse_m": _median(error),
        "rigid_m": _median(rigid),
        "worst_rmse_m": [float(np.nanmax(column)) if np.isfinite(column).any() else None for column in error.T],
        "worse_than_rigid": [
            float(np.mean((error > rigid)[known[:, k], k])) if known[:, k].any() else None for k in range(3)
        ],
        "skill": {horizon: _median(_array([row["skill"][horizon] for row in good])) for horizon in HORIZONS},
        "redrawn": sum(row["attempt"] > 0 for row in rows),
    }


def _array(values: Sequence[Any]) -> Any:
    return np.array(values, dtype=float).reshape(-1, 3)


def _median(values: Any) -> list[float | None]:
    return [float(np.nanmedian(column)) if np.isfinite(column).any() else None for column in values.T]
