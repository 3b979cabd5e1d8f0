# SPDX-License-Identifier: BSD-3-Clause
"""The noise floor of the residuals: what the sensors' own noise makes of them, which no effect can leak into.

Resolution of the encoders and the fast part of torques and wrenches are noise; a recording with as much of it again,
drawn at random, differs from the recording by the floor. Where sensors seem to have hardly any noise, there is still
their drift, and rigid bodies on flat soles do not explain a walk to a hair's breadth: quiet sensors are taken for
ordinary ones of a good make.
"""

from __future__ import annotations

import numpy as np

from ...core.base.types import Array
from ..data.masks import Masks, parts
from ..data.signals import white, without_noise
from ..physics.balance import State, evaluate

DRAWS = 4
# By law, what the best of sensors leaves [rad, Nm, N, m, Ns]: a simulator whose sensors have no noise at all must not
# make every hair's breadth an effect.
LEAST = {
    "spring": 2e-5, "torque": 0.01, "force": 0.1, "moment": 0.01, "feet": 3e-5, "tilt": 5e-5, "plan": 3e-5,
    "landing": 0.03, "slide": 0.001, "unloaded": 0.005,
}  # fmt: skip
LEAST_FORCE = 0.1  # [N] of a sensor in the air
# The least noise that any sensor is taken to have: shares of the weight, and of the weight times a foot's length; an
# encoder of 13 bits [rad]; the direction of a tilt.
FORCE, TORQUE, COUNT, UP = 0.0035, 0.0006, 2.0 * np.pi / 8192, 3e-4


def least(key: str) -> float:
    """Of a channel or group; zero of one that is not known."""
    law, _, channel = key.partition("|")[0].partition("/")
    return LEAST_FORCE if law == "unloaded" and "/f" in channel else LEAST.get(law, 0.0)


def floor(state: State, where: Masks) -> dict[str, float]:
    """Root mean square of each residual, in single and double support apart, that noise alone would make."""
    rng = np.random.default_rng(0)
    recording, robot = state.recording, state.world.robot
    stride = recording.stride
    force = FORCE * robot.mass * state.world.gravity
    torque = TORQUE * robot.mass * state.world.gravity * robot.config.foot_length
    wrench = np.repeat([force, torque], 3)
    positions = without_noise(recording, state.world).q
    sums: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        noisy = recording.changed(
            q=recording.q + _rounding(positions, np.maximum(recording.count, COUNT), stride, rng),
            tau=None if recording.tau is None else recording.tau + _like(recording.tau, torque, stride, rng),
            wrench={foot: value + _like(value, wrench, stride, rng) for foot, value in recording.wrench.items()},
            up=None if recording.up is None else recording.up + _like(recording.up, UP, stride, rng),
        )
        moved = evaluate(noisy, state.world, where, state).residuals
        for name, value in state.residuals.items():
            for part, chosen in parts(where, name):
                difference = (moved[name] - value)[chosen]
                difference = difference[np.isfinite(difference)]
                if len(difference):
                    sums.setdefault(f"{name}|{part}", []).append(float(np.mean(difference**2)))
    return {key: max(float(np.sqrt(np.mean(values))), least(key)) for key, values in sums.items()}


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
