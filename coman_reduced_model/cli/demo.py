# SPDX-License-Identifier: BSD-3-Clause
"""`coman demo`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .common import (
    ConfigOption,
    ForceOption,
    JsonOption,
    by_axis_text,
    print_json,
    print_table,
    progress,
    say_domain,
    warn,
)

DEFAULT_OUT = Path("demo_output")


def demo(
    bag: Annotated[
        Path | None,
        typer.Option("--bag", metavar="BAG", help="Recording; default: the shipped walk of test 1."),
    ] = None,
    rate: Annotated[float, typer.Option("--rate", metavar="R", min=0.1, max=20.0, help="Times as fast.")] = 2.0,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")] = DEFAULT_OUT,
    config: ConfigOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Play a recorded walk to the real nodes, show how well they predict it, write a report page."""
    from ..core.config.files import load_config, save_config
    from ..errors import ComanError
    from ..offline import CONFIG_FILE, SUMMARY_FILE
    from ..output import OutputFolder, to_json
    from ..resources import bag_path, config_path
    from ..ros.runtime.processes import NodeFailed, confine, why_not
    from ..ros.runtime.spin import Stop

    Stop()  # one Ctrl-C ends it; more of them do not keep it from stopping the nodes
    confine()
    if problem := why_not():
        raise ComanError(f"demo: {problem}")
    say_domain()
    from ..report.prediction import write_report
    from ..ros.tools.demo import DemoFailed, run_demo

    path = bag_path("test1") if bag is None else bag
    file = config or config_path()
    settings = load_config(file, "predictor")
    try:
        with OutputFolder(out, force or out == DEFAULT_OUT) as folder, progress("demo") as report:
            result = run_demo(path, settings, file, folder, rate, lambda done, words: report(0.8 * done, words))
            (folder / SUMMARY_FILE).write_text(to_json(result.summary) + "\n", encoding="utf-8")
            save_config(settings, folder / CONFIG_FILE, folder=out)
            write_report(folder, lambda done, words: report(0.8 + 0.2 * done, words))
    except (NodeFailed, DemoFailed) as error:
        print(f"coman: demo failed: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    warn(result.summary["warnings"])
    if json:
        print_json({**result.summary, "report": str(out / "report.html")})
    else:
        _show(result.summary, result.live, out)


def _show(summary: dict[str, Any], live: dict[str, Any], out: Path) -> None:
    rows = [("all", summary["duration_s"], summary)]
    rows += [(name.lower(), summary["phases_s"][name], errors) for name, errors in summary["by_phase"].items()]
    print_table(
        f"{summary['bag']}: RMS error of the COM against what was measured [mm]",
        ["phase", "seconds", *(f"{who} {axis}" for who in ("predicted", "rigid") for axis in "xyz")],
        [
            [
                name,
                f"{seconds:.1f}",
                *by_axis_text(errors["rmse_m"], 1e3, 2),
                *by_axis_text(errors["rmse_rigid_m"], 1e3, 2),
            ]
            for name, seconds, errors in rows
        ],
    )
    nodes = "predictor and trajectory" if live["trajectory_node"] else "predictor (the bag has no plan of a gait)"
    print(f"nodes: {nodes}; {live['predictions']} predictions for {live['joint_states']} joint states through DDS")
    print(f"latency of the predictor: {live['latency']}")
    print(f"written: {out / 'report.html'}")
