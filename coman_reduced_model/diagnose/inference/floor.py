# SPDX-License-Identifier: BSD-3-Clause
"""The noise floor of the residuals: what the sensors' own noise makes of them, which no effect can leak into.

Resolution of the encoders and the fast part of torques and wrenches are noise; a recording with as much of it again,
drawn at random, differs from the recording by the floor. Where sensors seem to have hardly any noise, there is still
their drift, and rigid bodies on flat soles do not explain a walk to a hair's breadth: quiet sensors are taken for
ordinary ones of a good make (`floor` and `sensors` of config/nominal.yaml).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...core.base.types import Array
from ..data.masks import Masks, parts
from ..data.signals import white, without_noise
from ..physics.balance import State, evaluate

DRAWS = 4


def least(key: str, floors: Mapping[str, float]) -> float:
    """Of a channel or group, what the best of sensors leaves (`Nominal.floor`); zero of one that is not known."""
    law, _, channel = key.partition("|")[0].partition("/")
    return floors.get("unloaded/f" if law == "unloaded" and "/f" in channel else law, 0.0)


def floor(state: State, where: Masks, floors: Mapping[str, float], sensors: Mapping[str, float]) -> dict[str, float]:
    """Root mean square of each residual, in single and double support apart, that noise alone would make.

    Of the residuals at least `floors`, of the measurements at least that of `sensors` (both of `Nominal`).
    """
    rng = np.random.default_rng(0)
    recording, robot = state.recording, state.world.robot
    stride = recording.stride
    force = sensors["force"] * robot.mass * state.world.gravity
    torque = sensors["moment"] * robot.mass * state.world.gravity * robot.sole_length
    wrench = np.repeat([force, torque], 3)
    positions = without_noise(recording, state.world).q
    sums: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        noisy = recording.changed(
            q=recording.q + _rounding(positions, np.maximum(recording.count, sensors["count"]), stride, rng),
            tau=None if recording.tau is None else recording.tau + _like(recording.tau, torque, stride, rng),
            wrench={foot: value + _like(value, wrench, stride, rng) for foot, value in recording.wrench.items()},
            up=None if recording.up is None else recording.up + _like(recording.up, sensors["tilt"], stride, rng),
        )
        moved = evaluate(noisy, state.world, where, state).residuals
        for name, value in state.residuals.items():
            for part, chosen in parts(where, name):
                difference = (moved[name] - value)[chosen]
                difference = difference[np.isfinite(difference)]
                if len(difference):
                    sums.setdefault(f"{name}|{part}", []).append(float(np.mean(difference**2)))
    return {key: max(float(np.sqrt(np.mean(values))), least(key, floors)) for key, values in sums.items()}


def _rounding(positions: Array, count: Array, stride: int, rng: np.random.Generator) -> Array:
    """Error (n, nj) of encoders that round positions (n, nj) to counts (nj,), which lie anywhere.

    Of a joint that hardly moves it is not white: smoothing leaves it as it is. What is always there is the zero.
    """
    samples = positions[::stride] / count + rng.uniform(0.0, 1.0, positions.shape[1])
    error = count * (np.round(samples) - samples)
    return _between(error - error.mean(axis=0), stride, len(positions))


def _like(values: Array, least: float | Array, stride: int, rng: np.random.Generator) -> Array:
    """White noise as large as that of a signal (n, k), and at least `least`.

    Of a stream that is slower than the grid, every `stride`-th value is a sample, and the others lie between them.
    """
    samples = values[::stride]
    sigma = np.maximum(white(samples), least)
    return _between(sigma * rng.standard_normal(samples.shape), stride, len(values))


def _between(samples: Array, stride: int, n: int) -> Array:
    """(n, k) lines through samples that are `stride` apart."""
    if stride == 1:
        return samples
    at = np.arange(n) / stride
    return np.column_stack([np.interp(at, np.arange(len(samples)), column) for column in samples.T])


def law_of(key: str) -> str:
    """What the residuals of a group share on any robot: `spring|single` of `spring/LKneeSag|single`."""
    channel, _, part = key.partition("|")
    law, _, rest = channel.partition("/")
    if law in ("spring", "torque"):
        return f"{law}|{part}"
    return f"{law}/{rest.rpartition('/')[2][0]}|{part}" if law == "unloaded" else f"{channel}|{part}"


def unit_of(law: str, weight: float, gravity: float) -> float:
    """What figures of a law are given in for robots of any size: weights, weights times m, mass times m/s; else SI."""
    name = law.partition("|")[0]
    if name == "landing/z":
        return weight / gravity
    return weight if name.startswith(("force", "moment", "torque", "unloaded")) else 1.0
