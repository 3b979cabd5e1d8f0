# SPDX-License-Identifier: BSD-3-Clause
"""`coman config`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .common import JsonOption, SetOption, UrdfOption, print_json, read_config

if TYPE_CHECKING:
    from ..core.config.schema import Config
    from ..core.robot.robot import Robot


def config(
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Default: the shipped coman.yaml.")] = None,
    changes: SetOption = None,
    node: Annotated[str, typer.Option("--node", help="Whose section of the file counts, besides '/**'.")] = "predictor",
    urdf: UrdfOption = None,
    json: JsonOption = False,
) -> None:
    """Check a parameter file, and its robot; print all parameters as they then are, with units and meanings."""
    settings = read_config(file, changes, node)
    robot = open_robot(settings, urdf)
    from ..core.base.nominal import load_nominal

    load_nominal(settings.baseline or "")  # says what is wrong with it
    if robot is not None:
        from ..core.effects.catalogue import build_effects

        settings = settings.with_joints_of(robot)
        build_effects(settings.effects, robot)  # likewise
    if json:
        print_json(settings.flat())
        return
    from ..core.config.files import config_to_yaml

    lines = ["robot: not opened: robot.urdf is empty; --urdf FILE opens it"] if robot is None else describe(robot)
    print("\n".join(f"# {line}" for line in lines))
    print(config_to_yaml(settings), end="")


def open_robot(settings: Config, urdf: Path | None) -> Robot | None:
    """The robot that predict would have: of --urdf, else of robot.urdf; None where the configuration names none.

    Raises:
        ComanError: it cannot be used.
    """
    from ..bag.session import read_urdf
    from ..core.robot.robot import Robot

    path = urdf or settings.urdf
    return None if path is None else Robot(read_urdf(path), settings.robot, str(path))


def describe(robot: Robot) -> list[str]:
    """What the model takes a robot for: mass, COM and soles with all joints at zero [kg, m], a line each."""
    import pinocchio as pin

    from ..core.base.types import Foot
    from ..core.robot.sole import outline

    data = robot.model.createData()
    q = pin.neutral(robot.model)
    pin.framesForwardKinematics(robot.model, data, q)
    com = pin.centerOfMass(robot.model, data, q)
    soles = {foot: data.oMf[robot.sole_ids[foot]] for foot in (Foot.LEFT, Foot.RIGHT)}
    above = soles[Foot.LEFT].actInv(com)
    lines = [
        f"robot: {robot.config.name}, {robot.mass:.2f} kg, {len(robot.joint_names)} joints; with all of them at zero "
        f"the COM is {above[2]:.3f} m above the left sole"
    ]
    for foot, leg in ((Foot.LEFT, robot.config.left), (Foot.RIGHT, robot.config.right)):
        back, front, right, left = robot.soles[foot]
        kind = "by the URDF" if outline(robot.shapes[foot]) is not None else "by foot_length and foot_width"
        lines.append(
            f"{foot.name.lower()}: {' '.join(leg.joints)}; {leg.sole_frame}, {front - back:.3f} x {left - right:.3f} m "
            f"({kind})"
        )
    between = soles[Foot.LEFT].actInv(soles[Foot.RIGHT].translation)
    lines.append(f"soles: {-between[1]:.3f} m apart; the right one {1e3 * between[2]:+.1f} mm higher")
    return lines
