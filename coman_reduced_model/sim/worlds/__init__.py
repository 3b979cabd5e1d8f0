# SPDX-License-Identifier: BSD-3-Clause
"""Worlds: virtual robots that differ in everything that a user's robot may differ in.

world.py   the record of a world: a virtual robot, its surroundings, its sensors and its gait
kinds.py   the kinds of worlds on each axis: engine, contact, floor, controller, body, gait, sensors, streams,
           imperfections
draw.py    a world from a seed, a kind or a file
run.py     record a world
"""

from __future__ import annotations

from .draw import PLAIN, draw_world, world_for, world_of
from .kinds import AXES, Kind, kind_named
from .run import can_walk, record_world, robot_of
from .world import World, read_world, world_yaml

__all__ = [
    "AXES",
    "PLAIN",
    "Kind",
    "World",
    "can_walk",
    "draw_world",
    "kind_named",
    "read_world",
    "record_world",
    "robot_of",
    "world_for",
    "world_of",
    "world_yaml",
]
