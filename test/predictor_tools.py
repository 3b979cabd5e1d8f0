# SPDX-License-Identifier: BSD-3-Clause
"""The predictor on a synthetic walk: its samples and predictions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from robots import bent, robot_of

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Phase, Prediction, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.core.robot.robot import Robot

ROBOT = robot_of("coman")
WEIGHT = 9.81 * ROBOT.mass
PERIOD = 1.4  # [s] double, left, double, right
# Phases change between two samples of 100 Hz, whatever the rate: no dwell.
CONFIG = Config().replaced({"model.trunk_rotation": "without", "support.dwell_on": 0.0, "support.dwell_off": 0.0})
T0 = 10**12


def loads(t: float) -> tuple[float, float]:
    """Shares of the weight: in double support the load passes over, then one leg carries all."""
    left = float(np.interp((t + 1e-9) % PERIOD, [0.0, 0.2, 0.7, 0.9], [0.0, 1.0, 1.0, 0.0]))
    return left, 1.0 - left


WAVES = np.random.default_rng(3).uniform(0.5, 1.0, (2, 12))
BENT = bent(ROBOT, 0.6, 0.03)


def motor(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Smooth motion of all motors."""
    rate = 2.0 * np.pi * WAVES[0] / PERIOD
    return BENT + 0.03 * np.sin(rate * t + 6.0 * WAVES[1]), 0.03 * rate * np.cos(rate * t + 6.0 * WAVES[1])


def sample(t: float, phase_time: float | None = None, **changes) -> Sample:
    """What the sensors would tell; the link side sags a little behind the motors."""
    q, qd = motor(t)
    sag = 0.01 * np.cos(np.arange(12) + 3.0 * t)
    left, right = (
        np.array([0.0, 0.0, share * WEIGHT, 0.0, 0.0, 0.0]) for share in loads(t if phase_time is None else phase_time)
    )
    values = {"q": q + sag, "qd": qd - 0.03 * np.sin(np.arange(12) + 3.0 * t), "motor_q": q, "motor_qd": qd}
    values |= {"left_wrench": left, "right_wrench": right}
    return Sample(T0 + round(t * 1e9), **{**values, **changes})


def run(config: Config = CONFIG, end: float = 3.0, rate: float = 200.0, make=sample, predictor=None):
    predictor = predictor or Predictor(ROBOT, config)
    return [predictor.update(make(i / rate)) for i in range(round(end * rate) + 1)]


def column(predictions, name):
    return np.array([getattr(p, name) for p in predictions])


def in_odom(prediction, name="predicted_com"):
    T = prediction.T_odom_sole
    return T[:3, :3] @ getattr(prediction, name) + T[:3, 3]


def later_predictions(
    bag: str | Path, change: Callable[[Sample], None] = lambda sample: None, seconds: float = 7.0
) -> Iterator[tuple[Prediction, Robot]]:
    """Without horizons, of a walk whose samples are changed, after its first two seconds with a foot on the ground."""
    config = Config().replaced({"prediction.horizons": []})
    with Session(bag, config) as session:
        predictor, first = Predictor(session.robot, config), None
        for sample in session.samples():
            first = first or sample.stamp_ns
            change(sample)
            prediction = predictor.update(sample)
            t = (sample.stamp_ns - first) * 1e-9
            if t > seconds:
                return
            if t > 2.0 and prediction.support.phase != Phase.FLIGHT:
                yield prediction, predictor.robot
