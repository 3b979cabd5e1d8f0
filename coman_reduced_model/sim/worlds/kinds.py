# SPDX-License-Identifier: BSD-3-Clause
"""The kinds of worlds, by axis. The first kind of each axis is that of the plain virtual robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import ConfigError
from ..contact import Contact, Floor
from ..controller import Controller
from ..robot_table import UpperBody
from ..upper_motion import UpperMotion
from .world import World

Draw = Callable[[np.random.Generator, World], Mapping[str, Any]]


@dataclass(frozen=True)
class Kind:
    """One kind of world on one axis.

    Attributes:
        name: as in `coman record --world`.
        sentence: what is special about it.
        draw: fields of `World` that it sets, drawn.
        weight: how often it is drawn, beside the others of its axis; 0: only by its name.
        only_engine: the engine that has it; empty: all.
    """

    name: str
    sentence: str
    draw: Draw
    weight: float = 1.0
    only_engine: str = ""


GAITS: dict[str, tuple[str, dict[str, float]]] = {  # name and changes of the gait generator
    **{name: (name, {}) for name in ("test1", "test2", "in_place", "backwards", "turn", "sideways", "wide")},
    "slow": ("test1", {"single_support_s": 0.8}),
    "between": ("test1", {"step_length_m": 0.045, "single_support_s": 0.55}),
    "quick": ("test1", {"single_support_s": 0.4, "double_support_s": 0.15}),
    "changing": ("changing", {}),
}
_GAIT_SENTENCES = {
    "test1": "the first gait of the paper: steps of 3 cm, 0.5 s on one leg",
    "test2": "the second gait of the paper: steps of 6 cm, 0.6 s on one leg",
    "in_place": "steps on the spot",
    "backwards": "steps backwards",
    "turn": "a turn of 6 degrees a step",
    "sideways": "sidesteps",
    "wide": "feet farther apart",
    "slow": "0.8 s on one leg",
    "between": "between the two gaits of the paper",
    "quick": "0.4 s on one leg, 0.15 s on both",
    "changing": "speed and direction change from step to step",
}


def _contact(**drawn: Callable[[np.random.Generator], Any]) -> Draw:
    return lambda rng, world: {"contact": Contact(**{name: draw(rng) for name, draw in drawn.items()})}


def _even(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: round(float(rng.uniform(low, high)), 4)


def _always(value: Any) -> Callable[[np.random.Generator], Any]:
    return lambda rng: value


def _nothing(rng: np.random.Generator, world: World) -> Mapping[str, Any]:
    return {}


def _soft(rng: np.random.Generator, world: World) -> Mapping[str, Any]:
    depth, time = round(float(rng.uniform(0.002, 0.004)), 4), round(float(rng.uniform(0.015, 0.022)), 4)
    modulus = round(float(rng.uniform(1e5, 3e5)))
    return {"contact": Contact(solref=(time, 1.0), solimp=(0.8, 0.95, depth, 0.5, 2.0), modulus=float(modulus))}


def _uneven(rng: np.random.Generator, world: World) -> Mapping[str, Any]:
    height = round(float(rng.uniform(0.001, 0.0025)), 4)
    return {"floor": Floor(tile_height=height, tile_size=0.15, seed=int(rng.integers(1000)))}


def _controller(kind: str, **gains: Callable[[np.random.Generator], float]) -> Draw:
    return lambda rng, world: {"controller": Controller(kind, **{name: draw(rng) for name, draw in gains.items()})}


def _whole_body(rng: np.random.Generator, world: World) -> Mapping[str, Any]:
    motion = UpperMotion(
        arms=round(float(rng.uniform(0.1, 0.4)), 3),
        together=bool(rng.random() < 0.3),
        waist_yaw=round(float(rng.uniform(0.0, 0.12)), 3),
        waist_pitch=round(float(rng.uniform(0.0, 0.03)), 3),
    )
    joints = UpperBody(*(int(rng.integers(low, high + 1)) for low, high in ((1, 3), (3, 6), (1, 3))))
    return {"upper_body": True, "upper": motion, "upper_joints": joints}


def _gait(kind: str) -> Draw:
    name, changes = GAITS[kind]
    return lambda rng, world: {"gait": name, "gait_changes": dict(changes)}


def _sensors(**drawn: Callable[[np.random.Generator], Any]) -> Draw:
    """Sensors drawn; other options of sensors are set by the axis `streams`, which comes later."""
    return lambda rng, world: {"sensors": replace(world.sensors, **{name: draw(rng) for name, draw in drawn.items()})}


def _streams(reference: bool = True, **switches: Any) -> Draw:
    return lambda rng, world: {"reference": reference, "sensors": replace(world.sensors, **switches)}


def _length(low: float, high: float) -> Draw:
    return lambda rng, world: {"duration_s": round(float(rng.uniform(low, high)), 1)}


def _tilted_imu(rng: np.random.Generator, world: World) -> Mapping[str, Any]:
    turn = tuple(round(float(angle), 3) for angle in rng.uniform([-0.3, -0.5, -3.1], [0.3, 0.5, 3.1]))
    return {"imu_turn": turn, "sensors": replace(world.sensors, tilt_bias=0.015)}


def _imperfect(low: float, high: float) -> Draw:
    return lambda rng, world: {"imperfections": round(float(rng.uniform(low, high)), 2)}


_KINDS: dict[str, tuple[Kind, ...]] = {
    "engine": (
        Kind("mujoco", "MuJoCo: soft constraints", _nothing, 3.0),
        Kind("drake", "Drake: rigid soles on a compliant floor; soles hold", lambda rng, world: {"engine": "drake"}),
    ),
    "contact": (
        Kind("firm", "a hard floor; soles creep by tenths of a millimetre a step at most", _nothing),
        Kind(
            "creeping",
            "soles creep by millimetres while the load passes: regularised friction, pyramidal cones",
            _contact(
                cone=_always("pyramidal"),
                impratio=_even(1.0, 2.0),
                solref=lambda rng: (round(float(rng.uniform(0.012, 0.02)), 4), 1.0),
                solimp=_always((0.9, 0.95, 0.001, 0.5, 2.0)),
            ),
            only_engine="mujoco",
        ),
        Kind(
            "holding",
            "soles hold: stiff friction, and a solver step against slip",
            _contact(impratio=_even(50.0, 200.0), noslip_iterations=_always(4), friction=_even(0.6, 1.2)),
        ),
        Kind("soft_soles", "soles give way by a millimetre or two", _soft),
        Kind("slippery", "a coefficient of friction of 0.3 to 0.5", _contact(friction=_even(0.3, 0.5))),
    ),
    "floor": (
        Kind("level", "a level plane", _nothing, 2.0),
        Kind("uneven", "tiles that differ by 1 to 2.5 mm", _uneven),
        Kind("slope", "a slope of 6 degrees uphill and 3 to the left, which the plan knows",
             lambda rng, world: {"floor": Floor(roll=-0.05, pitch=-0.1)}, 0.0, only_engine="mujoco"),
        Kind("steps", "feet at different heights: the left one on a kerb of 5 cm, which the plan knows",
             lambda rng, world: {"floor": Floor(kerb=0.05)}, 0.0, only_engine="mujoco"),
    ),
    "controller": (
        Kind("open_loop", "motors follow their plan, whatever happens", _nothing),
        Kind(
            "imu_control",
            "ankle and hip strategy fed by the IMU: motors leave their plan by some milliradians",
            _controller("imu", ankle=_even(0.08, 0.2), hip=_even(0.08, 0.2), rate=_even(0.12, 0.28)),
        ),
        Kind(
            "feet_control",
            "ankle and hip strategy fed by the foot sensors",
            _controller("feet", ankle=_even(0.04, 0.09), hip=_even(0.04, 0.09), rate=_even(0.04, 0.09)),
        ),
    ),
    "body": (
        Kind("legs", "twelve joints, a rigid trunk", _nothing, 2.0),
        Kind("whole_body", "20 to 30 joints: waist and arms move in step, and a head", _whole_body),
    ),
    "gait": tuple(
        Kind(name, _GAIT_SENTENCES[name], _gait(name), 2.0 if name in ("test1", "test2") else 1.0)
        for name in GAITS
    ),
    "sensors": (
        Kind("usual", "12-bit link encoders, 200 Hz, foot sensors zeroed with care", _nothing),
        Kind(
            "rich",
            "13 to 19 bits, 500 or 1000 Hz, foot sensors as fast, little noise",
            _sensors(
                rate_hz=lambda rng: float(rng.choice([500.0, 1000.0])),
                encoder_bits=lambda rng: int(rng.integers(13, 20)),
                torque_noise=_always(0.02),
                force_noise=_always((0.3, 0.3, 0.5)),
            ),
            0.5,
        ),
        Kind(
            "coarse",
            "10 or 11 bits with white noise, 100 Hz, noisy torques and foot sensors with gains off",
            _sensors(
                rate_hz=_always(100.0),
                encoder_bits=lambda rng: int(rng.integers(10, 12)),
                encoder_noise=_even(1e-4, 5e-4),
                torque_noise=_even(0.1, 0.5),
                torque_bias=_even(0.1, 0.5),
                wrench_gain=_even(0.0, 0.02),
                force_noise=_always((3.0, 3.0, 4.0)),
                moment_noise=_always((0.1, 0.1, 0.08)),
            ),
        ),
        Kind(
            "unzeroed",
            "zeros of the foot sensors of up to 300 N, drifting, with cross-talk",
            _sensors(
                wrench_zero=_even(20.0, 300.0), force_walk=_even(0.1, 1.0), cross_talk=_even(0.0, 0.02),
                wrench_gain=_even(0.0, 0.02),
            ),
        ),
        Kind(
            "slow_feet",
            "joints at 500 Hz, foot sensors at 100 Hz",
            _sensors(rate_hz=_always(500.0), wrench_every=_always(5), imu_every=_always(5)),
            0.5,
        ),
        Kind(
            "deflection_torque",
            "torques are computed from the deflection of the springs by the data sheet",
            _sensors(torque_source=_always("deflection")),
        ),
        Kind("tilted_imu", "an IMU that is mounted otherwise, as the URDF has it, and a degree off", _tilted_imu, 0.5),
    ),
    "streams": (
        Kind("all_streams", "torques, motor states, IMU, reference", _nothing, 2.0),
        Kind("no_reference", "no com/reference", _streams(reference=False)),
        Kind("no_torques", "no joint torques", _streams(effort=False)),
        Kind("no_imu", "no IMU", _streams(imu=False)),
        Kind("no_motors", "no motor states: the springs' other end is unknown", _streams(motor_states=False), 0.5),
        Kind("commanded", "motor states repeat the command", lambda rng, world: {
            "sensors": replace(world.sensors, motor_source="commanded")}),
        Kind("no_foot_sensors", "no foot force sensors, but torques", _streams(wrenches=False), 0.0),
        Kind("contact_switches", "switches under the feet, neither force sensors nor torques",
             _streams(wrenches=False, effort=False, contact_switches=True), 0.0),
        Kind("bare", "neither torques, IMU nor reference", _streams(reference=False, effort=False, imu=False)),
    ),
    "imperfections": (
        Kind("tolerances", "springs, dampers and masses off by some per cent", _nothing, 1.0),
        Kind("imperfect", "all small imperfections at once: play, friction, lag, zeros, gains, clocks, a slope",
             _imperfect(0.6, 1.4), 2.0),
    ),
    "length": (
        Kind("some_seconds", "a training walk of 13 s", _length(13.0, 13.0), 4.0),
        Kind("short", "5 to 9 s", _length(5.0, 9.0)),
        Kind("long", "25 to 60 s", _length(25.0, 60.0), 0.2),
    ),
}  # fmt: skip
AXES: dict[str, dict[str, Kind]] = {axis: {kind.name: kind for kind in kinds} for axis, kinds in _KINDS.items()}


def kind_named(name: str) -> tuple[str, Kind]:
    """Axis and kind of a name.

    Raises:
        ConfigError: no kind has that name.
    """
    for axis, kinds in AXES.items():
        if name in kinds:
            return axis, kinds[name]
    known = ", ".join(kind for kinds in AXES.values() for kind in kinds)
    raise ConfigError(f"world: {name!r}: no file, no seed and no kind (allowed: plain, {known})")
