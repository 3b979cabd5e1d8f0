# SPDX-License-Identifier: BSD-3-Clause
"""The section on the estimate: whether its covariances are as large as its errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ..core.evaluation.statistics import AXES
from .draw import SERIES, legend, new_figure
from .figures import NoData
from .page import Part, Section, Table, Text, picture
from .run import Run
from .verdict import percent

_TRUTH = (
    "NEES: normalised squared error of the estimate at the middles of {steps} steps, by the truth that lies beside "
    "the bag. Position: {position:.1f}, velocity: {velocity:.1f}; 3 is expected. The error of the position is nearly "
    "constant, by zeros of encoders and masses, so a walk is a single draw of it: 0.2 to 9.3 in 95 of 100 walks."
)


def estimate_section(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    """NIS, and with a truth NEES, intervals and the reliability plot."""
    found = summary.get("estimate") or {}
    nis = found.get("nis")
    if nis is None or not math.isfinite(nis):
        return Section("Estimate", [], "estimate")
    text = f"NIS, the normalised innovation squared of the measured COM: {nis:.1f} on average; 3 is expected."
    if found.get("inconsistent"):
        text += f" In {percent(found['inconsistent'])} of the samples it was far larger for seconds (INCONSISTENT)."
    if "tilt_by_imu" in found:
        text += f" Roll and pitch of the trunk are the IMU's in {percent(found['tilt_by_imu'])} of the samples."
    parts: list[Part] = [Text(text)]
    if "reliability" in found:
        values = {"position": found["nees_position"], "velocity": found["nees_velocity"]}
        parts += [
            Text(_TRUTH.format(steps=found["steps"], **values)),
            picture(
                "reliability",
                lambda: reliability(found["reliability"]),
                "Share of errors within intervals of the estimate, against the share that should be.",
                "Reliability, all axes together. Below the diagonal the covariance is too small, above it too large.",
                plots,
            ),
            _intervals(found),
        ]
    return Section("Estimate", parts, "estimate")


def _intervals(found: Mapping[str, Any]) -> Table:
    rows = [
        [name, *(percent(found["within_90"][name][axis]) for axis in AXES)] for name in ("position", "velocity")
    ]  # fmt: skip
    speeds = (("of the estimate", "rmse_velocity_m_s"), ("of encoders alone", "rmse_encoder_velocity_m_s"))
    rows += [
        [f"RMS error of velocity {of} [mm/s]", *(f"{1e3 * found[key][a]:.1f}" for a in AXES)] for of, key in speeds
    ]
    if "ground_velocity_within_90" in found:
        rows.insert(2, ["velocity against the ground", *(percent(found["ground_velocity_within_90"][a]) for a in AXES)])
        rows += [
            [f"RMS error of velocity against the ground {of} [mm/s]", *(f"{1e3 * found[key][a]:.1f}" for a in AXES)]
            for of, key in (
                ("of the estimate", "rmse_ground_velocity_m_s"),
                ("of encoders alone", "rmse_encoder_ground_velocity_m_s"),
            )
        ]
    return Table(["within the 90 % interval", *AXES], [*rows, *_trunk(found)])


def _trunk(found: Mapping[str, Any]) -> list[list[str]]:
    """The rotation of the trunk, about its axes."""
    if "turn_within_90" not in found:
        return []
    shares = (("rotation of the trunk", "turn"), ("its angular velocity", "angular_velocity"))
    errors = (
        ("of the rotation of the trunk [mrad]", "turn_rad"),
        ("of its angular velocity [mrad/s]", "angular_velocity_rad_s"),
    )
    return [
        *([name, *(percent(found["turn_within_90"][key][a]) for a in AXES)] for name, key in shares),
        *(
            [f"RMS error {name}{whose}", *(f"{1e3 * found[f'rmse_{of}{key}'][a]:.1f}" for a in AXES)]
            for name, key in errors
            for whose, of in (("", ""), (", of encoders alone", "encoder_"))
        ),
    ]


def reliability(shares: Mapping[str, Mapping[str, float]]) -> Figure:
    """Share of errors within an interval over the share that should be.

    Args:
        shares: by what is meant, as `position` or a horizon, and level of the interval.
    """
    if not any(shares.values()):
        raise NoData("Nothing was judged.")
    figure, (ax,) = new_figure(1, 1, 4.2)
    ax.plot([0, 100], [0, 100], color="#5b606b", linewidth=0.8, label="as it should be")
    for colour, marker, (name, by) in zip(SERIES, "os^Dvx", shares.items(), strict=False):
        levels = [100.0 * float(level) for level in by]
        ax.plot(levels, [100.0 * share for share in by.values()], color=colour, marker=marker, label=name)
    ax.set(xlabel="interval [%]", ylabel="errors within it [%]", xlim=(0, 100), ylim=(0, 102))
    ax.set_aspect("equal")
    legend(figure, ax)
    return figure
