# SPDX-License-Identifier: BSD-3-Clause
"""The result of a run in one sentence, with the numbers of its summary and nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..core.evaluation.statistics import AXES

# What the ratio of the model's error to the rigid robot's is called. Words only: nothing is decided by them.
_WELL, _PARTLY, _SAME, _EQUAL = 0.5, 0.9, 1.1, 0.005
_REASONS = {
    "NO_REFERENCE": "the configured reference is missing",
    "NO_SUPPORT": "no foot carries the robot by its wrenches",
    "STALE_WRENCH": "the foot wrenches are missing or too old",
    "NOT_INITIALISED": "the prediction never started",
    "REJECTED_STATE": "the prediction diverged and was restarted",
}


def millimetres(metres: float | None) -> str:
    """Metres as a text in mm, three digits or as many as are left; a dash for what is not known."""
    if metres is None or not math.isfinite(metres):
        return "–"
    value = 1e3 * metres
    if abs(value) >= 1e6:
        return f"{value:.2e} mm"
    return f"{value:.0f} mm" if abs(value) >= 99.5 else f"{value:.1f} mm" if abs(value) >= 9.95 else f"{value:.2f} mm"


def percent(share: float) -> str:
    """A share as a text; what is not all is never rounded to 100 %."""
    return f"{min(100.0 * share, 99.9):.3g} %" if share < 1.0 else "100 %"


def sentence(summary: Mapping[str, Any]) -> str:
    """What came out, in one sentence; honest also where the model is worse than nothing, or nothing was predicted."""
    samples, judged = summary.get("samples") or 0, summary.get("judged_samples") or 0
    errors, rigid = summary.get("rmse_m") or {}, summary.get("rmse_rigid_m") or {}
    if not samples:
        return "Nothing was predicted: the recording gave no usable sample."
    if not judged or not any(_known(errors.get(axis)) for axis in AXES):
        return f"Nothing was predicted in {samples} samples: {_why(summary)}."
    if not any(_known(rigid.get(axis)) for axis in AXES):
        text = _without_reference(summary, errors)
    else:
        text = "; ".join(_order([_axis(axis, errors.get(axis), rigid.get(axis)) for axis in AXES]))
    text += "."
    if judged < samples:
        text += f" This covers {percent(judged / samples)} of the samples."
    if diverged := (summary.get("flags") or {}).get("REJECTED_STATE"):
        text += f" A prediction diverged in {percent(diverged / samples)} of the samples."
    return text


def _axis(axis: str, error: float | None, rigid: float | None) -> tuple[float, str]:
    """How the model did against the rigid robot on an axis: ratio, and the clause."""
    if not _known(error) or not _known(rigid):
        return math.inf, f"{axis} is not known"
    assert error is not None and rigid is not None
    ratio = error / rigid if rigid > 0.0 else math.inf if error > 0.0 else 1.0
    mine, other = millimetres(error), millimetres(rigid)
    if abs(ratio - 1.0) <= _EQUAL:
        return ratio, f"{axis} is predicted no differently from a rigid robot ({mine} RMS)"
    if ratio <= _WELL:
        return ratio, f"{axis} is predicted to {mine} RMS where a rigid robot is {other} off"
    if ratio <= _PARTLY:
        return ratio, f"{axis} is explained in part: {mine} RMS against {other} of a rigid robot"
    if ratio <= _SAME:
        return ratio, f"{axis} is no better than a rigid robot: {mine} RMS against {other}"
    return ratio, f"{axis} is not explained: {mine} RMS where a rigid robot is only {other} off"


def _order(clauses: list[tuple[float, str]]) -> list[str]:
    return [text for _, text in sorted(clauses, key=lambda clause: clause[0])]


def _without_reference(summary: Mapping[str, Any], errors: Mapping[str, float | None]) -> str:
    free = ", ".join(f"{axis} {millimetres(errors.get(axis))}" for axis in AXES)
    text = f"the free run is off by {free} RMS; without a reference there is no rigid robot to compare with"
    for horizon, by in (summary.get("horizon_rmse_m") or {}).items():
        ahead, skill = by.get("published") or {}, (summary.get("skill") or {}).get(horizon) or {}
        if any(_known(ahead.get(axis)) for axis in AXES):
            near = ", ".join(f"{axis} to {millimetres(ahead.get(axis))} ({_skill(skill.get(axis))})" for axis in AXES)
            return f"{horizon} s ahead the COM is predicted in {near} RMS (skill against the best baseline); {text}"
    return text[0].upper() + text[1:]


def _skill(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:+.2f}"


def _why(summary: Mapping[str, Any]) -> str:
    flags = summary.get("flags") or {}
    reasons = [text for flag, text in _REASONS.items() if flags.get(flag)]
    return reasons[0] if reasons else "no free run was started"


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
