# SPDX-License-Identifier: BSD-3-Clause
"""`coman baseline`."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ..output import check_file, write_file
from .common import (
    ConfigOption,
    ForceOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_table,
    progress,
    read_config,
    warn,
)


def baseline(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Walks of one robot when nothing was wrong.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File for what is usual for this robot.")],
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
) -> None:
    """Learn what is usual for your robot, for `coman diagnose --baseline` and the monitor (monitor.baseline)."""
    settings = read_config(config, changes)
    check_file(out, force)
    import yaml

    from ..diagnose.baseline import baseline as run
    from ..diagnose.inference.effects import CONFIDENCE
    from ..diagnose.report.words import number, off_weight
    from ..topics import TopicNames

    with progress("learning") as report:
        learnt = run(bags, settings, urdf=urdf, names=TopicNames(namespace, remap or ()), progress=report)
    text = f"# What is usual for one robot, by {learnt.bags} recordings of it (coman baseline).\n"
    write_file(out, text + yaml.safe_dump(learnt.nominal.plain(), sort_keys=False, width=120))
    warn(learnt.not_checked)
    weight = learnt.weight
    if math.isfinite(weight.share):
        share = number(100.0 * (1.0 + weight.share), 100.0 * CONFIDENCE * weight.deviation)
        print(f"weight by forces and motion: {share} % of what the URDF says")
    else:
        print("weight: not known: no foot leaves the ground, or vertical forces and other laws disagree")
    if off := off_weight(asdict(weight)):
        warn([f"{off}, and data sheets allow {weight.allowed:.0%}: is it the robot, or its URDF? No baseline hides it"])
    if learnt.pulled:
        rows = [[name, f"{value:.1f}"] for name, value in learnt.pulled.items()]
        print_table(
            "Far from the robot's description: check it; no baseline hides more than is plausible of masses and gains",
            ["what", "standard deviations"],
            rows,
        )
    if learnt.not_monitored:
        print(f"monitor: as for any robot, since it cannot follow these recordings: {learnt.not_monitored}")
    print(f"written: {out}")
