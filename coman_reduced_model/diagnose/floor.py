# SPDX-License-Identifier: BSD-3-Clause
"""The noise floor of the residuals: what the sensors' own noise makes of them, which no effect can leak into.

Resolution of the encoders and the fast part of torques and wrenches are noise; a recording with as much of it again,
drawn at random, differs from the recording by the floor.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ..core.types import Array
from .balance import Masks, State, evaluate

DRAWS = 2
# By law, what the best of sensors leaves [rad, Nm, N, m, Ns]: a simulator whose sensors have no noise at all must not
# make every hair's breadth an effect.
LEAST = {
    "spring": 2e-5, "torque": 0.01, "force": 0.1, "moment": 0.01, "feet": 3e-5, "tilt": 5e-5, "plan": 3e-5,
    "landing": 0.03, "slide": 0.001, "unloaded": 0.005,
}  # fmt: skip
LEAST_FORCE = 0.1  # [N] of a sensor in the air


def least(key: str) -> float:
    """Of a channel or group; zero of one that is not known."""
    law, _, channel = key.partition("|")[0].partition("/")
    return LEAST_FORCE if law == "unloaded" and "/f" in channel else LEAST.get(law, 0.0)


def floor(state: State, where: Masks) -> dict[str, float]:
    """Root mean square of each residual, in single and double support apart, that noise alone would make."""
    rng = np.random.default_rng(0)
    recording = state.recording
    sums: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        noisy = recording.changed(
            q=recording.q + recording.count * rng.uniform(-0.5, 0.5, recording.q.shape),
            tau=None if recording.tau is None else recording.tau + _like(recording.tau, rng),
            wrench={foot: value + _like(value, rng) for foot, value in recording.wrench.items()},
            up=None if recording.up is None else recording.up + _like(recording.up, rng),
        )
        moved = evaluate(noisy, state.world, where, state).residuals
        for name, value in state.residuals.items():
            for part, chosen in (("double", where.double), ("single", ~where.double)):
                difference = (moved[name] - value)[chosen]
                difference = difference[np.isfinite(difference)]
                if len(difference):
                    sums.setdefault(f"{name}|{part}", []).append(float(np.mean(difference**2)))
    return {key: max(float(np.sqrt(np.mean(values))), least(key)) for key, values in sums.items()}


def _like(values: Array, rng: np.random.Generator) -> Array:
    """White noise as large as the fastest part of a signal (n, k): its median, which impacts pass by."""
    fast = values - gaussian_filter1d(values, 1.0, axis=0)
    gain = 0.70  # root of the sum of squares of the kernel: what is left of white noise
    sigma = 1.4826 * np.median(np.abs(fast), axis=0) / gain
    return np.asarray(sigma * rng.standard_normal(values.shape))
