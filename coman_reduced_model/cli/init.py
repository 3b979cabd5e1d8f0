# SPDX-License-Identifier: BSD-3-Clause
"""`coman init`."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from xml.etree import ElementTree

import typer
import yaml

from ..errors import ComanError, ConfigError
from .common import ForceOption, JsonOption, NamespaceOption, RemapOption, print_json, progress, warn

if TYPE_CHECKING:
    from ..bag.topics_of import FoundTopics
    from ..core.robot.discover import Legs
    from ..core.robot.robot import Robot

_STIFF = 60.0  # of weight times leg length [Nm/rad]: stiff drives, 10 kNm/rad for an iCub
_DAMPED = 5e-4  # [s] damping over stiffness
_WHOLE_LEG = 6  # joints
_LONG, _WIDE = 0.3, 0.15  # of the leg's length: a sole


@dataclass
class _Draft:
    """Values by dotted key, and why those that are guesses are what they are."""

    values: dict[str, Any]
    guesses: dict[str, str] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)  # comments of what is known
    notes: list[str] = field(default_factory=list)


def init(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The configuration to write.")],
    urdf: Annotated[
        Path | None, typer.Option("--urdf", metavar="FILE", help="Default: as the bag describes it.")
    ] = None,
    bag: Annotated[
        Path | None, typer.Option("--bag", metavar="BAG", help="A recording: topics, frames and, if it can, springs.")
    ] = None,
    base: Annotated[
        str, typer.Option("--base", metavar="FRAME", help="Trunk; default: the link that both legs hang on.")
    ] = "",
    left: Annotated[str, typer.Option("--left", metavar="FRAME", help="Sole frame of the left leg.")] = "",
    right: Annotated[str, typer.Option("--right", metavar="FRAME", help="Sole frame of the right leg.")] = "",
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Write a configuration for your robot: legs, joints and soles from its URDF, the rest as marked guesses."""
    from ..core.config.schema import config_from_flat
    from ..core.robot.discover import find_legs
    from ..core.robot.robot import Robot
    from ..output import check_file, write_file
    from ..topics import DESCRIPTION, TopicNames

    check_file(out, force)
    if urdf is None and bag is None:
        raise ConfigError("--urdf: no URDF; give its file, or a bag with /robot_description by --bag")
    names = TopicNames(namespace, remap or ())
    text, source = _urdf_text(urdf, bag, names)
    legs = find_legs(text, source, base, left, right)
    draft = _draft(text, source, legs, os.path.relpath(urdf, out.parent) if urdf else "")
    robot = Robot(text, config_from_flat(draft.values, source).robot, source)
    _soles(draft, robot, legs, urdf.parent if urdf else Path())
    _springs(draft, robot)
    found = _from_bag(draft, robot, bag, urdf, out, names) if bag else None
    config = config_from_flat(draft.values, source, out.parent)
    Robot(text, config.robot, source)
    remaps = [f"--remap {each}" for each in found.remaps] if found else []
    if urdf is None and (described := names(DESCRIPTION)) != f"/{DESCRIPTION}":
        remaps.append(f"--remap {DESCRIPTION}:={described}")
    write_file(out, _yaml(draft, source, bag, remaps))
    warn([*legs.notes, *draft.notes])
    result = {"config": str(out), "mass_kg": robot.mass, **draft.values, "guesses": draft.guesses, "remaps": remaps}
    if json:
        print_json({**result, "topics": found.topics if found else {}, "notes": [*legs.notes, *draft.notes]})
    else:
        _show(draft, robot, found, remaps, out)


def _urdf_text(urdf: Path | None, bag: Path | None, names: Any) -> tuple[str, str]:
    """Text of the URDF and where it is from.

    Raises:
        ComanError: there is none.
    """
    from ..bag.reader import Bag
    from ..bag.session import described_urdf, read_urdf

    if urdf is not None:
        return read_urdf(urdf), str(urdf)
    assert bag is not None
    with Bag(bag) as recording:
        return described_urdf(recording, names)


def _draft(text: str, source: str, legs: Legs, urdf: str) -> _Draft:
    values: dict[str, Any] = {
        "robot.name": ElementTree.fromstring(text.strip()).get("name") or "robot",
        "robot.urdf": urdf,
        "robot.base_frame": legs.base_frame,
    }
    for side, chain in (("left", legs.left), ("right", legs.right)):
        count = len(chain.joints)
        if not count:
            raise ConfigError(f"{source}: no movable joint moves {chain.sole_frame!r} alone")
        values[f"robot.{side}.sole_frame"] = chain.sole_frame
        values[f"robot.{side}.joints"] = list(chain.joints)
        values[f"robot.{side}.stiffness"] = [1.0] * count
        values[f"robot.{side}.damping"] = [1.0] * count
    draft = _Draft({**values, "prediction.reference": "none"})
    if len(legs.left.joints) != len(legs.right.joints):
        draft.notes.append("the legs have different numbers of joints: the default model needs equally many")
    draft.guesses["prediction.reference"] = "motor with motor-side positions, topic with a plan on com/reference"
    return draft


def _soles(draft: _Draft, robot: Robot, legs: Legs, folder: Path) -> None:
    """Length and width of the sole: of shapes, else of meshes, else by the length of the leg."""
    from ..core.base.types import Foot
    from ..core.robot.limits import leg_length
    from ..core.robot.sole import mesh_points, outline

    points, what = robot.shapes[Foot.LEFT], "collision shapes of the foot"
    if outline(points) is None:
        points, what = mesh_points(robot.urdf, robot.model, robot.sole_ids[Foot.LEFT], folder), "mesh of the foot"
    edges = outline(points)
    keys = ("robot.foot_length", "robot.foot_width")
    if edges is None:
        size = (_LONG * leg_length(robot), _WIDE * leg_length(robot))
        draft.guesses |= dict.fromkeys(keys, "by the length of the leg: measure the sole")
    else:
        size = (edges[1] - edges[0], edges[3] - edges[2])
        draft.sources |= dict.fromkeys(keys, what)
        below = -float(points[:, 2].min())
        if abs(below) > 0.01:
            draft.notes.append(
                f"the ground is {1e3 * below:.0f} mm below the origin of {legs.left.sole_frame!r} by the {what}: add a "
                "link on the ground to the URDF and give it by --left and --right"
            )
    draft.values |= {key: min(max(round(float(s), 3), 0.01), 1.0) for key, s in zip(keys, size, strict=True)}


def _springs(draft: _Draft, robot: Robot) -> None:
    from ..core.robot.limits import leg_length

    stiffness = float(f"{_STIFF * robot.mass * robot.config.gravity * leg_length(robot):.2g}")
    if min(len(joints) for joints in robot.legs.values()) < _WHOLE_LEG:
        draft.notes.append(
            f"legs of fewer than {_WHOLE_LEG} joints cannot hold the soles flat wherever the trunk is: check with "
            "`coman validate` whether the model predicts better than none (model.trunk_rotation: without is simpler)"
        )
    for side in ("left", "right"):
        count = len(draft.values[f"robot.{side}.joints"])
        draft.values[f"robot.{side}.stiffness"] = [stiffness] * count
        draft.values[f"robot.{side}.damping"] = [float(f"{_DAMPED * stiffness:.2g}")] * count
        draft.guesses[f"robot.{side}.stiffness"] = "stiff drives without springs: data sheet, or coman identify"
        draft.guesses[f"robot.{side}.damping"] = "as the stiffness"


def _from_bag(draft: _Draft, robot: Robot, bag: Path, urdf: Path | None, out: Path, names: Any) -> FoundTopics:
    """Topics, the reference that they allow, and springs where the bag shows them."""
    from ..bag.reader import Bag
    from ..bag.topics_of import find_topics
    from ..core.base.stream_names import MOTORS, REFERENCE
    from ..topics import TopicNames

    with Bag(bag) as recording:
        found = find_topics(recording, robot, names)
    draft.notes += found.notes
    reference = "motor" if MOTORS in found.topics else "topic" if REFERENCE in found.topics else "none"
    draft.values["prediction.reference"] = reference
    del draft.guesses["prediction.reference"]
    draft.sources["prediction.reference"] = {
        "motor": "the bag has motor-side positions",
        "topic": "the bag has a plan and no motor side",
        "none": "the bag has neither motor-side positions nor a plan",
    }[reference]
    if reference == "motor" and found.efforts:
        description = [f"robot_description:={names('robot_description')}"]
        try:
            _identify(draft, bag, urdf, out, TopicNames("", [*found.remaps, *description]))
        except ComanError as error:
            draft.notes.append(f"springs not identified: {error}")
    return found


def _identify(draft: _Draft, bag: Path, urdf: Path | None, out: Path, names: Any) -> None:
    """Replace the guesses of springs by what the bag shows of them."""
    from ..core.config.schema import config_from_flat
    from ..tuning.identify import identified_config, identify
    from ..tuning.recording import motor_side, read_all

    settings = config_from_flat(draft.values, str(bag), out.parent)
    with progress("identifying") as report:
        recordings = read_all([bag], motor_side(settings), names, urdf, report)
        joints = identify(recordings, settings)
    flat = identified_config(settings, joints).flat()
    found = {joint.name: joint for joint in joints}
    for side in ("left", "right"):
        names_of_leg, stiffness = draft.values[f"robot.{side}.joints"], f"robot.{side}.stiffness"
        for kind in ("stiffness", "damping"):
            key = f"robot.{side}.{kind}"
            draft.values[key] = list(flat[key])  # type: ignore[arg-type]
            missing = [name for name in names_of_leg if not getattr(found[name], kind)]
            if not missing:
                del draft.guesses[key]
                draft.sources[key] = f"identified from {bag.name}"
            elif len(missing) < len(names_of_leg):
                draft.guesses[key] = f"{', '.join(missing)}; the others are identified from {bag.name}"
        draft.values[f"robot.{side}.damping"] = [
            value if found[name].damping else float(f"{_DAMPED * k:.2g}")
            for name, value, k in zip(names_of_leg, flat[f"robot.{side}.damping"], draft.values[stiffness], strict=True)  # type: ignore[arg-type]
        ]


def _yaml(draft: _Draft, source: str, bag: Path | None, remaps: list[str]) -> str:
    """A ROS 2 parameter file, each guess with a comment."""
    lines = [
        f"# Written by coman init from {' '.join(source.split())}{f' and {bag}' if bag else ''}.",
        "# Keys that are not here are nominal.",
        "# Check what is marked as a guess.",
        *([f"# The topics of the bag need: {' '.join(remaps)}"] if remaps else []),
        *[f"# note: {' '.join(note.split())}" for note in draft.notes],
        "/**:",
        "  ros__parameters:",
    ]
    before: list[str] = []
    for key in sorted(draft.values, key=lambda k: k.startswith("prediction")):
        *sections, name = key.split(".")
        same = next((i for i, (a, b) in enumerate(zip(before, sections, strict=False)) if a != b), len(before))
        same = min(same, len(sections))
        lines += [f"{'  ' * (i + 2)}{section}:" for i, section in enumerate(sections) if i >= same]
        before = sections
        value = (
            yaml.safe_dump(draft.values[key], default_flow_style=True, width=10**6).removesuffix("...\n").strip("\n")
        )
        comment = f"guess: {draft.guesses[key]}" if key in draft.guesses else draft.sources.get(key, "")
        lines.append(f"{'  ' * (len(sections) + 2)}{name}: {value}{f'  # {comment}' if comment else ''}")
    return "\n".join(lines) + "\n"


def _show(draft: _Draft, robot: Robot, found: FoundTopics | None, remaps: list[str], out: Path) -> None:
    values = draft.values
    print(f"robot: {values['robot.name']}, {robot.mass:.1f} kg, trunk {values['robot.base_frame']}")
    for side in ("left", "right"):
        print(f"{side}: {', '.join(values[f'robot.{side}.joints'])}, sole {values[f'robot.{side}.sole_frame']}")
    where = draft.sources.get("robot.foot_length", "guess")
    print(f"sole: {values['robot.foot_length']:g} x {values['robot.foot_width']:g} m ({where})")
    for stream, topic in (found.topics if found else {}).items():
        frame = found.frames[stream] if found else ""
        print(f"topic: {stream}: {topic}{f', frame {frame}' if frame else ''}")
    for key, why in draft.guesses.items():
        print(f"guess: {key}: {yaml.safe_dump(values[key], default_flow_style=True).split(chr(10))[0]} ({why})")
    print(f"written: {out}{f'; run with {chr(32).join(remaps)}' if remaps else ''}")
