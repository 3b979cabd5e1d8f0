# SPDX-License-Identifier: BSD-3-Clause
"""The page of an archive: which robots changed, since when, what was found in them, and where to look."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ...report.page import Notice, Part, Section, Table, Text, page, picture
from ..robots import period_of
from ..store import Store
from .figures import MOST_ROBOTS, diagnoses_over_time, errors_over_time
from .trends import MOST, Trends, ask

REPORT_FILE = "report.html"


def write_report(uri: str) -> dict[str, Any]:
    """Write report.html, and of a local archive the plots as PNG, beside the tables.

    Returns:
        Where the page is, and the changes in words.

    Raises:
        BagError: the tables are not there, or of a newer version.
        OutputError: the page cannot be written.
    """
    store, trends = Store(uri), ask(uri)
    store.write(REPORT_FILE, archive_page(trends, store.local_path()).encode())
    return {
        "page": store.path(REPORT_FILE) if store.local else f"{uri.rstrip('/')}/{REPORT_FILE}",
        "changes": [str(each) for each in trends.changed],
        "effects": [effect_line(row) for row in trends.effects],
        "look_at": [" ".join(row) for row in trends.look],
        "unusable": len(trends.unusable),
    }


def archive_page(trends: Trends, folder: Path | None = None) -> str:
    """The HTML; plots go as PNG into a folder, if one is given."""
    bags, unusable = (sum(row[i] for row in trends.robots) for i in (1, 2))
    first, last = _ends(trends)
    facts = [("bags", str(bags)), ("unusable", str(unusable)), ("robots", str(len(trends.robots)))]
    facts += [("from", first), ("to", last)] if first else []
    sections = [
        Section("Errors over time", _errors(trends, folder)),
        Section("Effects", _effects(trends, folder)),
        Section("Bags to look at", _look(trends)),
        Section("Bags that are damaged or not usable", _unusable(trends)),
        Section("Robots", _robots(trends)),
    ]
    return page("Archive", lead(trends), sections, facts)


def lead(trends: Trends) -> str:
    """The result in one sentence."""
    parts = []
    for robot in dict.fromkeys(each.series.robot for each in trends.changed):
        best = next(each for each in trends.changed if each.series.robot == robot)
        found = [row for row in trends.effects if row["robot"] == robot and row["first"] >= best.between[0]]
        what = f", {_name(found[0])} found" if found else ""
        week = period_of(best.since, "week")
        parts.append(f"{robot} has changed since week {week} (error in {best.axis} {best.factor:.2f} times{what})")
    if not parts:
        return "No robot's error has changed beyond doubt."
    return "; ".join(parts[:3]) + (f"; and {len(parts) - 3} more robots." if len(parts) > 3 else ".")


def effect_line(row: dict[str, Any]) -> str:
    """An effect of a robot, in words."""
    return (
        f"{row['robot']}: {_name(row)} first in bags from {row['first']} (week {period_of(row['first'], 'week')}), in "
        f"{row['times']} of {row['since']} diagnoses since then and 0 of {row['before']} before"
    )


def _errors(trends: Trends, folder: Path | None) -> list[Part]:
    parts: list[Part] = []
    if trends.changed:
        rows = [
            [each.series.robot, each.axis, f"{each.factor:.2f}", str(each.since), period_of(each.since, "week"),
             f"{each.between[0]}", f"{each.between[1]}", f"{each.change.evidence:.1f}"]
            for each in trends.changed
        ]  # fmt: skip
        head = ["robot", "axis", "factor", "since", "week", "after", "by", "evidence [nats]"]
        parts.append(
            Table(
                head,
                rows,
                "Changes of the error of the free run. Since: day of the first bag after the most probable change; "
                "with 95 % the change is after one day and by the other. Evidence: logarithm of the ratio of the "
                "probabilities of one change and none, counted from 4.6 on, 100 to 1. Bags are taken as independent.",
                words=2,
            )
        )
    else:
        parts.append(Text("No error has changed beyond doubt (100 to 1)."))
    drawn = picture(
        "errors",
        lambda: errors_over_time(trends.series, trends.changed),
        "Error of each robot's bags over time",
        f"RMS error of the free run, a point a bag (at most {MOST_ROBOTS} robots, those with a change first).",
        folder,
    )
    return [*parts, drawn]


def _effects(trends: Trends, folder: Path | None) -> list[Part]:
    rows = [
        [row["robot"], _name(row), str(row["first"]), period_of(row["first"], "week"),
         f"{row['times']} of {row['since']}", f"0 of {row['before']}", _values(trends, row)]
        for row in trends.effects
    ]  # fmt: skip
    parts: list[Part] = []
    if rows:
        head = ["robot", "effect", "first in bags from", "week", "diagnoses since", "before", "parameters, latest"]
        parts.append(Table(head, rows, words=2))
    failed = [row for row in trends.findings if row["status"] != "ok"]
    if failed:
        parts.append(
            Notice(f"{len(failed)} diagnoses had no result: {failed[0]['robot']}: {failed[0]['reason']}", "warn")
        )
    drawn = picture(
        "diagnoses",
        lambda: diagnoses_over_time(trends.findings),
        "Verdicts of each robot's diagnoses over time",
        "A mark a diagnosis, at the day of its first bag.",
        folder,
    )
    return [*parts, drawn]


def _look(trends: Trends) -> list[Part]:
    if not trends.look:
        return [Text("No bag stands out among those of its robot.")]
    return [Table(["robot", "bag", "date", "why"], trends.look, f"The {MOST} most conspicuous at most.", words=4)]


def _unusable(trends: Trends) -> list[Part]:
    if not trends.unusable:
        return []
    rows = [[robot, bag, str(day or "-"), status, reason or ""] for robot, bag, day, status, reason in trends.unusable]
    return [Table(["robot", "bag", "date", "status", "reason"], rows[:MOST], _more(len(rows)), words=5)]


def _robots(trends: Trends) -> list[Part]:
    rows = [
        [robot, str(bags), str(unusable), str(first or "-"), str(last or "-"), *map(_millimetres, errors)]
        for robot, bags, unusable, first, last, *errors in trends.robots
    ]
    head = ["robot", "bags", "unusable", "first", "last", "x [mm]", "y [mm]", "z [mm]"]
    return [Table(head, rows, "Median over the bags of the RMS error of the free run.")]


def _values(trends: Trends, effect: dict[str, Any]) -> str:
    keys = ("robot", "effect", "place")
    mine = [row for row in trends.findings if all(row[key] == effect[key] for key in keys)]
    return ", ".join(
        f"{each['name']} {_number(each['value'])} {each['unit']}".strip() for each in mine[-1]["parameters"]
    )


def _name(row: dict[str, Any]) -> str:
    return f"{row['effect']} {row['place'] or ''}".strip()


def _ends(trends: Trends) -> tuple[str, str]:
    days = [day for row in trends.robots for day in row[3:5] if day is not None]
    return (str(min(days)), str(max(days))) if days else ("", "")


def _more(count: int) -> str:
    return f"{count - MOST} more in bags.parquet." if count > MOST else ""


def _millimetres(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
