# SPDX-License-Identifier: BSD-3-Clause
"""A bag as what the predictor sees: its samples and the untuned predictions, read once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from ..bag.reader import Bag
from ..core.config import NOTHING, Config, config_to_yaml
from ..core.pipeline import Pipeline
from ..core.predictor import Predictor
from ..core.robot import Robot
from ..core.types import Prediction, Sample
from ..errors import ConfigError, OutputError
from ..offline import find_robot, input_streams, predictions
from ..topics import TopicNames

Progress = Callable[[float, str], None]  # fraction done, what is being done


@dataclass(frozen=True)
class Recording:
    """One bag, one entry a joint state."""

    bag: Path
    robot: Robot
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
            arrays = {
                f.name: value.copy() for f in fields(sample) if isinstance(value := getattr(sample, f.name), np.ndarray)
            }
            yield replace(sample, **arrays)


def read_recording(
    path: str | Path,
    config: Config,
    names: TopicNames | None = None,
    urdf: str | Path | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Join and predict a bag.

    Raises:
        ComanError: it cannot be read, lacks a topic, or holds no usable sample.
    """
    names = names or TopicNames()
    with Bag(path) as bag:
        streams = input_streams(bag, config, names)
        pipeline = Pipeline(find_robot(config, bag, names, urdf), config)
        samples: list[Sample] = []
        pipeline.on_sample = lambda sample: samples.append(deepcopy(sample) if config.effects else sample)
        made = list(predictions(bag, pipeline, streams, progress))
        return Recording(Path(path), pipeline.robot, samples, made, (*bag.warnings, *pipeline.status().warnings))


def read_all(
    paths: Sequence[Path], config: Config, names: TopicNames, urdf: Path | None, progress: Progress | None
) -> list[Recording]:
    """Several bags, one after the other."""
    found = []
    for number, path in enumerate(paths):

        def report(fraction: float, words: str, number: int = number) -> None:
            if progress is not None:
                progress((number + fraction) / len(paths), f"reading {paths[number].name}: {words}")

        found.append(read_recording(path, config, names, urdf, report))
    return found


def write_config(path: str | Path, config: Config, comment: str, force: bool) -> Path:
    """A configuration as a file that nodes and commands load; a URDF that it names is found from there as well.

    Raises:
        OutputError: it exists (without `force`), or cannot be written.
    """
    path = check_file(path, force)
    if config.robot.urdf:
        config = config.replaced({"robot.urdf": os.path.relpath(config.directory / config.robot.urdf, path.parent)})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.part")
        partial.write_text(config_to_yaml(config, comment), encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path


def check_file(path: str | Path, force: bool) -> Path:
    """A file that may be written, said before the work begins.

    Raises:
        OutputError: it exists (without `force`), or is a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: is a folder, wanted a file such as {path / 'tuned.yaml'}")
    if path.exists() and not force:
        raise OutputError(f"{path}: exists; --force replaces it")
    return path


def motor_side(config: Config) -> Config:
    """The configuration without effects and horizons, for what is measured at the springs themselves.

    Raises:
        ConfigError: a configuration for a robot without motor encoders.
    """
    if config.prediction.reference == "none":
        raise ConfigError("prediction.reference: none: a robot without motor-side encoders shows no spring deflection")
    return config.replaced({"effects.active": (NOTHING,), "prediction.horizons": (), "prediction.reference": "motor"})
