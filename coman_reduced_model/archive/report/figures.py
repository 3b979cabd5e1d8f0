# SPDX-License-Identifier: BSD-3-Clause
"""Errors of each robot over time with their changes, and what its diagnoses found."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from typing import Any

from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from ...report.draw import FAINT, INK, SERIES, legend, log_ticks, new_figure, title
from ...report.figures import NoData
from .trends import AXES, Changed, Series

MOST_ROBOTS = 12  # on the page; those whose errors have changed come first
_VERDICTS = {"none": ("o", FAINT), "effect": ("s", SERIES[0]), "unknown": ("D", SERIES[1]), "not_excited": ("x", FAINT)}


def errors_over_time(series: Sequence[Series], changed: Sequence[Changed]) -> Figure:
    """A row a robot, a column an axis: a point a bag; a band where a change may lie, a line where it most likely is."""
    if not series:
        raise NoData("No bag with a date was predicted.")
    shown = shown_robots(series, changed)
    figure, plots = new_figure(len(shown), 3, 0.8 + 1.25 * len(shown), sharex=True, sharey="col")
    for row, one in enumerate(shown):
        for column, axis in enumerate(AXES):
            ax = plots[3 * row + column]
            ax.plot(days(one.dates), 1e3 * one.errors[:, column], "o", color=INK, markersize=3, label="a bag")
            for each in changed:
                if each.series is one and each.axis == axis:
                    start, end = days(each.between)
                    ax.axvspan(start, end, color=SERIES[0], alpha=0.18, linewidth=0, label="change, 95 %")
                    ax.axvline(days([each.since])[0], color=SERIES[0], linewidth=1.4, label="first bag after it")
            if row == 0:
                title(ax, f"{axis} [mm]")
        plots[3 * row].set_ylabel(one.robot, rotation=0, ha="right", va="center")
    for ax in plots[:3]:
        log_ticks(ax.yaxis)
    for ax in plots[-3:]:
        _date_axis(ax)
    legend(figure, max(plots, key=lambda ax: len(ax.get_legend_handles_labels()[0])))
    return figure


def diagnoses_over_time(findings: Sequence[dict[str, Any]]) -> Figure:
    """A row a robot, a mark a diagnosis at the day of its first bag; effects by name."""
    judged = [row for row in findings if row["verdict"] in _VERDICTS and row["date"] is not None]
    if not judged:
        raise NoData("Nothing was diagnosed (coman archive --diagnose).")
    robots = sorted({row["robot"] for row in judged})
    figure, (ax,) = new_figure(1, 1, 1.2 + 0.42 * len(robots))
    for verdict, (marker, colour) in _VERDICTS.items():
        mine = [row for row in judged if row["verdict"] == verdict]
        if mine:
            heights = [robots.index(row["robot"]) for row in mine]
            ax.plot(days([row["date"] for row in mine]), heights, marker, color=colour, markersize=6, label=verdict)
    named: set[tuple[str, str]] = set()
    for row in judged:
        name = f"{row['effect']} {row['place'] or ''}".strip()
        if row["effect"] and (row["robot"], name) not in named:
            named.add((row["robot"], name))
            at = days([row["date"]])[0], robots.index(row["robot"])
            above = 5 + 10 * sum(robot == row["robot"] for robot, _ in named) - 10
            ax.annotate(name, at, (6, above), textcoords="offset points", fontsize=9, color=INK)
    ax.set_yticks(range(len(robots)), robots)
    ax.set_ylim(len(robots) - 0.5, -0.8)
    _date_axis(ax)
    legend(figure, ax)
    return figure


def shown_robots(series: Sequence[Series], changed: Sequence[Changed]) -> list[Series]:
    """Those on the page: with a change, the surest first, then by name; in the order of names."""
    first = list(dict.fromkeys(each.series.robot for each in changed))
    names = (first + [one.robot for one in series if one.robot not in first])[:MOST_ROBOTS]
    return [one for one in series if one.robot in names]


def days(dates: Sequence[date]) -> list[float]:
    """As matplotlib counts days."""
    return [float(date2num(day)) for day in dates]


def _date_axis(ax: Axes) -> None:
    locator = AutoDateLocator(minticks=2, maxticks=6)
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
