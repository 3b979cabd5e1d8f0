# SPDX-License-Identifier: BSD-3-Clause
"""`coman export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ConfigError
from .common import ForceOption, JsonOption, UrdfOption, print_json, read_config


def export(
    model: Annotated[Path, typer.Argument(metavar="FILE", help="Parameter file: model.yaml of coman diagnose.")],
    mjcf: Annotated[Path, typer.Option("--mjcf", metavar="FILE", help="Your MuJoCo model of the robot.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The changed model.")],
    urdf: UrdfOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Write what was found into your own MuJoCo model: springs, friction, masses, motor lag, contact of the soles."""
    settings = read_config(model)
    from ..export import export_mjcf
    from ..output import check_file, write_file
    from .config import open_robot

    check_file(out, force)
    if not mjcf.is_file():
        raise ConfigError(f"{mjcf}: no such file")
    robot = open_robot(settings, urdf)
    found = export_mjcf(settings if robot is None else settings.with_joints_of(robot), mjcf, out.absolute().parent)
    write_file(out, found.xml)
    if json:
        print_json({"mjcf": str(out), "written": found.written, "left_out": found.left_out})
        return
    print("\n".join([*found.written, *(f"not written: {line}" for line in found.left_out), f"written: {out}"]))
