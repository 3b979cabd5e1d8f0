# SPDX-License-Identifier: BSD-3-Clause
"""`coman config`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .common import JsonOption, SetOption, print_json, read_config


def config(
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Default: the shipped coman.yaml.")] = None,
    changes: SetOption = None,
    node: Annotated[str, typer.Option("--node", help="Whose section of the file counts, besides '/**'.")] = "predictor",
    json: JsonOption = False,
) -> None:
    """Check a parameter file and print all parameters as they then are, with units and meanings."""
    settings = read_config(file, changes, node)
    if json:
        print_json(settings.flat())
        return
    from ..core.config.files import config_to_yaml

    print(config_to_yaml(settings), end="")
