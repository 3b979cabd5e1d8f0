# SPDX-License-Identifier: BSD-3-Clause
"""Reads a status of /diagnostics, and defines the values in it that programs read and write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticStatus

from ...core.base.types import Array
from ...core.evaluation.statistics import AXES, by_axis
from ...core.model.trunk.adaptation import Adapted

_RATE = ": rate [Hz]"
_REJECTED, _LAST = "rejected: ", ": last"
_SKILL = "skill at {} s, {}"
_RESTARTS = "restarts"
_ADAPTED, _STIFFNESS, _ZERO = "adapted ", "stiffness ratio", "zero [rad]"
_SHIFT = "adapted trunk COM {} [m]"
REAL_TIME = "real-time factor"  # of the virtual robot
IN_TIME = "planned deflections in time"  # share of them, since the first one came to the virtual robot


class Level(IntEnum):
    """Severity; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

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
        """Read a message."""
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
        """Skill by horizon and axis, of the horizons with a known skill."""
        keys = {h: {axis: _SKILL.format(h, axis) for axis in AXES} for h in horizons}
        return {
            h: {axis: float(self.values[key]) for axis, key in by.items()}
            for h, by in keys.items()
            if set(by.values()) <= set(self.values)
        }

    def adapted(self) -> dict[str, Adapted]:
        """What `prediction.adapt` has learnt, by joint; nothing: it is off."""
        end = f": {_STIFFNESS}"
        joints = [key.removeprefix(_ADAPTED).removesuffix(end) for key in self.values if key.endswith(end)]
        names = {joint: [f"{_ADAPTED}{joint}: {key}" for key in (_STIFFNESS, _ZERO)] for joint in joints}
        return {joint: Adapted(*(float(self.values[name]) for name in both)) for joint, both in names.items()}

    def restarts(self) -> int:
        """How often the joint states were interrupted or jumped back."""
        return int(self.values.get(_RESTARTS, "0"))


def rate_value(stream: str, rate_hz: float) -> dict[str, float]:
    """The value that `Report.rates` reads."""
    return {stream + _RATE: rate_hz}


def rejected_values(counts: Mapping[str, int], last: Mapping[str, str]) -> dict[str, int | str]:
    """The values that `Report.rejected` reads, and the last message for each reason."""
    values: dict[str, int | str] = {}
    for reason, count in counts.items():
        values[_REJECTED + reason] = count
        values[_REJECTED + reason + _LAST] = last[reason]
    return values


def skill_values(skill: Mapping[str, Array]) -> dict[str, float]:
    """The values that `Report.skill` reads, from the skill (3,) by horizon."""
    return {_SKILL.format(h, axis): value for h, by in skill.items() for axis, value in by_axis(by).items()}


def adapted_values(known: Mapping[str, Adapted], shift: Array) -> dict[str, float]:
    """The values that `Report.adapted` reads, and the shift (2,) [m] of the trunk's COM."""
    of_trunk = {_SHIFT.format(axis): float(value) for axis, value in zip("xy", shift, strict=True)}
    return of_trunk | {
        f"{_ADAPTED}{joint}: {key}": value
        for joint, each in known.items()
        for key, value in zip((_STIFFNESS, _ZERO), each, strict=True)
    }


def restart_value(restarts: int) -> dict[str, int]:
    """The value that `Report.restarts` reads."""
    return {_RESTARTS: restarts}
