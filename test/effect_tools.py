# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of effects share: a configuration with one effect, and predictions of a list of messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from synthetic import LEFT, RIGHT, Message, robot, walk

from coman_reduced_model.core.base.stream_names import JOINTS, MOTORS, REFERENCE
from coman_reduced_model.core.base.types import Foot, Prediction, Sample
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.robot import Robot

PAPER = Config().replaced({"model.trunk_rotation": "without"})


def config(effect: str, where: str = "", base: Config | None = None, **values: float) -> Config:
    """The configuration `base` with one effect more."""
    base = base or PAPER
    active = tuple(dict.fromkeys((*base.flat()["effects.active"], effect)))
    changes = {f"effects.{effect}.{key}": [value] for key, value in values.items()}
    return base.replaced({"effects.active": active, f"effects.{effect}.where": [where], **changes})


def trunk_config() -> Config:
    """With the standard effects."""
    return Config()


def spoilt(change: Callable[[str, Any], Any], seconds: float = 1.0, **options: Any) -> list[Message]:
    """The synthetic walk with each message changed, in the order of the new stamps."""
    messages = [(stream, change(stream, message)) for stream, message in walk(seconds, **options)]
    return sorted(messages, key=lambda item: item[1].stamp_ns)


def predicted(
    messages: Iterable[Message], settings: Config, machine: Robot | None = None
) -> tuple[list[Prediction], Pipeline]:
    pipeline = Pipeline(machine or robot(), settings)
    add = {
        JOINTS: pipeline.joiner.add_joint,
        MOTORS: pipeline.joiner.add_motor,
        REFERENCE: pipeline.joiner.add_reference,
        LEFT: lambda message: pipeline.joiner.add_wrench(Foot.LEFT, message),
        RIGHT: lambda message: pipeline.joiner.add_wrench(Foot.RIGHT, message),
    }
    results = [p for stream, message in messages for p in pipeline.predict(add[stream](message))]
    return results + pipeline.flush(), pipeline


def values(results: Iterable[Prediction], name: str) -> np.ndarray:
    return np.array([getattr(result, name) for result in results])


def same(results: list[Prediction], expected: list[Prediction], tolerance: float) -> None:
    """Assert that two runs agree to a tolerance [m], and that they predicted something."""
    assert [(p.stamp_ns, p.support.phase, p.flags) for p in results] == [
        (p.stamp_ns, p.support.phase, p.flags) for p in expected
    ]
    for name in ("measured_com", "predicted_com", "reference_com", "predicted_tilt"):
        np.testing.assert_allclose(values(results, name), values(expected, name), rtol=0, atol=tolerance, err_msg=name)
    for p, q in zip(results, expected, strict=True):
        ahead = [[h.com for h in side.horizons] for side in (p, q)]
        np.testing.assert_allclose(*ahead, rtol=0, atol=tolerance)
    assert np.isfinite(values(results, "predicted_com")).all(axis=1).sum() > 100


def on_one_leg(stamp_ns: int, q: np.ndarray, motor_q: np.ndarray, machine: Robot | None = None) -> Sample:
    """Standing still on the left leg alone."""
    weight = (machine or robot()).mass * 9.81
    down, still = np.array([0, 0, weight, 0, 0, 0.0]), np.zeros(12)
    return Sample(stamp_ns, q, still, motor_q=motor_q, motor_qd=still, left_wrench=down, right_wrench=np.zeros(6))
