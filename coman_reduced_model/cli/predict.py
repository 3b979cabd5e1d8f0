# SPDX-License-Identifier: BSD-3-Clause
"""`coman predict`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .common import (
    BagArgument,
    ConfigOption,
    ForceOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    by_axis_text,
    loading,
    print_json,
    print_table,
    progress,
    read_config,
    warn,
)


def predict(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for predictions/, summary.json, config.yaml.")
    ],
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Predict the COM over a recorded bag, as fast as it goes: what the node would have said."""
    with loading():
        settings = read_config(config, changes)
        from ..bag.session import Session
        from ..offline import predict_bag
        from ..topics import TopicNames

        session = Session(bag, settings, urdf=urdf, names=TopicNames(namespace, remap or ()))
    with session, progress("predicting") as report:
        summary = predict_bag(session, out, force=force, progress=report)
    warn(summary["warnings"])
    counts = summary["rejected"]
    warn([f"rejected {counts[reason]}: {sentence}" for reason, sentence in summary["last_rejection"].items()])
    if json:
        print_json(summary)
    else:
        _show(summary, out)


def _show(summary: dict[str, Any], out: Path) -> None:
    rows = [
        ["all", *_errors(summary)],
        *([phase.lower(), *_errors(errors)] for phase, errors in summary["by_phase"].items()),
    ]
    axes = "xyz"
    print_table(
        "RMS error of the COM [mm]: free run of the model, and the rigid robot",
        ["phase", "seconds", *(f"model {axis}" for axis in axes), *(f"rigid {axis}" for axis in axes)],
        [[row[0], f"{_seconds(summary, row[0]):.1f}", *row[1:]] for row in rows],
    )
    if summary["skill"]:
        print_table(
            "Predictions ahead: skill (1 - RMSE / RMSE of the best baseline), share within the 90 % interval [%]",
            ["horizon [s]", *axes, *(f"within {axis}" for axis in axes)],
            [
                [h, *by_axis_text(skill, 1.0, 2), *by_axis_text(summary["within_90"][h], 100.0, 0)]
                for h, skill in summary["skill"].items()
            ],
        )
    print(_estimate(summary["estimate"]))
    rejected = ", ".join(f"{reason}: {count}" for reason, count in summary["rejected"].items()) or "none"
    print(f"{summary['samples']} samples, {summary['duration_s']:.1f} s, {summary['realtime_factor']:.0f} x real time")
    print(f"messages rejected: {rejected}; restarts: {summary['restarts']}")
    print(f"written: {out}")


def _estimate(found: dict[str, Any]) -> str:
    """How consistent the estimate was."""
    if found["nis"] != found["nis"]:  # NaN
        return "estimate: none"
    text = f"estimate: NIS {found['nis']:.1f}"
    if "steps" in found:
        text += f", NEES of position {found['nees_position']:.1f}, of velocity {found['nees_velocity']:.1f}"
    if "nees_ground_velocity" in found:
        text += f", of velocity against the ground {found['nees_ground_velocity']:.1f}"
    text += " (3 is expected)"
    if "rmse_turn_rad" in found:
        pitch, encoders = (1e3 * found[f"rmse_{of}turn_rad"]["y"] for of in ("", "encoder_"))
        text += f"; pitch of the trunk: RMS error {pitch:.1f} mrad, of encoders alone {encoders:.1f} mrad"
    return text


def _errors(errors: dict[str, Any]) -> list[str]:
    return [*by_axis_text(errors["rmse_m"], 1e3, 2), *by_axis_text(errors["rmse_rigid_m"], 1e3, 2)]


def _seconds(summary: dict[str, Any], phase: str) -> float:
    seconds: float = summary["duration_s"] if phase == "all" else summary["phases_s"][phase.upper()]
    return seconds
