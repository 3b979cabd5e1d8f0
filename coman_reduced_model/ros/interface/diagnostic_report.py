# SPDX-License-Identifier: BSD-3-Clause
"""One status of /diagnostics as it is read back, and the values in it that programs read: written and read here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticStatus

from ...core.base.types import Array
from ...core.evaluation.statistics import AXES, by_axis

_RATE = ": rate [Hz]"
_REJECTED, _LAST = "rejected: ", ": last"
_SKILL = "skill at {} s, {}"
_RESTARTS = "restarts"


class Level(IntEnum):
    """How well something is; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Report:
    """One status: level, sentence and values by name, as text."""

    level: Level = Level.OK
    message: str = ""
    values: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, status: DiagnosticStatus) -> Report:
        """What a message says."""
        return cls(Level(ord(status.level)), status.message, {each.key: each.value for each in status.values})

    def rates(self) -> dict[str, float]:
        """Messages a second, by stream."""
        return {key.removesuffix(_RATE): float(text) for key, text in self.values.items() if key.endswith(_RATE)}

    def rejected(self) -> dict[str, int]:
        """Messages that were not used, by "stream/reason"."""
        return {
            key.removeprefix(_REJECTED): int(text)
            for key, text in self.values.items()
            if key.startswith(_REJECTED) and not key.endswith(_LAST)
        }

    def skill(self, horizons: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """Skill by horizon and axis, of those horizons of which it is known."""
        keys = {h: {axis: _SKILL.format(h, axis) for axis in AXES} for h in horizons}
        return {
            h: {axis: float(self.values[key]) for axis, key in by.items()}
            for h, by in keys.items()
            if set(by.values()) <= set(self.values)
        }

    def restarts(self) -> int:
        """How often the joint states broke off or went back."""
        return int(self.values.get(_RESTARTS, "0"))


def rate_value(stream: str, rate_hz: float) -> dict[str, float]:
    """The value of which `Report.rates` is read."""
    return {stream + _RATE: rate_hz}


def rejected_values(counts: Mapping[str, int], last: Mapping[str, str]) -> dict[str, int | str]:
    """The values of which `Report.rejected` is read, and the last sentence for each reason."""
    values: dict[str, int | str] = {}
    for reason, count in counts.items():
        values[_REJECTED + reason] = count
        values[_REJECTED + reason + _LAST] = last[reason]
    return values


def skill_values(skill: Mapping[str, Array]) -> dict[str, float]:
    """The values of which `Report.skill` is read, from the skill (3,) by horizon."""
    return {_SKILL.format(h, axis): value for h, by in skill.items() for axis, value in by_axis(by).items()}


def restart_value(restarts: int) -> dict[str, int]:
    """The value of which `Report.restarts` is read."""
    return {_RESTARTS: restarts}
