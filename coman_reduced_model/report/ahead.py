# SPDX-License-Identifier: BSD-3-Clause
"""The section on predictions ahead: how good they were, what they were blended from, and whether they were as sure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

from ..core.evaluation.baselines import best_baseline
from ..core.evaluation.run import Run
from ..core.evaluation.statistics import AXES
from . import figures
from .estimate import reliability
from .page import Notice, Section, Table, picture
from .verdict import millimetres, percent

_PREDICTORS = {"published": "published", "model": "model alone", "clairvoyant": "rigid, knowing its motors' future"}
_NOTE = (
    "Skill: 1 - RMSE of what is published / RMSE of the best baseline. Above 0 it is better than all of them, 1 is "
    "perfect. Within: share of what was published that was within its 90 % interval. Simpler: share of the samples at "
    "which a baseline had lately been better than the model, so that it is (partly) published. A rigid robot that "
    "knows what its motors will do is no baseline: nobody knows that."
)
ByAxis = Mapping[str, float | None]


def ahead_section(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    """Errors by horizon, skill, and the reliability of the intervals; of a live run the skill alone."""
    errors, skill = summary.get("horizon_rmse_m") or {}, summary.get("skill") or {}
    if not errors and skill:  # of a live run, which holds no more
        rows = [[f"{horizon} s", *(_signed(by.get(axis)) for axis in AXES)] for horizon, by in skill.items()]
        return Section("Prediction ahead", [Table(["skill, horizon", *AXES], rows, _NOTE)], "ahead")
    made = picture(
        "horizons",
        lambda: figures.horizon_error(errors),
        "RMS error against the horizon of what is published, of the model alone and of baselines, per axis.",
        "Error of predictions some tenths of a second ahead, all judged on the same samples. "
        "Published: the model and the baselines, blended by how wrong each has lately been. Planned: a rigid robot "
        "whose motors go on as announced, or at their speed. Persistence: the COM keeps its velocity. LIPM: inverted "
        "pendulum about the measured ZMP.",
        plots,
    )
    if isinstance(made, Notice):
        return Section("Prediction ahead", [made], "ahead")
    shares = {
        f"{horizon} s": by
        for horizon, by in (summary.get("reliability") or {}).items()
        if all(_known(share) for share in by.values())
    }
    sure = picture(
        "reliability_ahead",
        lambda: reliability(shares),
        "Share of the errors of predictions ahead within their intervals, against the share that should be.",
        "How sure predictions ahead were, all axes together, judged when the measurement arrived. Below the diagonal "
        "their covariance is too small, above it too large.",
        plots,
    )
    return Section("Prediction ahead", [made, _table(summary), *([sure] if shares else [])], "ahead")


def _table(summary: Mapping[str, Any]) -> Table:
    head = [
        "horizon, axis",
        *(f"{name} [mm]" for name in _PREDICTORS.values()),
        "best baseline [mm]",
        "skill",
        "within",
        "simpler",
    ]
    rows = []
    for horizon, by in summary["horizon_rmse_m"].items():
        skill, within, simpler = (
            (summary.get(key) or {}).get(horizon) or {} for key in ("skill", "within_90", "simpler_share")
        )
        for axis in AXES:
            rows.append([
                f"{horizon} s, {axis}",
                *(millimetres((by.get(name) or {}).get(axis)).removesuffix(" mm") for name in _PREDICTORS),
                _best_baseline(by, axis),
                _signed(skill.get(axis)),
                _share(within.get(axis)),
                _share(simpler.get(axis)),
            ])  # fmt: skip
    note = _NOTE
    if taken_over := (summary.get("flags") or {}).get("SIMPLER_AHEAD"):
        share = percent(taken_over / max(summary.get("samples") or 0, 1))
        note += f" In {share} of the samples a baseline had been better than the model on some axis."
    return Table(head, rows, note)


def _best_baseline(by: Mapping[str, ByAxis], axis: str) -> str:
    """Error in mm, and which."""
    error, name = best_baseline({name: (errors or {}).get(axis) for name, errors in by.items()})
    return f"{millimetres(error).removesuffix(' mm')} ({name})" if name else "–"


def _known(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def _signed(value: float | None) -> str:
    return f"{value:+.2f}" if _known(value) else "–"


def _share(value: float | None) -> str:
    return percent(value) if _known(value) else "–"
