# SPDX-License-Identifier: BSD-3-Clause
"""`coman identify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .common import (
    ConfigOption,
    ForceOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_json,
    print_table,
    progress,
    read_config,
    warn,
)

if TYPE_CHECKING:
    from ..core.config.schema import Config
    from ..tuning.identify import Estimate, Joint


def identify(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Load bags and decay bags, in any order.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The configuration with what was identified.")],
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Find the stiffness of the joint springs from slow loads, and their damping from free oscillations."""
    settings = read_config(config, changes).with_urdf(urdf)
    from ..core.config.files import save_config
    from ..output import check_file
    from ..topics import TopicNames
    from ..tuning.identify import identified_config
    from ..tuning.identify import identify as identify_joints
    from ..tuning.recording import motor_side, read_all

    check_file(out, force)
    with progress("identifying") as report:
        recordings = read_all(bags, motor_side(settings), TopicNames(namespace, remap or ()), urdf, report)
        settings = settings.with_joints_of(recordings[0].robot)
        joints = identify_joints(recordings, settings)
    warn([f"{recording.bag}: {line}" for recording in recordings for line in recording.warnings])
    names = ", ".join(bag.name for bag in bags)
    save_config(identified_config(settings, joints), out, f"springs identified from {names}", force)
    result = _result(joints, settings, bags, out)
    if json:
        print_json(result)
        return
    print_table(
        "Joint springs [Nm/rad] and dampers [Nms/rad], with intervals of 95 %",
        ["joint", "k before", "k", "interval", "d before", "d", "interval"],
        [
            [name, *_cells(joint["stiffness_Nm_per_rad"], 1), *_cells(joint["damping_Nms_per_rad"], 2)]
            for name, joint in result["joints"].items()
        ],
    )
    for name, joint in result["joints"].items():
        if joint["note"]:
            print(f"{name}: {joint['note']}")
    print(f"written: {out}")


def _result(joints: list[Joint], config: Config, bags: list[Path], out: Path) -> dict[str, Any]:
    before: dict[str, tuple[float, float]] = {}
    for leg in (config.robot.left, config.robot.right):
        before |= dict(zip(leg.joints, zip(leg.stiffness, leg.damping, strict=True), strict=True))
    return {
        "bags": [str(bag) for bag in bags],
        "config": str(out),
        "joints": {
            joint.name: {
                "stiffness_Nm_per_rad": _estimate(before[joint.name][0], joint.stiffness),
                "damping_Nms_per_rad": _estimate(before[joint.name][1], joint.damping),
                "note": joint.note,
            }
            for joint in joints
        },
    }


def _estimate(before: float, found: Estimate | None) -> dict[str, Any]:
    if found is None:
        return {"before": before, "value": None, "interval": None}
    return {"before": before, "value": found.value, "interval": [found.low, found.high]}


def _cells(estimate: dict[str, Any], digits: int) -> list[str]:
    cells = [f"{estimate['before']:.{digits}f}"]
    if estimate["value"] is None:
        return [*cells, "-", "-"]
    low, high = estimate["interval"]
    return [*cells, f"{estimate['value']:.{digits}f}", f"{low:.{digits}f} .. {high:.{digits}f}"]
