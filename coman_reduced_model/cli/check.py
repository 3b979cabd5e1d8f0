# SPDX-License-Identifier: BSD-3-Clause
"""`coman check`."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from typing import TYPE_CHECKING

from .common import (
    BagArgument,
    ConfigOption,
    JsonOption,
    NamespaceOption,
    RemapOption,
    SetOption,
    UrdfOption,
    print_json,
    progress,
    read_config,
)

if TYPE_CHECKING:
    from ..check import Checked


def check(
    bag: BagArgument,
    config: ConfigOption = None,
    changes: SetOption = None,
    urdf: UrdfOption = None,
    namespace: NamespaceOption = "",
    remap: RemapOption = None,
    json: JsonOption = False,
) -> None:
    """Say what a bag holds and what looks wrong in it: streams, rates, units, signs, sides, clocks, zeros, IMU."""
    settings = read_config(config, changes).replaced({"prediction.horizons": []})
    from ..bag.session import Session
    from ..check import check_bag
    from ..topics import TopicNames

    names = TopicNames(namespace, remap or ())
    with Session(bag, settings, urdf=urdf, names=names) as session, progress("checking") as report:
        found = check_bag(session, report)
    if json:
        print_json(asdict(found))
    else:
        print("\n".join(_lines(found)))


def _lines(found: Checked) -> list[str]:
    from ..core.base.stream_names import CONTACTS

    robot = found.robot
    facts = [f"robot: {robot['name']}", f"{robot['mass_kg']:.1f} kg", f"{robot['joints']} joints"]
    lines = [", ".join([*facts, *_joints(found)])]
    if robot["mimic"]:
        lines.append(f"<mimic> joints, which the model takes as free: {', '.join(robot['mimic'])}")
    for name, stream in found.streams.items():
        if stream["received"]:
            rate = f"{stream['rate_hz']:.0f} Hz" if isfinite(stream["rate_hz"]) else "none usable"
            lines.append(f"{name}: {stream['received']} messages, {rate}")
        elif stream["needed"] or name != CONTACTS:  # few robots have these, and only some need them
            lines.append(f"{name}: none{', but needed' if stream['needed'] else ''}")
    if found.wrench_source != "sensors":
        lines.append(f"foot wrenches: computed from {found.wrench_source}, no force sensor is looked at")
    if found.weight is not None:
        lines.append(f"weight: both feet read {100.0 * found.weight:.0f} % of it on average")
    if found.seconds:
        shares = ", ".join(f"{name.lower()} {100.0 * s / found.seconds:.0f} %" for name, s in found.phases.items())
        lines.append(f"support: {shares}, of {found.seconds:.1f} s")
    for reason, (count, sentence) in found.rejected.items():
        lines.append(f"rejected: {count} x {reason}: {sentence}")
    return [*lines, *(f"wrong? {each}" for each in found.wrong)] if found.wrong else [*lines, "nothing looks wrong"]


def _joints(found: Checked) -> list[str]:
    """Which joints the messages hold; nothing where none of them is usable."""
    if not found.seconds:
        return []
    missing, unknown = found.robot["unlisted"], found.robot["unknown"]
    words = [f"not in messages, held at zero: {', '.join(missing)}"] if missing else ["all of them in the messages"]
    return ["; ".join([*words, *([f"not in the URDF, ignored: {', '.join(unknown)}"] if unknown else [])])]
