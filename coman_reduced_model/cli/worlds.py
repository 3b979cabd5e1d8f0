# SPDX-License-Identifier: BSD-3-Clause
"""`coman worlds`."""

from __future__ import annotations

from typing import Annotated

import typer
import yaml

from . import complete
from .common import JsonOption, print_json, print_table


def worlds(
    world: Annotated[
        str,
        typer.Argument(
            metavar="[FILE|KIND|SEED]",
            help="Print this world as YAML instead.",
            show_default=False,
            autocompletion=complete.worlds,
        ),
    ] = "",
    json: JsonOption = False,
) -> None:
    """List the kinds of worlds that `coman record --world` and `coman judge` know, or print one world."""
    from ..sim.worlds import AXES, world_of, world_yaml

    if world:
        text = world_yaml(world_of(world))
        if json:
            print_json(yaml.safe_load(text) or {})
        else:
            print(text.rstrip() or "{}")
        return
    if json:
        print_json({axis: {kind.name: kind.sentence for kind in kinds.values()} for axis, kinds in AXES.items()})
        return
    rows = []
    for axis, kinds in AXES.items():
        rows += [[axis if k == 0 else "", kind.name, kind.sentence] for k, kind in enumerate(kinds.values())]
    print_table(
        "kinds of worlds; the first of each axis is the plain virtual robot", ["axis", "kind", ""], rows, words=3
    )
