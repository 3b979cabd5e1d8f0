# SPDX-License-Identifier: BSD-3-Clause
"""What looks wrong with the input: a kind for programs, a sentence for people."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class WarningKind(Enum):
    """What is wrong."""

    MISSING = "no usable message, without which nothing is predicted"
    STOPPED = "a stream has stopped while the joint states go on"
    CLOCK = "the clock of a stream differs from that of the joint states"
    NO_USE = "a parameter has no effect with the chosen model"
    BASELINE = "the baseline of the monitor is of another robot"
    SIGN = "forces, torques, positions or accelerations of the wrong sign"
    SWAPPED = "left and right wrench swapped"
    TURNED = "wrenches turned about the vertical"
    UNIT = "values in another unit"
    BIAS = "a wrench that does not vanish in the air"
    HELD = "a sensor gives one value for long"
    ZERO = "a sensor reads so much without load that it was taken off"


@dataclass(frozen=True)
class InputWarning:
    """One thing that looks wrong.

    Attributes:
        kind: what it is.
        stream: where; empty if it is no single stream.
        text: says what was seen and what to look at, in one line.
    """

    kind: WarningKind
    stream: str
    text: str

    @property
    def prevents_diagnosis(self) -> bool:
        """Whether nothing can be learnt about the robot before it is mended."""
        return self.kind in (WarningKind.SIGN, WarningKind.SWAPPED, WarningKind.TURNED, WarningKind.UNIT)

    @property
    def prevents_prediction(self) -> bool:
        """Whether there are no predictions because of it."""
        return self.kind is WarningKind.MISSING

    def __str__(self) -> str:
        return self.text
