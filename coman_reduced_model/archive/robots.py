# SPDX-License-Identifier: BSD-3-Clause
"""Which robot recorded a bag, and when: by a table, by the bag itself, by its folder."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from datetime import date, datetime, timezone
from fnmatch import fnmatchcase
from pathlib import Path

from ..errors import ConfigError

_EARLIEST = datetime(2000, 1, 1, tzinfo=timezone.utc)  # stamps before are those of a simulation that begins at zero
COLUMNS = ("bag", "robot", "date")


@dataclass(frozen=True)
class RobotRow:
    """A line of a table of robots: a pattern of paths of bags, and what holds for those; empty: not said."""

    bag: str
    robot: str
    date: date | None


def read_robots(path: Path) -> list[RobotRow]:
    """A CSV file with the columns bag, robot and, if wanted, date (YYYY-MM-DD).

    Raises:
        ConfigError: it cannot be read, or a line is not as it should be.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.DictReader(file)
            head = [name.strip() for name in lines.fieldnames or ()]
            lines.fieldnames = head
            if not {"bag", "robot"} <= {*head} or not {*head} <= {*COLUMNS}:
                raise ConfigError(
                    f"{path}: columns {', '.join(head) or 'none'} (wanted: bag, robot, and date if known)"
                )
            return [_row(path, number, line) for number, line in enumerate(lines, 2)]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: is no CSV file: {error}") from None


def _row(path: Path, number: int, line: dict[str, str]) -> RobotRow:
    text = (line.get("date") or "").strip()
    try:
        day = date.fromisoformat(text) if text else None
    except ValueError:
        raise ConfigError(f"{path}: line {number}: date {text!r} (wanted: YYYY-MM-DD)") from None
    return RobotRow((line.get("bag") or "").strip(), (line.get("robot") or "").strip(), day)


def robot_of(bag: str, recorded: str, configured: str, table: list[RobotRow]) -> str:
    """The robot that recorded a bag.

    Args:
        bag: path below the archive.
        recorded: `robot` of the custom data of the recording, or empty.
        configured: robot.name of the configuration, for bags that nothing else says it of.
        table: the first line that fits and names a robot decides.

    Returns:
        Of the table, else as recorded, else the first folder of the path, else as configured.
    """
    listed = next((row.robot for row in table if row.robot and _fits(bag, row.bag)), "")
    first, separator, _ = bag.partition("/")
    return listed or recorded or (first if separator else "") or configured


def date_of(bag: str, start_ns: int | None, table: list[RobotRow]) -> date | None:
    """The day [UTC] of a bag: of the table, else of the first message; None if that has no date."""
    listed = next((row.date for row in table if row.date and _fits(bag, row.bag)), None)
    if listed or start_ns is None:
        return listed
    start = datetime.fromtimestamp(start_ns // 10**9, tz=timezone.utc)
    return start.date() if start > _EARLIEST else None


def period_of(day: date, every: str) -> str:
    """The month (2026-03) or the week (2026-W12) of a day."""
    if every == "month":
        return f"{day:%Y-%m}"
    year, week, _ = day.isocalendar()
    return f"{year}-W{week:02d}"


def _fits(bag: str, pattern: str) -> bool:
    return fnmatchcase(bag, pattern) or bag.startswith(f"{pattern.rstrip('/')}/")
