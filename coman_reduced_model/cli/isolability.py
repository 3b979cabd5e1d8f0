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
)

if TYPE_CHECKING:
    from ..diagnose.inference.isolability import Isolability

_MOST = 999.0  # nats that are printed
_GROUP = 6  # names of a group that are printed


def isolability(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG...", help="Recordings of one robot.")],
    size: Annotated[
        float, typer.Option("--size", min=0.01, max=2.0, help="Of the effects, as a share of what they can reach.")
    ] = 0.5,
    baseline: BaselineOption = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    json: JsonOption = False,
) -> None:
    """Say which effects recordings could show, and which they cannot distinguish."""
    settings = read_config(config, changes)
    from ..diagnose.isolability import as_result
    from ..diagnose.isolability import isolability as run
    from ..topics import TopicNames

    names = TopicNames(namespace, remap or ())
    with progress("comparing") as report:
        found = run(bags, settings, size=size, urdf=urdf, names=names, baseline=baseline or "", progress=report)
    if json:
        print_json(as_result(found))
    else:
        _show(found)


def _show(found: Isolability) -> None:
    from ..diagnose.isolability import by_effect
    from ..diagnose.report.words import figures_of

    best, factors = by_effect(found)
    rows = [
        [f"{n}", found.options[i].effect, found.options[i].where, figures_of(found.options[i].effect, found.sizes[i]),
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
