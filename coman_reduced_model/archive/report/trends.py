# SPDX-License-Identifier: BSD-3-Clause
"""Questions to the tables of an archive, in SQL, and their answers."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import Any

import duckdb
import numpy as np

from ..change import SURE, Change, find_change
from ..robots import period_of
from ..store import Store
from ..tables import TABLES, read_table

AXES = ("x", "y", "z")
ODD = 3.5  # modified z score from which on a bag is odd: Iglewicz and Hoaglin 1993
FEWEST_USUAL, MORE = 5, 1.2  # and if so many bags say what is usual, and the error is so many times as large
MOST = 30  # bags to look at

_ROBOTS = """
SELECT robot, count(*) AS bags, count(*) FILTER (status NOT IN ('ok', 'damaged')) AS unusable,
    min(date) AS first, max(date) AS last, 1e3 * median(rmse_x_m), 1e3 * median(rmse_y_m), 1e3 * median(rmse_z_m)
FROM bags GROUP BY robot ORDER BY robot
"""
_SERIES = """
SELECT robot, archive, bag, date, rmse_x_m, rmse_y_m, rmse_z_m FROM bags
WHERE date IS NOT NULL AND rmse_x_m > 0 AND rmse_y_m > 0 AND rmse_z_m > 0
QUALIFY row_number() OVER (PARTITION BY robot, coalesce(hash, archive || '/' || bag) ORDER BY date, start_ns, bag) = 1
ORDER BY robot, date, start_ns, bag
"""
_FINDINGS = """
SELECT robot, period, date, status, reason, verdict, effect, place, parameters, evidence, sentence, bags
FROM findings WHERE kind = 'diagnosis' ORDER BY robot, date, effect, place
"""
_EFFECTS = """
WITH diagnosed AS (SELECT DISTINCT robot, date, hash FROM findings WHERE kind = 'diagnosis' AND status = 'ok'),
found AS (SELECT robot, effect, place, min(date) AS first, max(date) AS last, count(DISTINCT hash) AS times
    FROM findings WHERE effect IS NOT NULL GROUP BY robot, effect, place)
SELECT robot, effect, place, first, last, times,
    count(*) FILTER (date < first) AS before, count(*) FILTER (date >= first) AS since
FROM found JOIN diagnosed USING (robot) GROUP BY ALL ORDER BY robot, times DESC, effect, place
"""
_UNUSABLE = """
SELECT robot, bag, date, status, reason FROM bags WHERE status <> 'ok' ORDER BY status <> 'died', robot, bag
"""


@dataclass(frozen=True)
class Series:
    """The bags of a robot in the order of time, with the RMS errors of its free run (n, 3) [m]."""

    robot: str
    bags: list[str]
    dates: list[date]
    errors: Any


@dataclass(frozen=True)
class Changed:
    """The error of a robot along an axis has changed: `change` of its logarithm, over the bags of `series`."""

    series: Series
    axis: str
    change: Change

    @property
    def factor(self) -> float:
        """By which the error has changed."""
        return float(np.exp(self.change.step))

    @property
    def between(self) -> tuple[date, date]:
        """With 95 %: the last day before the change, and the first after it."""
        dates = self.series.dates
        return dates[self.change.earliest - 1], dates[self.change.latest]

    @property
    def since(self) -> date:
        """Day of the first bag after the most probable change."""
        return self.series.dates[self.change.first]

    def __str__(self) -> str:
        low, high = (float(np.exp(each)) for each in (self.change.low, self.change.high))
        return (
            f"{self.series.robot}: error in {self.axis} {self.factor:.2f} times as large ({low:.2f} to {high:.2f}) "
            f"since {self.since} (week {period_of(self.since, 'week')}; 95 %: after {self.between[0]}, by "
            f"{self.between[1]}; {self.change.evidence:.1f} nats)"
        )


@dataclass(frozen=True)
class Trends:
    """Answers: rows of the queries above, series and changes by robot, and the bags to look at with their reasons."""

    robots: list[tuple[Any, ...]]
    series: list[Series]
    changed: list[Changed]
    findings: list[dict[str, Any]]
    effects: list[dict[str, Any]]
    unusable: list[tuple[Any, ...]]
    look: list[tuple[str, str, str, str]]


def ask(uri: str) -> Trends:
    """Read the tables of an archive and ask them everything that the page says.

    Raises:
        BagError: a table is not there, or of a newer version.
    """
    store = Store(uri)
    with duckdb.connect(":memory:", config={"autoinstall_known_extensions": "false"}) as database:
        for table in TABLES:
            database.register(table, read_table(store, table))
        found = database.execute(_SERIES).fetchall()
        series = [_series(robot, found) for robot in sorted({row[0] for row in found})]
        changed = [each for one in series for each in _changes(one)]
        return Trends(
            robots=database.execute(_ROBOTS).fetchall(),
            series=series,
            changed=sorted(changed, key=lambda each: -each.change.evidence),
            findings=_named(database.execute(_FINDINGS)),
            effects=_named(database.execute(_EFFECTS)),
            unusable=database.execute(_UNUSABLE).fetchall(),
            look=look_at(series, changed),
        )


def look_at(series: list[Series], changed: list[Changed]) -> list[tuple[str, str, str, str]]:
    """Robot, bag, day and reason: the first bag after each change, and bags whose errors are odd.

    These are far larger than is usual for the robot, before or after its change.
    """
    found: list[tuple[float, tuple[str, str, str, str]]] = []
    for one in series:
        mine = [each for each in changed if each.series is one]
        for each in mine:
            first = each.change.first
            reason = f"first with another error in {each.axis} ({each.factor:.2f} times)"
            found.append((np.inf, (one.robot, one.bags[first], str(one.dates[first]), reason)))
        for column, axis in enumerate(AXES):
            edges = sorted({0, *(each.change.first for each in mine if each.axis == axis), len(one.bags)})
            for start, end in zip(edges, edges[1:], strict=False):
                logs = np.log(one.errors[start:end, column])
                usual = float(np.exp(np.median(logs)))
                for i, score in enumerate(odd(logs), start):
                    size = one.errors[i, column]
                    if len(logs) >= FEWEST_USUAL and score > ODD and size > MORE * usual:
                        reason = f"error in {axis} {1e3 * size:.2f} mm, usual {1e3 * usual:.2f}"
                        found.append((score, (one.robot, one.bags[i], str(one.dates[i]), reason)))
    return [row for _, row in sorted(found, key=lambda item: (-item[0], item[1]))][:MOST]


def odd(values: Any) -> Any:
    """(n,) Modified z scores of values that are too large: distance from the median by the scaled median deviation."""
    middle = np.median(values)
    spread = 1.4826 * np.median(np.abs(values - middle))
    return (values - middle) / spread if spread > 0.0 else np.zeros(len(values))


def _series(robot: str, rows: list[tuple[Any, ...]]) -> Series:
    mine = [row for row in rows if row[0] == robot]
    errors = np.array([row[4:] for row in mine], dtype=float)
    return Series(robot, [row[2] for row in mine], [row[3] for row in mine], errors)


def _changes(series: Series) -> list[Changed]:
    found = []
    for column, axis in enumerate(AXES):
        change = find_change(np.log(series.errors[:, column]))
        if change is not None and change.evidence > SURE:
            found.append(Changed(series, axis, change))
    return found


def _named(result: Any) -> list[dict[str, Any]]:
    names = [column[0] for column in result.description]
    return [dict(zip(names, row, strict=True)) for row in result.fetchall()]
