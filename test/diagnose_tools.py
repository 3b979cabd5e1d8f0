# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of a diagnosis share: a standing robot's recordings made of formulas, and unknowns of effects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from synthetic import robot

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.unknown import Unknown
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.recording import FEET, RATE, Recording
from coman_reduced_model.diagnose.data.signals import lagged
from coman_reduced_model.diagnose.data.world import World
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import unknowns

SECONDS = 4.0
t = np.arange(0.0, SECONDS, 1.0 / RATE)
JOINT = "LKneeSag"


@cache
def standing() -> tuple[Recording, World]:
    """Straight up on both feet, half of the weight through each sole below the COM; springs under slow torques."""
    world = World.nominal(robot(), Config())
    n, nj = len(t), len(robot().joint_names)
    posture = robot().posture()
    posture.update(np.zeros(nj), np.zeros(nj))
    half = 0.5 * robot().mass * world.gravity
    wrench = {}
    for foot in FEET:
        com, _ = posture.com_in_sole(foot)
        wrench[foot] = np.tile([0.0, 0.0, half, half * com[1], -half * com[0], 0.0], (n, 1))
    tau = 12.0 * np.sin(2.0 * np.pi * (0.3 + 0.02 * np.arange(nj)) * t[:, None] + np.arange(nj))
    q = np.zeros((n, nj))
    motor = np.column_stack(
        [lagged(tau[:, j], world.damping[j] / world.stiffness[j]) / world.stiffness[j] for j in range(nj)]
    )
    recording = Recording(
        "standing", t, q, tau, motor, wrench, np.tile([0.0, 0.0, 1.0], (n, 1)), None, None,
        np.full(n, Phase.DOUBLE), np.full(n, 0.5), np.ones(n, dtype=bool), np.zeros(nj),
        {foot: np.zeros(n) for foot in FEET},
    )  # fmt: skip
    return recording, world


def stretched(change, name: str = JOINT) -> Recording:
    """The standing robot with another stretch (n,) of one joint's spring, for its torque (n,)."""
    recording, _ = standing()
    motor, j = recording.motor_q.copy(), index(name)
    motor[:, j] = change(recording.tau[:, j], motor[:, j])
    return recording.changed(motor_q=motor)


def softened(name: str, factor: float) -> Recording:
    """The same with a spring whose stiffness is `factor` times nominal, by encoders with noise of 0.2 mrad."""
    world, j = standing()[1], index(name)
    k, d = factor * world.stiffness[j], world.damping[j]
    recording = stretched(lambda tau, _: lagged(tau, d / k) / k, name)
    return recording.changed(q=recording.q + 2e-4 * np.random.default_rng(0).standard_normal(recording.q.shape))


def swaying(last: Phase) -> Recording:
    """By its IMU on the edge of a foot, nearly always; on the left foot, on the right one, then `last`."""
    sway = 0.05 * np.sin(2.0 * np.pi * 1.3 * t)
    up = np.column_stack([np.zeros(len(t)), sway, np.ones(len(t))])
    return standing()[0].changed(phase=np.select([t < 1.0, t < 2.0], [Phase.LEFT, Phase.RIGHT], last), up=up)


def residuals(recording: Recording, world: World | None = None) -> dict[str, np.ndarray]:
    return evaluate(recording, world or standing()[1], masks(*standing())).residuals


def unknown(name: str):
    return next(f for f in unknowns(*standing()) if f.name == name)


def rms(values: np.ndarray) -> float:
    assert np.isfinite(values).any()
    return float(np.sqrt(np.nanmean(values**2)))


def index(name: str = JOINT) -> int:
    return robot().joint_names.index(name)


def made_up(effect: str, spread: float, reach: float, **more) -> Unknown:
    where, key = more.pop("where", ""), more.pop("key", "x")
    return Unknown(effect, where, key, "1", lambda r, w, x: (r, w), reach, spread, step=0.1, **more)


# The torques of the standing robot are of no motion: gains of their sensors must not explain that.
EXACT_TORQUES = replace(load_nominal(), widths={**load_nominal().widths, "torque_gain.spread": 1e-6})

FIGURES = [
    made_up("payload", 0.0, 2.0, key="mass"),
    made_up("encoder_bias", 0.3, 1.5, where="knee"),
    made_up("backlash", 0.2, 1.0),
    made_up("", 0.5, 0.5, own=True),
]
