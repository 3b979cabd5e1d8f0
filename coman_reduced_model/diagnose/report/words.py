# SPDX-License-Identifier: BSD-3-Clause
"""The result of a diagnosis in words: sentences, places, channels, figures with their units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

Parameters = Mapping[str, Mapping[str, Any]]

# By effect; `{at}` is the place, `{name}` a parameter with its interval. What is not here lists its parameters.
_SAID = {
    "backlash": "{at} has {width} of backlash",
    "joint_friction": "{at} has {coulomb} of friction",
    "joint_stiffness": "the stiffness of {at} is {scale} of nominal",
    "joint_damping": "the damping of {at} is {scale} of nominal",
    "motor_lag": "the motors lag behind their reference by {time_constant}",
    "transport_delay": "the motors move {delay} after their reference",
    "motor_compliance": "the motors yield under load by {compliance}",
    "payload": "the trunk carries {mass} that the URDF lacks",
    "foot_slip": "{at} slips back by {distance} in each step",
    "touchdown_impact": "each touchdown is a blow of {impulse}",
    "encoder_delay": "the joint states are {delay} late",
    "wrench_delay": "the wrench of {at} is {delay} late",
    "wrench_scale": "the force sensor of {at} reads {scale} of the truth",
}
_LISTED = {
    "com_offset": "the trunk's COM is not where the URDF says, along the axes of robot.base_frame",
    "ground_compliance": "the ground or the soles give way more than usual",
    "ground_slope": "the floor is not level, about the axes of odom",
    "external_force": "something pulls at the trunk, along the axes of odom",
    "wrench_bias": "the force sensor of {at} has an offset, along the axes of its sole",
}
_FEET = {"foot_slip", "wrench_delay", "wrench_scale", "wrench_bias"}
CHANNELS = {
    "spring": "spring law",
    "torque": "joint torque",
    "force": "force balance",
    "moment": "moment balance",
    "feet": "sole against sole",
    "slide": "sole after landing",
    "tilt": "trunk's tilt",
    "plan": "motors against plan",
    "landing": "force at landing",
    "unloaded": "sensor in the air",
    "com": "COM, free run",
}
# What a unit is shown as: name and factor.
_SHOWN = {"rad": ("degrees", 180.0 / math.pi), "m": ("mm", 1e3), "s": ("ms", 1e3), "1": ("%", 100.0)}


def sentence(result: Mapping[str, Any]) -> str:
    """The verdict for a person."""
    if result["verdict"] == "none":
        return "nothing is missing that this data could show"
    if result["verdict"] == "not_excited":
        return "nothing was found, but this recording does not walk: most effects could not show"
    if result["verdict"] == "unknown":
        worst = next(iter(result["too_much"]), "")
        where = f": most of it in the {channel(worst.split('|')[0])}" if worst else ""
        return f"something is missing that no effect of the catalogue explains{where}"
    return "; ".join(effect_sentence(effect) for effect in result["effects"])


def effect_sentence(effect: Mapping[str, Any]) -> str:
    """One effect with its values and their intervals (1.96 standard deviations)."""
    name, parameters = effect["name"], effect["parameters"]
    at = place(effect["where"], name in _FEET)
    told = {key: figure(parameter) for key, parameter in parameters.items()}
    listed = ", ".join(f"{key} {text}" for key, text in told.items())
    if name == "encoder_bias":
        bias = parameters["bias"]
        size = figure({**bias, "value": abs(bias["value"])})
        text = f"the link encoder of {at} reads {size} too {'high' if bias['value'] > 0 else 'low'}"
    elif name == "spring_nonlinearity":
        text = f"the spring of {at} {'hardens' if parameters['cubic']['value'] > 0 else 'softens'} ({listed})"
    elif name in _SAID and all(key in told for key in re.findall(r"{(\w+)}", _SAID[name]) if key != "at"):
        text = _SAID[name].format(at=at, **told)
        if "creep" in told:
            text += f" and creeps below {told['creep']}"
        if name == "payload" and len(told) > 1:
            place_of = ", ".join(f"{key} {value}" for key, value in told.items() if key != "mass")
            text += f" (in robot.base_frame at {place_of})"
    else:
        text = f"{_LISTED.get(name, spaced(name) + ' at {at}').format(at=at)} ({listed})"
    if effect.get("left_out"):
        text += f" (not in the model: {effect['left_out']})"
    if effect["class"]:
        text += f", or another effect of the class {spaced(effect['class'])}, which this data cannot tell from it"
    return text


def figure(parameter: Mapping[str, Any]) -> str:
    """A value with half its interval, in the units of a reader."""
    unit, factor = _SHOWN.get(parameter["unit"], (parameter["unit"], 1.0))
    low, high = parameter["interval"]
    return f"{number(factor * parameter['value'], 0.5 * factor * (high - low))} {unit}"


def number(value: float, half: float) -> str:
    """`value ± half` with two digits of the latter, but no more than three of the value."""
    if not (math.isfinite(half) and half > 0.0) or not 1e-3 < max(abs(value), half) < 1e5:
        return f"{value:.3g} ± {half:.2g}" if half > 0.0 else f"{value:.3g}"
    fine, coarse = (digits - math.floor(math.log10(size)) for digits, size in ((1, half), (2, max(abs(value), half))))
    decimals = max(0, min(fine, coarse))
    return f"{value:.{decimals}f} ± {half:.{decimals}f}"


def shown(value: float, unit: str) -> str:
    """A size in the units of a reader."""
    name, factor = _SHOWN.get(unit, (unit, 1.0))
    return f"{factor * value:.2g} {name}"


def place(where: str, foot: bool = False) -> str:
    """Where an effect sits: `LKneeSag` is "the left knee (LKneeSag)"; names that say nothing stay as they are."""
    if where in ("left", "right"):
        return f"the {where} foot" if foot else f"all joints of the {where} leg"
    if not where:
        return "both feet" if foot else "all joints"
    side = re.match(r"(l|r|left|right)(?=[_A-Z])|(left|right)", where, re.I)
    part = re.search(r"knee|ank|hip", where, re.I)
    if not side or not part:
        return where
    axis = re.search(r"(pitch|sag)|(roll|lat)|(yaw)", where, re.I)
    turn = "" if part[0].lower() == "knee" or not axis else (" pitch", " roll", " yaw")[axis.lastindex - 1]  # type: ignore[operator]
    joint = {"ank": "ankle"}.get(part[0].lower(), part[0].lower())
    return f"the {'left' if side[0].lower().startswith('l') else 'right'} {joint}{turn} ({where})"


def channel(name: str) -> str:
    """`spring/LKneeSag` in words."""
    kind, _, rest = name.partition("/")
    return f"{CHANNELS.get(kind, kind)}, {rest.replace('/', ' ')}" if rest else CHANNELS.get(kind, kind)


def channel_unit(name: str) -> tuple[str, float]:
    """What a channel is shown in, and the factor to it from SI units."""
    kind, _, rest = name.partition("/")
    last = rest.rpartition("/")[2]
    if kind in ("spring", "tilt") or last in ("roll", "pitch", "yaw"):
        return "°", _SHOWN["rad"][1]
    if kind in ("plan", "com", "feet", "slide"):
        return _SHOWN["m"]
    if kind == "landing":
        return "Ns", 1.0
    newton = kind == "force" or (kind == "unloaded" and last.startswith("f"))
    return ("N", 1.0) if newton else ("Nm", 1.0)


def spaced(name: str) -> str:
    """A name of the vocabulary in words."""
    return name.replace("_", " ")
