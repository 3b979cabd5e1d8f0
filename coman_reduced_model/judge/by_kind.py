# SPDX-License-Identifier: BSD-3-Clause
"""Figures by kind of world, and on the kinds of worlds that nothing was chosen on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

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


def new_kinds(row: Row) -> list[str]:
    """The kinds of a row's world that nothing was chosen on."""
    return [kind for axis, kind in row["worlds"].items() if not (axis in AXES and AXES[axis][kind].chosen_on)]
