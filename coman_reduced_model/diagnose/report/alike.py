# SPDX-License-Identifier: BSD-3-Clause
"""What recordings cannot distinguish, for the page of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...report.page import Table
from .words import spaced

_NAMES, _ROWS = 5, 14  # of effects in a sentence, of the table


def taken_for(effect: Mapping[str, Any]) -> str:
    """A sentence on what an effect could be taken for; "" where nothing else looks like it."""
    alike = [spaced(each["name"]) + (f" of {each['where']}" if each["where"] else "") for each in effect["taken_for"]]
    return f" Recordings like these cannot distinguish it from: {', '.join(alike[:_NAMES])}." if alike else ""


def groups(result: Mapping[str, Any]) -> list[Table]:
    """The groups of effects that look alike in these recordings; empty without any."""
    rows = [[", ".join(spaced(name) for name in group)] for group in result["groups"]]
    if not rows:
        return []
    caption = (
        "Effects of half their usual reach that recordings like these show, and cannot distinguish: their "
        "expected log Bayes factor is below 3 nats."
    )
    title = "What these recordings cannot distinguish"
    return [Table(["cannot be distinguished"], rows[:_ROWS], caption, words=1, folded=title)]
