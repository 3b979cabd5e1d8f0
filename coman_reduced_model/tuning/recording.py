# SPDX-License-Identifier: BSD-3-Clause
"""A bag as what the predictor sees: its samples and the untuned predictions, read once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..bag.session import Session
from ..core.base.types import Prediction, Sample
from ..core.config.schema import OPTIONS, Config
from ..core.predictor import Predictor
from ..core.robot.robot import Robot
from ..errors import ConfigError
from ..progress import Progress, between
from ..topics import TopicNames


@dataclass(frozen=True)
class JoinedBag:
    """One bag, one entry a joint state."""

    bag: Path
    robot: Robot  # as its URDF says: predictors give it the loads of their configurations
    samples: list[Sample]  # as joined: no effect has corrected them
    predictions: list[Prediction]  # by the configuration that it was read with
    warnings: tuple[str, ...]

    def predict(self, config: Config) -> list[Prediction]:
        """What the predictor says with another configuration: the same code on the same samples."""
        predictor = Predictor(self.robot, config)
        return [predictor.update(sample) for sample in self.copies()]

    def copies(self) -> Iterator[Sample]:
        """The samples for a predictor, whose effects may correct them in place."""
        for sample in self.samples:
            arrays: dict[str, Any] = {
                f.name: value.copy() for f in fields(sample) if isinstance(value := getattr(sample, f.name), np.ndarray)
            }
            yield replace(sample, **arrays)


def read_recording(
    path: str | Path,
    config: Config,
    names: TopicNames | None = None,
    urdf: str | Path | None = None,
    progress: Progress | None = None,
) -> JoinedBag:
    """Join and predict a bag.

    Raises:
        ComanError: it cannot be read, lacks a topic, or holds no usable sample.
    """
    samples: list[Sample] = []
    predictions: list[Prediction] = []
    with Session(path, config, urdf=urdf, names=names) as session:
        for batch in session.batches(progress):
            samples += deepcopy(batch) if config.effects else batch  # effects correct samples in place
            predictions += session.pipeline.predict(batch)
        return JoinedBag(Path(path), session.robot, samples, predictions, session.warnings)


def read_all(
    paths: Sequence[Path], config: Config, names: TopicNames, urdf: Path | None, progress: Progress | None
) -> list[JoinedBag]:
    """Several bags, one after the other."""
    found = []
    for number, path in enumerate(paths):
        start, end, title = number / len(paths), (number + 1) / len(paths), f"reading {path.name}"
        part = None if progress is None else between(progress, start, end, title)
        found.append(read_recording(path, config, names, urdf, part))
    return found


def motor_side(config: Config) -> Config:
    """The configuration without effects and horizons, for what is measured at the springs themselves.

    Raises:
        ConfigError: a configuration for a robot without motor encoders.
    """
    if config.prediction.reference == "none":
        raise ConfigError("prediction.reference: none: a robot without motor-side encoders shows no spring deflection")
    paper = {"effects.active": (), **{f"model.{option}": "without" for option in OPTIONS}}
    return config.replaced({**paper, "prediction.horizons": (), "prediction.reference": "motor"})
