# SPDX-License-Identifier: BSD-3-Clause
"""`coman view`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ..errors import OutputError
from .common import (
    BagArgument,
    ConfigOption,
    ForceOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_json,
    progress,
    read_config,
    warn,
)


def view(
    bag: BagArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE.rrd", help="Write a file instead of opening the viewer."),
    ] = None,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Show a bag in 3D, predicted as by `coman predict`: robot, COM, soles, predictions ahead and residuals (Rerun)."""
    settings = read_config(config, changes)
    from ..bag.session import Session
    from ..report.view import open_view, rerun, write_view
    from ..topics import TopicNames

    rerun()  # what is not installed is said at once
    if out is not None and out.exists() and not force:
        raise OutputError(f"{out}: exists; --force replaces it")
    names = TopicNames(namespace, remap or ())
    with tempfile.TemporaryDirectory(prefix="coman-view-") as folder:
        path = out or Path(folder) / "view.rrd"
        with Session(bag, settings, urdf=urdf, names=names) as session, progress("predicting") as report:
            samples = write_view(session, path, report)
            warn(session.warnings)
        if out is None:
            open_view(path)
    if json:
        print_json({"samples": samples, "file": str(out) if out else None})
    elif out:
        print(f"written: {out} (to be opened with `rerun {out}`)")
