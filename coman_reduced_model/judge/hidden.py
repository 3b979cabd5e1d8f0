# SPDX-License-Identifier: BSD-3-Clause
"""What is hidden in a case, as the diagnosis has its parameters: what it says of them is compared with that."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from ..core.base.types import Array
from ..sim.disturbances.imperfections import Imperfections
from ..sim.worlds.world import World, world_from_yaml

NOMINAL = {"scale": 1.0}  # of every other parameter: 0
UNLIKE = {"hysteresis": ("friction",), "stiffness_drift": ("time",)}  # parameters that the hidden forms do not share
TURNED = {"x": "roll", "y": "pitch", "z": "yaw"}  # of a sensor, by the axis of the hidden turn
# What a robot has of an effect before it is hidden in it: parameter, and names of `Imperfections.drawn`.
ANYWAY = {
    "backlash": ("width", ("play",)),
    "encoder_bias": ("bias", ("encoder_zero",)),
    "motor_lag": ("time_constant", ("lag", "delay")),  # which walks do not distinguish
    "transport_delay": ("delay", ("lag", "delay")),
    "encoder_delay": ("delay", ("link_late",)),
    "wrench_delay": ("delay", ("wrench_late",)),
}


def compared(effect: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of a hidden effect that mean the same in the form that the diagnosis has, by its names."""
    others = UNLIKE.get(str(effect["name"]), ())
    found = {name: value for name, value in effect["parameters"].items() if name not in others}
    if "axis" in found and "angle" in found:
        found[TURNED[found.pop("axis")]] = found.pop("angle")
    return found


def as_fitted(effect: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a hidden effect as the unknowns have them: of a load, its moment about the trunk [kg m]."""
    found = compared(effect)
    if effect["name"] == "payload":
        found |= {key: found[key] * found["mass"] for key in "xyz" if key in found}
    return found


def in_all(answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The hidden effects of an answer, with what their robot has of the same anyway: a diagnosis sees the sum.

    Counted are play, zeros of encoders, lags and delays, slopes, turns and vertical gains of foot sensors; not the
    scatter of springs, dampers and masses.
    """
    if "world" not in answer:
        return [dict(effect) for effect in answer["effects"]]
    return [_in_all(effect, answer["world"]) for effect in answer["effects"]]


def _in_all(effect: Mapping[str, Any], world: str) -> dict[str, Any]:
    found, drawn = _imperfections(world)
    where, values = str(effect["where"] or ""), dict(effect["parameters"])
    parameter, names = ANYWAY.get(effect["name"], ("", ()))
    if parameter in values:
        values[parameter] += sum(_at(drawn[name], where, found) for name in names)
    elif effect["name"] == "ground_slope":
        slope = dict(zip(("roll", "pitch"), map(float, drawn["slope"]), strict=True))
        values = {name: value + slope.get(name, 0.0) for name, value in values.items()}
    elif effect["name"] == "sensor_rotation":
        values["angle"] += _at(drawn["wrench_turn"][:, "xyz".index(values["axis"])], where, found)
    elif effect["name"] == "wrench_scale":
        values["scale"] *= _at(drawn["wrench_gain"][:, 2], where, found)
    return {**effect, "parameters": values}


def _at(values: Any, where: str, world: World) -> float:
    """The mean over the places of an effect: a joint, a foot, the joints of a side, or all of the legs."""
    if np.ndim(values) == 0:
        return float(values)
    legs = [joint.name for joint in world.table.leg_joints()]
    if len(values) == 2:
        places = ["left", "right"]
        chosen = [name == where or not where for name in places]
    else:
        places = [joint.name for joint in world.table.joints()]
        chosen = [name == where or (name in legs and where in ("", _side(name))) for name in places]
    found: Array = np.asarray(values, dtype=float)
    return float(found[np.array(chosen)].mean())


def _side(joint: str) -> str:
    return {"L": "left", "R": "right"}.get(joint[0], "")


@lru_cache(maxsize=8)
def _imperfections(text: str) -> tuple[World, dict[str, Any]]:
    """The world of an answer, and what its robot has of everything."""
    world = world_from_yaml(text)
    return world, Imperfections(seed=world.seed, amount=world.imperfections).drawn(world.table)
