# SPDX-License-Identifier: BSD-3-Clause
"""`coman report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .common import JsonOption, print_json, progress


def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of `coman predict`.")],
    json: JsonOption = False,
) -> None:
    """Write one self-contained HTML page with plots into the folder of a prediction."""
    from ..report.prediction import write_report

    with progress("drawing") as on_progress:
        page = write_report(directory, on_progress)
    if json:
        print_json({"page": str(page)})
    else:
        print(f"written: {page}")
