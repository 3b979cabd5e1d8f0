# SPDX-License-Identifier: BSD-3-Clause
"""`coman isolability`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .common import (
    BaselineOption,
    ConfigOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_json,
    print_table,
    progress,
    read_config,
    warn,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..diagnose.inference.another import Another
    from ..diagnose.inference.isolability import Isolability

_MOST = 999.0  # nats that are printed
_GROUP = 6  # names of a group that are printed
_PAIRS = 12  # pairs of effects that are printed


def isolability(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Recordings of one robot.")],
    size: Annotated[
        float, typer.Option("--size", min=0.01, max=2.0, help="Of the effects, as a share of what they can reach.")
    ] = 0.5,
    candidate: Annotated[
        list[Path] | None,
        typer.Option(
            "--candidate",
            metavar="BAG",
            help="Another recording, of this robot or of a virtual one with its joints and mass: what 20 s like it "
            "would add. Repeatable.",
        ),
    ] = None,
    baseline: BaselineOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    json: JsonOption = False,
) -> None:
    """Say which effects recordings could show, which they cannot distinguish, and what others would add."""
    settings = read_config(config, changes)
    from ..diagnose.isolability import as_result
    from ..diagnose.isolability import isolability as run
    from ..topics import TopicNames

    names = TopicNames(namespace, remap or ())
    with progress("comparing") as report:
        found, others = run(
            bags,
            settings,
            others=candidate or (),
            size=size,
            urdf=urdf,
            names=names,
            baseline=baseline or "",
            progress=report,
            notice=lambda line: warn([line]),
        )
    if json:
        print_json(as_result(found, others))
        return
    _show(found)
    if others:
        _show_others(found, others)


def _show(found: Isolability) -> None:
    from ..diagnose.isolability import by_effect
    from ..diagnose.report.words import figures_of

    best, factors = by_effect(found)
    rows = [
        [f"{n}", found.options[i].effect, found.options[i].where, figures_of(found.sizes[i], found.units[i]),
         f"{found.shown[i]:.0f}"]
        for n, i in enumerate(best, 1)
    ]  # fmt: skip
    print_table("Effects where they show best [nats against none]", ["", "effect", "where", "size", "evidence"], rows)
    print("Expected log Bayes factor [nats] of what is so (row) against what it could be taken for (column),")
    print("at its most similar place; below 3 they cannot be distinguished.\n")
    print(" " * 3 + "".join(f"{n:4d}" for n in range(1, len(best) + 1)))
    for n, row in enumerate(factors, 1):
        print(f"{n:3d}" + "".join("   ." if each != each else f"{min(each, _MOST):4.0f}" for each in row))
    names = [option.name for option in found.options]
    print(f"\nCannot be distinguished ({len(found.groups)} groups):")
    for group in found.groups:
        more = f" and {len(group) - _GROUP} more" if len(group) > _GROUP else ""
        print(f"  {', '.join(names[i] for i in group[:_GROUP])}{more}")
    print(f"Would not show: {len(found.hidden)} of {len(names)} effects and places")


def _show_others(found: Isolability, others: Sequence[Another]) -> None:
    from ..diagnose.inference.another import LENGTH
    from ..diagnose.inference.isolability import APART

    pairs, names = found.pairs, [option.name for option in found.options]
    rows = [["", "these alone", "", f"0 of {len(pairs)}", f"{len(found.hidden)}"]]
    rows += [
        [f"{n}", "/".join(Path(each.name).parts[-2:]) + (", again" if each.again else ""), f"{each.lasts:.0f}",
         f"{each.distinguished(pairs)} of {len(pairs)}", f"{len(each.found.hidden)}"]
        for n, each in enumerate(others, 1)
    ]  # fmt: skip
    head = ["", "recording", "lasts [s]", "pairs distinguished", "would not show"]
    print_table(f"\nWith {LENGTH:.0f} s more, like each of these", head, rows, words=2)
    if not pairs:
        return
    with_others = [each.found for each in others]
    rows = [
        [names[pair[0]], names[pair[1]], *(f"{round(each.apart(pair), 1) + 0.0:.1f}" for each in (found, *with_others))]
        for pair in pairs[:_PAIRS]
    ]
    head = ["effect", "or", "alone", *(f"with {n}" for n in range(1, len(others) + 1))]
    title = f"Effects are distinguished from {APART:g} nats on, whichever of both is there [nats]"
    print_table(title, head, rows, words=2)
    if len(pairs) > _PAIRS:
        print(f"and {len(pairs) - _PAIRS} pairs more (--json has all)")
