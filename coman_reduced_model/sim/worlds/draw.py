# SPDX-License-Identifier: BSD-3-Clause
"""A world from a seed, a kind or a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ConfigError
from ..robot_table import ROBOTS
from ..sensors import SensorOptions
from .kinds import AXES, kind_named
from .world import World, read_world

PLAIN = "plain"  # the virtual robot without anything unusual: the first kind of each axis
ROBOT_CHOICES = ("coman", "coman", "tall", "small")


def draw_world(seed: int, fixed: Mapping[str, str] | None = None) -> World:
    """Draw a world.

    Args:
        seed: not negative; the same seed gives the same world.
        fixed: by axis, a kind that is given instead of drawn; where only one engine has it, the engine is that one.

    Raises:
        ConfigError: there is no such axis or kind, or two given kinds need different engines.
    """
    fixed = _with_engine(fixed or {})
    rng = np.random.default_rng([21, seed])
    sensors = SensorOptions(wrench_average=True)
    world = World(seed=seed, robot=str(rng.choice(ROBOT_CHOICES)), sensors=sensors)
    chosen: dict[str, str] = {}
    for number, (axis, kinds) in enumerate(AXES.items()):
        own = np.random.default_rng([22, seed, number])  # to fix one axis leaves the others as they were
        able = [kind for kind in kinds.values() if kind.only_engine in ("", world.engine)]
        weights = np.array([kind.weight for kind in able])
        drawn = str(own.choice([kind.name for kind in able], p=weights / weights.sum()))
        name = fixed.get(axis, drawn)
        chosen[axis] = name
        world = replace(world, **kinds[name].draw(own, world))
    return replace(world, kinds=chosen)


def _with_engine(fixed: Mapping[str, str]) -> dict[str, str]:
    """Kinds that are given, by axis, and the engine that they need.

    Raises:
        ConfigError: see draw_world.
    """
    needed: dict[str, str] = {}  # by engine, the first kind that needs it
    for axis, kind in fixed.items():
        if kind not in AXES.get(axis, {}):
            raise ConfigError(f"world: {axis}: {kind!r}: unknown (allowed: {', '.join(AXES.get(axis, AXES))})")
        if engine := kind if axis == "engine" else AXES[axis][kind].only_engine:
            needed.setdefault(engine, kind)
    if len(needed) > 1:
        kinds, engines = " and ".join(needed.values()), " and ".join(needed)
        raise ConfigError(f"world: {kinds} exclude each other: they need the engines {engines}")
    return {**fixed, "engine": next(iter(needed))} if needed else dict(fixed)


def plain_kinds() -> dict[str, str]:
    """The first kind of each axis."""
    return {axis: next(iter(kinds)) for axis, kinds in AXES.items()}


def world_for(robot: str, text: str) -> World:
    """The world that a user names, for a robot that is configured.

    Raises:
        ConfigError: see world_of; or the robot of the world is another one.
    """
    world = world_of(text)
    if robot in ROBOTS and robot != world.robot:
        raise ConfigError(f"world {text}: its robot is {world.robot}, and robot.name is {robot} (coman worlds {text})")
    return world


def world_of(text: str) -> World:
    """The world that a user names: a file, a kind, or a seed.

    A kind stands for the plain virtual robot but for that one axis.

    Raises:
        ConfigError: none of these.
    """
    if text.isdigit():
        return draw_world(int(text))
    if text == PLAIN:
        return draw_world(0, plain_kinds())
    if Path(text).suffix in (".yaml", ".yml") or Path(text).is_file():
        return read_world(text)
    axis, _ = kind_named(text)
    return draw_world(0, {**plain_kinds(), axis: text})
