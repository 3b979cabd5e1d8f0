# SPDX-License-Identifier: BSD-3-Clause
"""`coman tune`."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ConfigError
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
    from ..tuning.shares import Share
    from ..tuning.tune import Tuned


def tune(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Recorded walks of one robot.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The tuned configuration.")],
    config: ConfigOption = None,
    changes: SetOption = None,
    parameters: Annotated[
        str,
        typer.Option(
            "--parameters",
            metavar="NAMES",
            help="What to fit, with commas: coefficients (a1 to e2, in stages), joint_stiffness, joint_damping,"
            " friction (model.friction), parameters of effects. Default: what the model of the configuration has.",
        ),
    ] = "",
    steps: Annotated[
        bool,
        typer.Option("--steps", help="Fit over three consecutive steps of each bag, as in the paper; else over all."),
    ] = False,
    stages: Annotated[
        bool, typer.Option("--stages", help="End with the paper's stages, without a fit of all coefficients together.")
    ] = False,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Tune the model on recorded walks: double-support shares, then the paper's coefficients or named parameters."""
    settings = read_config(config, changes).with_urdf(urdf)
    from ..core.config.files import save_config
    from ..output import check_file
    from ..topics import TopicNames
    from ..tuning import tune as tuning
    from ..tuning.parameters import tune_parameters
    from ..tuning.recording import read_all
    from ..tuning.shares import measure_shares, with_shares

    check_file(out, force)
    began = time.perf_counter()
    bare = settings.replaced({"prediction.horizons": (), "prediction.adapt": False})
    names = tuning.chosen(bare, parameters)
    if names and stages:
        raise ConfigError(
            "--stages: of the paper's coefficients, which this does not fit (--set model.trunk_rotation=without)"
        )
    with progress("tuning") as report:
        recordings = read_all(bags, bare, TopicNames(namespace, remap or ()), urdf, lambda f, w: report(0.2 * f, w))
        shares = measure_shares(recordings)
        shared = with_shares(bare.with_joints_of(recordings[0].robot), shares)
        if names:
            tuned = tune_parameters(recordings, shared, names, steps, progress=lambda f, w: report(0.2 + 0.8 * f, w))
        else:
            tuned = tuning.tune_coefficients(
                recordings, shared, steps, not stages, lambda f, w: report(0.2 + 0.8 * f, w)
            )
    warn([f"{recording.bag}: {line}" for recording in recordings for line in recording.warnings])
    final = tuned.config.replaced(
        {"prediction.horizons": settings.prediction.horizons, "prediction.adapt": settings.prediction.adapt}
    )
    save_config(final, out, f"tuned on {', '.join(bag.name for bag in bags)}", force)
    result = _result(tuned, shares, bags, out, time.perf_counter() - began)
    if json:
        print_json(result)
    else:
        _show(result)


def _result(tuned: Tuned, shares: list[Share], bags: list[Path], out: Path, seconds: float) -> dict[str, Any]:
    return {
        "bags": [str(bag) for bag in bags],
        "config": str(out),
        "shares": [
            {
                "axis": s.axis,
                "when": s.when,
                "share": s.whole,
                "interval": list(s.interval),
                "share_as_support_leg": s.leading,
                "interval_as_support_leg": list(s.leading_interval),
                "double_supports": s.double_supports,
                "used": s.usable,
            }
            for s in shares
        ],
        "parameters": {
            p.name: {"before": p.before, "value": p.value, "interval": [p.low, p.high], "notes": list(p.notes)}
            for p in tuned.parameters
        },
        "condition": tuned.condition,
        "stages": tuned.stages,
        "mse_m2": {
            where: {which: getattr(getattr(tuned, which), where) for which in ("rigid", "before", "after")}
            for where in ("steps", "all")
        },
        "elapsed_s": seconds,
    }


def _show(result: dict[str, Any]) -> None:
    if result["shares"]:
        print_table(
            "Share of a leg in double support (Fig. 9), with intervals of 95 %",
            ["force", "of the double support", "interval", "while it is the support leg", "interval"],
            [
                [f"{s['axis']}, {s['when']} its single support", *_share(s, ""), *_share(s, "_as_support_leg")]
                for s in result["shares"]
            ],
        )
    print_table(
        "Tuned parameters, with intervals of 95 %",
        ["parameter", "before", "value", "interval", "notes"],
        [
            [name, f"{p['before']:.3f}", f"{p['value']:.3f}", _interval(*p["interval"]), "; ".join(p["notes"])]
            for name, p in result["parameters"].items()
        ],
    )
    rows = []
    for where, title in (("steps", "three steps"), ("all", "everything")):
        for which in ("rigid", "before", "after"):
            mse = result["mse_m2"][where][which]
            cells = [f"{1e6 * mse[a]:.3f}" if math.isfinite(mse[a]) else "-" for a in "xyz"]
            rms = [f"{1e3 * math.sqrt(mse[a]):.2f}" if math.isfinite(mse[a]) else "-" for a in "xyz"]
            rows.append([f"{title}, {which}", *cells, *rms])
    print_table(
        "Mean squared error (24) [mm^2] and its root [mm]",
        ["over", *(f"MSE {a}" for a in "xyz"), *(f"RMS {a}" for a in "xyz")],
        rows,
    )
    for line in result["stages"]:
        print(line)
    print(f"condition of the problem: {result['condition']:.0f}; {result['elapsed_s']:.1f} s")
    print(f"written: {result['config']}")


def _share(share: dict[str, Any], kind: str) -> list[str]:
    low, high = share["interval" + kind]
    return [f"{share['share' + kind]:.2f}", _interval(low, high, digits=2)]


def _interval(low: float, high: float, digits: int = 3) -> str:
    return f"{low:.{digits}f} .. {high:.{digits}f}" if math.isfinite(high - low) else "unknown"
