# SPDX-License-Identifier: BSD-3-Clause
"""What recordings cannot distinguish, and what would, for the page of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...report.page import Table
from ..inference.isolability import APART
from .words import spaced

_NAMES, _ROWS = 5, 14  # of effects in a sentence, of the table
_MANOEUVRES = 3  # in a sentence


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


def decides(each: Mapping[str, Any]) -> str:
    """What would split a group of effects (of `decides` in diagnosis.json), and what more of a recording would add."""
    names = [spaced(name) for name in each["group"]]
    more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
    best, open_yet = each["again"][0], each["factor"] < APART
    offers = [(one["sentence"], one["factor"]) for one in each["manoeuvres"][:_MANOEUVRES]]
    offers.append((f"{each['seconds']:.0f} s more like {best['bag']}", best["factor"]))
    text = f"To decide between {', '.join(names[:_NAMES])}{more}: "
    text += "; or ".join(f"{offer}: {factor:.1f} nats" for offer, factor in offers)
    text += (
        f". That is the expected log Bayes factor of {names[0]} against what is most like it, once it is done; now it "
        f"is {each['factor']:.1f} nats, and {APART:g} are {'needed' if open_yet else 'enough'}."
    )
    if not open_yet:
        text += (
            f" So if {names[0]} alone were there, it would stand out: look for several effects, or for something else."
        )
    return f"{text} What any other recording would add: coman isolability BAG... --candidate BAG."
