# SPDX-License-Identifier: BSD-3-Clause
"""Physics engines of the virtual robot: one physics step, and what the ground exerts on the feet.

MuJoCo's model and data describe the robot for all engines: disturbances, sensors and truth read poses there, whichever
engine moves it.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence

import mujoco

from ...errors import ConfigError
from ..contact import Contact
from .base import Engine
from .mujoco_engine import MujocoEngine

ENGINES = ("mujoco", "drake")


def check_engine(name: str) -> None:
    """Say that an engine is missing, before the work begins.

    Raises:
        ConfigError: it is not installed.
    """
    if name == "drake" and importlib.util.find_spec("pydrake") is None:
        raise ConfigError("engine: drake is not installed (pip install drake)")


def make_engine(
    name: str, model: mujoco.MjModel, data: mujoco.MjData, feet: Sequence[Sequence[int]], contact: Contact
) -> Engine:
    """An engine by its name.

    Args:
        name: one of ENGINES.
        model: compiled; bodies, joints, springs, geometry of soles and floor.
        data: its state, which the engine moves.
        feet: of the left and the right foot, the bodies on which the ground acts.
        contact: what an engine needs of it beside the model.

    Raises:
        ConfigError: there is no such engine, it is not installed, or it cannot simulate this model.
    """
    if name == "mujoco":
        return MujocoEngine(data, feet)
    if name != "drake":
        raise ConfigError(f"engine: {name!r}: allowed: {', '.join(ENGINES)}")
    check_engine(name)
    from .drake_engine import DrakeEngine

    return DrakeEngine(model, data, feet, contact)


__all__ = ["ENGINES", "Engine", "check_engine", "make_engine"]
