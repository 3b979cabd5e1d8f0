# SPDX-License-Identifier: BSD-3-Clause
"""Texts of the pages of results: tables, figures, the parts of the README that are generated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

AXES = ("x", "y", "z")
BEGIN, END = "<!-- begin: bench/results.py {} -->", "<!-- end -->"


def write_into_readme(path: Path, page: str, text: str) -> None:
    """Replace what stands between the marks of a page in the README."""
    before, mark, rest = path.read_text(encoding="utf-8").partition(BEGIN.format(page))
    _, end, after = rest.partition(END)
    if mark and end:
        path.write_text(f"{before}{mark}\n{text}\n{end}{after}", encoding="utf-8")


def millimetres(by_axis: Mapping[str, float | None]) -> str:
    return ", ".join("-" if by_axis[a] is None else f"{1e3 * by_axis[a]:.2f}" for a in AXES)  # type: ignore[operator]


def value(number: float | None) -> str:
    if number is None or not math.isfinite(number):
        return "-"
    return f"{number:.2f}" if abs(number) < 9.95 else f"{number:.0f}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def trimmed(output: str) -> str:
    return "\n".join(line.rstrip() for line in output.strip().splitlines())


def honest_line(found: Mapping[str, Any]) -> str:
    """What the diagnosis is worth, in one line of the README."""

    def percent(key: str) -> str:
        value = found["workflow"][key]
        return f"{100 * value['share']:.0f} % ({value['hits']} of {value['of']})"

    redrawn, cases = found["redrawn"], sum(found["cases"].values())
    return (
        f"- On virtual robots of [all kinds of worlds](doc/worlds.md), `coman diagnose` gives "
        f"{percent('false_alarms_on_clean')} of clean robots an effect or `unknown`, and names "
        f"{percent('right_on_medium_and_strong')} of medium and strong effects ([by kind](doc/results/judge.md)); "
        f"{redrawn['cases']} of {cases} cases were drawn again because the robot fell, {redrawn['lowered']} have a "
        "lower level than wanted."
    )
