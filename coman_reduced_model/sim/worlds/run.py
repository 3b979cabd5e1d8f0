# SPDX-License-Identifier: BSD-3-Clause
"""Record a world."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...core.gait.gait import WalkPlan
from ...core.gait.parameters import GaitParameters
from ...errors import EngineError
from ...output import check_file
from ...progress import Progress
from ..contact import Floor
from ..disturbances import Disturbance, GroundSlope, Imperfections, Scatter
from ..motion import MotorMotion
from ..record import RecordedBag, plan_recording, record, robot_gait
from ..robot_table import UpperBody
from ..sensors import SensorOptions
from ..upper_motion import UpperMotion
from ..virtual_robot import START_NS, VirtualRobot
from .kinds import GAITS
from .world import World, world_yaml


def clean_variations(world: World) -> list[Disturbance]:
    """What this robot has although it is clean: tolerances, and small imperfections of each joint and sensor."""
    varied: list[Disturbance] = [Scatter(seed=world.seed)] if world.tolerances else []
    if world.imperfections > 0.0:
        varied.append(Imperfections(seed=world.seed, amount=world.imperfections))
    if world.floor.roll or world.floor.pitch:
        varied.append(GroundSlope(roll=world.floor.roll, pitch=world.floor.pitch))
    return varied


def robot_of(
    world: World, hidden: Sequence[Disturbance] = (), seed: int = 0, start_ns: int | None = None
) -> VirtualRobot:
    """The virtual robot of a world.

    Args:
        world: see World.
        hidden: effects beyond what clean robots have.
        seed: of the noise of the sensors.
        start_ns: stamp at t = 0; default: that of VirtualRobot.

    Raises:
        ConfigError: the world is not possible.
    """
    return VirtualRobot(
        world.table,
        _sensors(world),
        [*clean_variations(world), *hidden],
        seed=seed,
        contact=world.contact,
        floor=world.floor,
        controller=world.controller,
        engine=world.engine,
        start_ns=START_NS if start_ns is None else start_ns,
    )


def _sensors(world: World) -> SensorOptions:
    """Those of this robot: their gains are the same in all its recordings."""
    return replace(world.sensors, gains_seed=world.sensors.gains_seed or world.seed + 1)


def with_gait(world: World, kind: str, duration_s: float) -> World:
    """The same world on another gait, by a kind of the axis `gait`."""
    name, changes = GAITS[kind]
    return replace(world, gait=name, gait_changes=dict(changes), duration_s=duration_s)


def record_world(
    world: World,
    out: str | Path,
    hidden: Sequence[Disturbance] = (),
    seed: int = 0,
    force: bool = False,
    progress: Progress | None = None,
    store: bool = True,
) -> RecordedBag:
    """Walk the robot of a world and record the bag `out`, its truth, and the world beside it (`out`.world.yaml).

    Args:
        world: see World.
        out: folder of the bag.
        hidden: effects beyond what clean robots have.
        seed: of the noise of the sensors.
        force: replace what exists.
        progress: called now and then.
        store: write the world beside the bag.

    Raises:
        ConfigError: the world is not possible.
        OutputError: `out` exists, or cannot be written.
    """
    drawn = Path(f"{out}.world.yaml")
    if store:
        check_file(drawn, force)
    result = record(
        _walk(world),
        out,
        robot=world.table,
        sensors=_sensors(world),
        disturbances=[*clean_variations(world), *hidden],
        seed=seed,
        contact=world.contact,
        floor=world.floor,
        controller=world.controller,
        engine=world.engine,
        reference=world.reference,
        planned=planned(world),
        force=force,
        progress=progress,
    )
    if store:
        drawn.write_text(world_yaml(world), encoding="utf-8")
    return result


def can_walk(world: World, out: str | Path, seed: int, **options: Any) -> bool:
    """Record a walk, as `record_world`; False: the robot fell, or its engine could not go on."""
    try:
        return record_world(world, out, seed=seed, **options).fallen_s is None
    except EngineError:
        return False


def _walk(world: World) -> GaitParameters:
    return robot_gait(world.table, world.gait, world.duration_s, **world.gait_changes)


def planned(world: World) -> tuple[MotorMotion, WalkPlan]:
    """Motion of the motors, and the plan with the COM that it was made for; those of the last worlds are kept."""
    shape = replace(world.floor, tile_height=0.0)
    body = world.upper_joints if world.upper_body else None
    return _plan(world.robot, body, world.upper, _walk(world), shape)


@functools.lru_cache(maxsize=64)
def _plan(
    robot: str, body: UpperBody | None, upper: UpperMotion, walk: GaitParameters, floor: Floor
) -> tuple[MotorMotion, WalkPlan]:
    table = World(robot=robot, upper_body=body is not None, upper_joints=body or UpperBody()).table
    return plan_recording(walk, table, upper=upper, floor=floor)
