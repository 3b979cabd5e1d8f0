# SPDX-License-Identifier: BSD-3-Clause
"""Predictions for a recorded bag, by the same pipeline that the node runs, as fast as it goes."""

from __future__ import annotations

import gc
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__
from .bag.decode import decoder
from .bag.encode import encode_point, encode_prediction, encode_support
from .bag.reader import Bag, missing_topics
from .bag.types import bag_types
from .bag.writer import BagWriter
from .core.config import Config, config_to_yaml
from .core.joiner import JOINTS, MOTORS, REFERENCE, WRENCHES
from .core.pipeline import Pipeline
from .core.robot import Robot
from .core.statistics import RunStatistics, by_axis
from .core.throttle import Throttle
from .core.types import Array, Prediction, Sample, SupportState
from .errors import BagError, ConfigError
from .messages import INPUT_TYPES, STRING
from .output import OutputFolder
from .topics import (
    DESCRIPTION,
    INPUT_TOPICS,
    MEASURED,
    OUTPUT_TYPES,
    PREDICTED,
    PREDICTION,
    REFERENCE_POINT,
    SUPPORT,
    TopicNames,
)
from .warm_up import warm_up

Progress = Callable[[float, str], None]  # fraction done, what is being done
_BATCH = 200  # samples joined before they are predicted: switching for each would cost a fifth of the time
PREDICTIONS_BAG, SUMMARY_FILE, CONFIG_FILE = "predictions", "summary.json", "config.yaml"


def read_urdf(path: str | Path) -> str:
    """The text of a URDF file.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: the URDF cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file") from None


def find_robot(config: Config, bag: Bag | None, names: TopicNames, urdf: str | Path | None = None) -> Robot:
    """The robot: of the file `urdf`, else of the configuration (robot.urdf), else as the bag describes it.

    Raises:
        ConfigError, BagError, RobotError: there is none, or it cannot be used.
    """
    if urdf is None and config.robot.urdf:
        urdf = config.directory / config.robot.urdf
    if urdf is not None:
        return Robot(read_urdf(urdf), config.robot, str(urdf))
    topic = names(DESCRIPTION)
    if bag is None:
        raise ConfigError("robot.urdf: no URDF named, and no bag to take it from")
    if topic not in bag.topics:
        raise BagError(f"{missing_topics(bag, [topic])}; name a URDF with --urdf or robot.urdf")
    if bag.topics[topic] != STRING:
        raise BagError(f"{bag.path}: {topic}: of type {bag.topics[topic]}, wanted {STRING}")
    message = bag.first(topic)
    if message is None:
        raise BagError(f"{bag.path}: {topic}: no message; name a URDF with --urdf or robot.urdf")
    return Robot(message.data, config.robot, f"{bag.path}: {topic}")


def input_streams(bag: Bag, config: Config, names: TopicNames) -> dict[str, str]:
    """Stream by topic, for the topics of the bag that the predictor takes.

    Raises:
        BagError: one that is needed is missing, or has another type.
        ConfigError: two streams have one topic.
    """
    source = config.prediction.reference
    needed = [JOINTS, *WRENCHES.values(), *{"motor": [MOTORS], "topic": [REFERENCE]}.get(source, [])]
    topics: dict[str, str] = {}
    for stream, topic in INPUT_TOPICS.items():
        twin = topics.setdefault(names(topic), stream)
        if twin != stream:
            raise ConfigError(f"--remap: {INPUT_TOPICS[twin]} and {topic} would both be {names(topic)}")
    missing = [topic for topic, stream in topics.items() if stream in needed and not bag.counts.get(topic)]
    if missing:
        by_choice = any(topics[topic] in (MOTORS, REFERENCE) for topic in missing)
        hint = f" (prediction.reference: {source}; `none` does without)" if by_choice else ""
        raise BagError(missing_topics(bag, missing) + hint)
    for topic, stream in topics.items():
        if topic in bag.topics and bag.topics[topic] != INPUT_TYPES[stream]:
            raise BagError(f"{bag.path}: {topic}: of type {bag.topics[topic]}, wanted {INPUT_TYPES[stream]}")
    return {topic: stream for topic, stream in topics.items() if topic in bag.topics}


def predict_bag(
    bag: Bag,
    config: Config,
    out: str | Path,
    *,
    names: TopicNames | None = None,
    urdf: str | Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the predictor over a bag; writes `predictions/` (MCAP bag), `summary.json` and `config.yaml` into `out`.

    Returns:
        What `summary.json` holds, with NaN for what is not known (null in the file).

    Raises:
        ComanError: the bag, the robot, the configuration or the output cannot be used.
    """
    names = names or TopicNames()
    streams = input_streams(bag, config, names)
    robot = find_robot(config, bag, names, urdf)
    with OutputFolder(out, force) as folder:
        if progress is not None:
            progress(0.0, "getting ready")
        warm_up(robot, config, bag_types())  # a second of loading compiled code says nothing about the speed
        pipeline = Pipeline(robot, config)
        statistics = RunStatistics(config.streams.restart_gap)
        topics = {names(topic): kind for topic, kind in OUTPUT_TYPES.items()}
        began = time.perf_counter()
        writing = BagWriter(folder / PREDICTIONS_BAG, topics, latched=(names(DESCRIPTION),))
        with _collecting_what_is_new(), writing as writer:
            writer.write(names(DESCRIPTION), bag.start_ns, bag_types().String(data=robot.urdf))
            output = _Output(writer, names, config)
            for prediction in predictions(bag, pipeline, streams, progress):
                statistics.add(prediction)
                output.write(prediction)
        elapsed = time.perf_counter() - began
        summary = _summary(bag, config, robot, pipeline, statistics, elapsed)
        (folder / SUMMARY_FILE).write_text(to_json(summary) + "\n", encoding="utf-8")
        (folder / CONFIG_FILE).write_text(config_to_yaml(config, f"used for {bag.path.name}"), encoding="utf-8")
    return summary


@contextmanager
def _collecting_what_is_new() -> Iterator[None]:
    """The garbage collector does not look at what is loaded by now again and again."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def predictions(
    bag: Bag, pipeline: Pipeline, streams: dict[str, str], progress: Progress | None = None
) -> Iterator[Prediction]:
    """Predictions of a pipeline over a bag, one after the other; `streams` as `input_streams` gives them."""
    decoders = {topic: decoder(stream, bag.typestore) for topic, stream in streams.items()}
    span = max(bag.end_ns - bag.start_ns, 1)
    take = pipeline.take
    samples: list[Sample] = []
    for topic, log_time, raw in bag.raw(streams):
        samples += take(streams[topic], raw, decoders[topic])
        if len(samples) >= _BATCH:
            yield from pipeline.predict(samples)
            samples = []
            if progress is not None:
                progress((log_time - bag.start_ns) / span, f"{pipeline.samples} samples")
    yield from pipeline.predict(samples)
    yield from pipeline.flush()
    if progress is not None:
        progress(1.0, f"{pipeline.samples} samples")


class _Output:
    """Writes the output topics, at the rates of the configuration, as the node publishes them."""

    def __init__(self, writer: BagWriter, names: TopicNames, config: Config) -> None:
        self._write = writer.write_raw
        self._names = {topic: names(topic) for topic in OUTPUT_TYPES}
        self._points = Throttle(config.output.points_rate)
        self._support: SupportState | None = None

    def write(self, prediction: Prediction) -> None:
        stamp, names, write = prediction.stamp_ns, self._names, self._write
        write(names[PREDICTION], stamp, encode_prediction(prediction))
        due = self._points.due(stamp)
        before, now = self._support, prediction.support
        if due or before is None or (before.phase, before.support_foot) != (now.phase, now.support_foot):
            write(names[SUPPORT], stamp, encode_support(prediction))
        self._support = now
        if due:
            for topic, com in (
                (MEASURED, prediction.measured_com),
                (PREDICTED, prediction.predicted_com),
                (REFERENCE_POINT, prediction.reference_com),
            ):
                point: Array = prediction.T_odom_sole[:3, :3] @ com + prediction.T_odom_sole[:3, 3]
                if math.isfinite(point.dot(_ONES)):  # a plot with a hole is honest, RViz drops NaN with an error
                    write(names[topic], stamp, encode_point(stamp, point))


_ONES = np.ones(3)


def _summary(
    bag: Bag, config: Config, robot: Robot, pipeline: Pipeline, statistics: RunStatistics, elapsed: float
) -> dict[str, Any]:
    status, judge = pipeline.status(), pipeline.judge
    run = statistics.summary()
    mismatches = _mismatches(bag, pipeline)
    warnings = [*bag.warnings, *status.warnings]
    if diverged := run["flags"].get("REJECTED_STATE"):
        warnings.append(
            f"predictions diverged in {diverged} of {run['samples']} samples: check stiffness, damping, URDF and units "
            "(joint positions in rad)"
        )
    return {
        "bag": str(bag.path),
        "version": __version__,
        "robot": {"name": config.robot.name, "mass_kg": robot.mass, "joints": list(robot.joint_names)},
        **run,
        "skill": {h: by_axis(skill) for h, skill in judge.skill().items()},
        "horizon_rmse_m": {
            h: {predictor: by_axis(error) for predictor, error in errors.items()} for h, errors in judge.rmse().items()
        },
        "rejected": status.rejected,
        "last_rejection": status.last_rejection,
        "suspect": status.suspect,
        "incomplete": {name: stream.incomplete for name, stream in status.streams.items() if stream.incomplete},
        "streams": {name: asdict(stream) for name, stream in status.streams.items()},
        "restarts": status.restarts,
        "warnings": [*warnings, *(each["text"] for each in mismatches)],
        "mismatches": mismatches,
        "extra_joints": list(status.extra_joints),
        "unlisted_joints": list(status.unlisted_joints),
        "elapsed_s": elapsed,
        "realtime_factor": run["duration_s"] / elapsed,
        "config": config.flat(),
    }


def _mismatches(bag: Bag, pipeline: Pipeline) -> list[dict[str, Any]]:
    """What the monitor told during the run, each channel as it was first told; times from the start of the bag."""
    found = []
    for each in pipeline.monitor.first.values() if pipeline.monitor is not None else ():
        since, told = ((stamp - bag.start_ns) * 1e-9 for stamp in (each.since_ns, each.told_ns))
        values = {key: value for key, value in asdict(each).items() if not key.endswith("_ns")}
        text = f"mismatch: {each}, since {since:.1f} s"
        found.append({**values, "since_s": since, "told_s": told, "text": text})
    return found


def to_json(value: Any) -> str:
    """JSON as it is defined: null for NaN and infinity, which it does not have."""

    def plain(item: Any) -> Any:
        if isinstance(item, dict):
            return {str(key): plain(entry) for key, entry in item.items()}
        if isinstance(item, (list, tuple)):
            return [plain(entry) for entry in item]
        return None if isinstance(item, float) and not math.isfinite(item) else item

    return json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
