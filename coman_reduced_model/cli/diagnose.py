# SPDX-License-Identifier: BSD-3-Clause
"""`coman diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .common import (
    BaselineOption,
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


def diagnose(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Recorded walks of one robot.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for diagnosis.json, model.yaml, report.html.")
    ],
    holdout: Annotated[
        list[Path] | None,
        typer.Option(
            "--holdout",
            metavar="BAG",
            help="Another walk, better of another gait; no value is fitted to it. The last one confirms: it is opened "
            "once, at the end, and can only take effects away, though it helps to weigh the robot. Those before it "
            "help to choose. Repeatable.",
        ),
    ] = None,
    assume: Annotated[
        list[str] | None,
        typer.Option("--assume", metavar="NAME[:where=PLACE]", help="Fit this effect instead of looking for one."),
    ] = None,
    baseline: BaselineOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Find the effect that the model or the sensors lack, and show by how much the gap shrinks on other bags."""
    settings = read_config(config, changes)
    from ..diagnose import diagnose as run
    from ..diagnose.report.folder import save_diagnosis
    from ..output import OutputFolder
    from ..topics import TopicNames

    OutputFolder(out, force)  # refuses now what it would refuse in a minute
    names = TopicNames(namespace, remap or ())
    with progress("diagnosing") as report:
        diagnosis = run(
            bags,
            holdout or (),
            settings,
            assume=assume or (),
            baseline=baseline or "",
            urdf=urdf,
            names=names,
            progress=report,
            notice=lambda line: warn([f"check the clocks first: {line}"]),
        )
    save_diagnosis(diagnosis, out, force)
    warn(diagnosis.result["not_checked"])
    if json:
        print_json(diagnosis.result)
    else:
        _show(diagnosis.result, out)


def _show(result: dict[str, Any], out: Path) -> None:
    from ..diagnose.report.alike import decides
    from ..diagnose.report.words import FAR_HEAD, far, named, or_else, spaced

    print(f"verdict: {result['verdict']}: {result['sentence']}")
    if found := [f"{spaced(name)} {p:.2f}" for name, p in result["probabilities"].items()]:
        print(f"probabilities: {', '.join(found[:6])}")
    for each in result["decides"]:
        print(decides(each))
    held = result["gap"]["holdout"] or result["gap"]["train"]
    before, after, floor = held["before"], held["after"], held["floor"]
    shrinks = sorted(before, key=lambda c: -(before[c] - after[c]) / max(floor.get(c, 0), 1e-9))
    com = [channel for channel in before if channel.startswith("com/")]
    others = [channel for channel in shrinks if channel not in com]
    rows = [
        [channel, f"{before[channel]:.3g}", f"{after[channel]:.3g}", f"{floor.get(channel, 0):.3g}"]
        for channel in [*com, *others[:8]]
    ]
    which = "held-out" if result["gap"]["holdout"] else "training"
    suspected = "; ".join(named(effect["name"], effect["where"]) + or_else(effect) for effect in result["suspected"])
    after_what = f"; after: with what is suspected: {suspected}" if suspected else ""
    print_table(
        f"Gap on the {which} bags, RMS in SI units{after_what}", ["channel", "before", "after", "noise floor"], rows
    )
    print_table(
        "Ranking by evidence, the natural logarithm of a ratio of probabilities (4.6 nats: 100 to 1)",
        ["effect", "where", "evidence [nats]", "held-out [nats]"],
        [
            [
                r["name"],
                r["where"],
                f"{r['evidence']:.1f}",
                "" if r["holdout_gain"] is None else f"{r['holdout_gain']:.1f}",
            ]
            for r in result["ranking"][:6]
        ],
    )
    if rows := [far(row) for row in result["far_from_nominal"]]:
        print_table("Further from nominal than usual, beside that", FAR_HEAD, rows[:6], words=2)
    print(f"written: {out}")
