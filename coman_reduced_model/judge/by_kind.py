# SPDX-License-Identifier: BSD-3-Clause
"""Figures by kind of world, and the kinds of worlds that something was learnt on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from ..core.base.nominal import Nominal
from ..sim.worlds import AXES

Measured = TypeVar("Measured")
Row = Mapping[str, Any]


def kinds_among(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Axis and kind of all worlds among rows with `worlds`; kinds of axes that are no part of sim/worlds come last."""
    found = {(axis, kind) for row in rows for axis, kind in row["worlds"].items()}
    known = [(axis, kind) for axis, kinds in AXES.items() for kind in kinds]
    return [pair for pair in known if pair in found] + sorted(found.difference(known))


def by_kind(rows: Sequence[Row], measure: Callable[[Sequence[Row]], Measured]) -> dict[str, dict[str, Measured]]:
    """A measure of the rows of each kind: by axis, by kind."""
    out: dict[str, dict[str, Measured]] = {}
    for axis, kind in kinds_among(rows):
        out.setdefault(axis, {})[kind] = measure([row for row in rows if row["worlds"].get(axis) == kind])
    return out


def kinds_of(rows: Sequence[Row], more: Mapping[str, Sequence[str]] | None = None) -> dict[str, list[str]]:
    """By axis, the kinds of all worlds among rows with `worlds`, and `more` of them."""
    others = [{"worlds": {axis: kind}} for axis, kinds in (more or {}).items() for kind in kinds]
    found: dict[str, list[str]] = {}
    for axis, kind in kinds_among([*rows, *others]):
        found.setdefault(axis, []).append(kind)
    return found


def new_kinds(row: Row, nominal: Nominal, part: str = "") -> list[str]:
    """The kinds of a row's world that no weight and no width of the diagnosis, or of a part of it, was learnt on."""
    learnt = nominal.source.get(part, {}).get("kinds") or nominal.source.get("kinds", {})
    known = [(axis, kind) for axis, kind in row["worlds"].items() if kind in AXES.get(axis, ())]  # not `120 s`
    return [kind for axis, kind in known if kind not in learnt.get(axis, ())]


def by_what_was_learnt(
    rows: Sequence[Row], nominal: Nominal, measure: Callable[[Sequence[Row]], Measured], part: str = ""
) -> dict[str, Any]:
    """A measure of the rows with a kind of world that nothing was learnt on, by `nominal.source`, and of all others."""
    new = [new_kinds(row, nominal, part) for row in rows]
    return {
        "new_kinds": sorted({kind for kinds in new for kind in kinds}),
        "some_new_kind": measure([row for row, kinds in zip(rows, new, strict=True) if kinds]),
        "only_learnt_kinds": measure([row for row, kinds in zip(rows, new, strict=True) if not kinds]),
    }
