# SPDX-License-Identifier: BSD-3-Clause
"""Predictions for a recorded bag, by the same pipeline that the node runs, as fast as it goes."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .bag.encode import (
    encode_deflection,
    encode_external_wrench,
    encode_odometry,
    encode_point,
    encode_prediction,
    encode_support,
    encode_transforms,
)
from .bag.session import Session
from .bag.truth import true_motion
from .bag.types import bag_types
from .bag.writer import BagWriter
from .core.base.pose import quaternion
from .core.base.throttle import Throttle
from .core.base.types import Array, Foot, Prediction, Sample, SupportState
from .core.config.files import save_config
from .core.evaluation.consistency import Consistency
from .core.evaluation.statistics import RunStatistics, by_axis
from .core.pipeline import Pipeline
from .core.robot.links import Links
from .errors import BagError
from .messages import ODOM
from .output import OutputFolder, to_json
from .progress import Progress
from .resources import version
from .schemas import VERSION as SCHEMA_VERSION
from .topics import (
    DEFLECTION,
    DESCRIPTION,
    EXTERNAL,
    FOOT_ODOMETRY,
    MEASURED,
    OUTPUT_TYPES,
    PREDICTED,
    PREDICTION,
    REFERENCE_POINT,
    SUPPORT,
    TF,
    TF_STATIC,
    TopicNames,
)
from .warm_up import warm_up

PREDICTIONS_BAG, SUMMARY_FILE, CONFIG_FILE = "predictions", "summary.json", "config.yaml"


def predict_bag(
    session: Session, out: str | Path, *, force: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Predict an open bag; writes `predictions/` (an MCAP bag), `summary.json` and `config.yaml` into `out`.

    Returns:
        What `summary.json` holds, with NaN for what is not known (null in the file).

    Raises:
        ComanError: the bag, the configuration or the output cannot be used, or nothing could be predicted.
    """
    bag, config, robot, names = session.bag, session.config, session.robot, session.names
    with OutputFolder(out, force) as folder:
        if progress is not None:
            progress(0.0, "getting ready")
        warm_up(robot, config, bag_types())  # a second of loading compiled code says nothing about the speed
        statistics = _Statistics(session)
        topics = {names(topic): kind for topic, kind in OUTPUT_TYPES.items()}
        began = time.perf_counter()
        writing = BagWriter(folder / PREDICTIONS_BAG, topics, latched=(names(DESCRIPTION), names(TF_STATIC)))
        with _collecting_what_is_new(), writing as writer:
            output = _Output(writer, names, session)
            for sample, prediction in session.predicted(progress):
                statistics.add(prediction)
                output.write(sample, prediction)
        summary = _judged_summary(session, statistics, began)
        (folder / SUMMARY_FILE).write_text(to_json(summary) + "\n", encoding="utf-8")
        save_config(config, folder / CONFIG_FILE, f"used for {bag.path.name}", folder=out)
    return summary


def summarise_bag(session: Session) -> dict[str, Any]:
    """Predict an open bag for its summary alone; writes nothing.

    Returns:
        What `summary.json` would hold, with NaN for what is not known.

    Raises:
        ComanError: the bag or the configuration cannot be used, or nothing could be predicted.
    """
    warm_up(session.robot, session.config, bag_types())
    statistics = _Statistics(session)
    began = time.perf_counter()
    with _collecting_what_is_new():
        for prediction in session.predictions():
            statistics.add(prediction)
    return _judged_summary(session, statistics, began)


class _Statistics:
    """What a summary says of predictions: errors of the free run, consistency of the estimate."""

    def __init__(self, session: Session) -> None:
        self.first_ns = 0  # stamp of the first sample: log times may be of another clock
        self.run = RunStatistics(session.config.streams.restart_gap)
        self.estimate = Consistency(true_motion(session.bag.path))

    def add(self, prediction: Prediction) -> None:
        self.first_ns = self.first_ns or prediction.stamp_ns
        self.run.add(prediction)
        self.estimate.add(prediction)


@contextmanager
def _collecting_what_is_new() -> Iterator[None]:
    """The garbage collector does not look at what is loaded by now again and again."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class _Output:
    """Writes the output topics, at the rates of the configuration, as the node publishes them."""

    def __init__(self, writer: BagWriter, names: TopicNames, session: Session) -> None:
        config = session.config
        self._write = writer.write_raw
        self._names = {topic: names(topic) for topic in OUTPUT_TYPES}
        self._points = Throttle(config.output.points_rate)
        self._every_odometry = Throttle(config.output.odometry_rate)
        self._joints = tuple(name.encode() + b"\0" for name in session.robot.config.leg_joints)
        self._support: SupportState | None = None
        self._root, self._links = session.robot.root, Links(session.robot)
        self._moving = [(ODOM, self._root), *self._links.moving] if config.output.publish_tf else []
        self._describe: Callable[[int], None] | None = partial(self._write_robot, writer, session.robot.urdf)

    def _write_robot(self, writer: BagWriter, urdf: str, stamp: int) -> None:
        """What a display needs first. The stamp is that of the first sample: log times may be of another clock."""
        self._describe = None
        writer.write(self._names[DESCRIPTION], stamp, bag_types().String(data=urdf))
        fixed = self._links.fixed
        if self._moving and fixed:
            poses = np.array([pose for *_, pose in fixed])
            data = encode_transforms(stamp, [(parent, child) for parent, child, _ in fixed], poses)
            self._write(self._names[TF_STATIC], stamp, data)

    def write(self, sample: Sample, prediction: Prediction) -> None:
        stamp, names, write = prediction.stamp_ns, self._names, self._write
        if self._describe is not None:
            self._describe(stamp)
        write(names[PREDICTION], stamp, encode_prediction(prediction))
        write(names[DEFLECTION], stamp, encode_deflection(prediction, self._joints))
        due = self._points.due(stamp)
        before, now = self._support, prediction.support
        if due or before is None or (before.phase, before.support_foot) != (now.phase, now.support_foot):
            write(names[SUPPORT], stamp, encode_support(prediction))
        self._support = now
        if due and math.isfinite(prediction.estimate.force[0]):
            write(names[EXTERNAL], stamp, encode_external_wrench(prediction))
        if due:
            for topic, com in (
                (MEASURED, prediction.measured_com),
                (PREDICTED, prediction.predicted_com),
                (REFERENCE_POINT, prediction.reference_com),
            ):
                point: Array = prediction.T_odom_sole[:3, :3] @ com + prediction.T_odom_sole[:3, 3]
                if math.isfinite(point.dot(_ONES)):  # a plot with a hole is honest, RViz drops NaN with an error
                    write(names[topic], stamp, encode_point(stamp, point))
        if self._every_odometry.due(stamp) and math.isfinite(prediction.base_in_sole[0, 0]):
            self._write_odometry(sample, prediction)

    def _write_odometry(self, sample: Sample, prediction: Prediction) -> None:
        """The root link in `odom`, and on /tf all links: a display needs no joint states for them."""
        stamp, T = prediction.stamp_ns, prediction.T_odom_base
        self._write(self._names[FOOT_ODOMETRY], stamp, encode_odometry(prediction, self._root))
        if self._moving:
            root = (*T[:3, 3], *quaternion(T[:3, :3]))
            poses = np.vstack([root, self._links.poses(sample.q)])
            self._write(self._names[TF], stamp, encode_transforms(stamp, self._moving, poses))


_ONES = np.ones(3)


def _judged_summary(session: Session, statistics: _Statistics, began: float) -> dict[str, Any]:
    """The summary of a run that began at `began` [s of time.perf_counter].

    Raises:
        BagError: nothing could be predicted.
    """
    summary = _summary(session, statistics, time.perf_counter() - began)
    summary["estimate"] = statistics.estimate.summary()
    if not summary["judged_samples"]:
        raise BagError(f"{session.bag.path}: nothing could be predicted: {first_cause(summary)}")
    return summary


def _summary(session: Session, statistics: _Statistics, elapsed: float) -> dict[str, Any]:
    bag, config, robot, pipeline = session.bag, session.config, session.robot, session.pipeline
    status, judge = pipeline.status(), pipeline.judge
    run = statistics.run.summary()
    mismatches = _mismatches(statistics.first_ns, pipeline)
    warnings = list(session.warnings)
    doubtful = run["flags"].get("UNKNOWN_GROUND", 0)
    if doubtful > _SELDOM * run["samples"]:
        aslant, why = pipeline.predictor.dynamics.aslant_landings, []
        if aslant:
            why.append(f"landings at which the soles were not parallel: {aslant}")
        if pipeline.predictor.slope is not None and pipeline.predictor.slope.doubted:
            shown = _PUSHED if config.streams.wrench_source == "sensors" else _TAKEN_AS_LEVEL
            why.append(f"there is neither an IMU nor a plan, and {shown}")
        warnings.append(f"the ground is not known in {doubtful} of {run['samples']} samples: {'; '.join(why)}")
    diverged = run["flags"].get("REJECTED_STATE", 0)
    if diverged > _SELDOM * run["samples"]:
        warnings.append(
            f"predictions diverged in {diverged} of {run['samples']} samples: check stiffness, damping, URDF and units "
            "(joint positions in rad)"
        )
    return {
        "schema_version": SCHEMA_VERSION,
        "bag": str(bag.path),
        "version": version(),
        "robot": {
            "name": config.robot.name,
            "mass_kg": robot.mass,
            "joints": list(robot.joint_names),
            "soles_m": {foot.name.lower(): robot.soles[foot].tolist() for foot in (Foot.LEFT, Foot.RIGHT)},
        },
        "wrench_source": config.streams.wrench_source,
        "ground": _ground(pipeline),
        "adapted": _adapted(pipeline),
        "adapted_trunk_com": _adapted_trunk_com(pipeline),
        **run,
        "skill": {h: by_axis(skill) for h, skill in judge.skill().items()},
        "within_90": {h: by_axis(share) for h, share in judge.within().items()},
        "reliability": judge.reliability(),
        "simpler_ahead": judge.simpler_is_better,
        "simpler_share": {h: by_axis(share) for h, share in judge.simpler_share().items()},
        "model_share": {f"{h:g}": by_axis(judge.model_share(i)) for i, h in enumerate(judge.horizons)},
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


def _ground(pipeline: Pipeline) -> dict[str, Any]:
    """What was known of the slope of the ground, at the end, and landings at which it was not."""
    slope, aslant = pipeline.predictor.slope, {"aslant_landings": pipeline.predictor.dynamics.aslant_landings}
    if slope is None:
        return {"source": "configuration", "roll_rad": None, "pitch_rad": None, **aslant}
    ground = slope.known()
    return {"source": ground.source, "roll_rad": ground.roll, "pitch_rad": ground.pitch, **aslant}


def _adapted(pipeline: Pipeline) -> dict[str, Any] | None:
    """What `prediction.adapt` has learnt, at the end."""
    adaptation = pipeline.predictor.adaptation
    if adaptation is None:
        return None
    return {name: {"stiffness_ratio": k, "zero_rad": zero} for name, (k, zero) in adaptation.known().items()}


def _adapted_trunk_com(pipeline: Pipeline) -> dict[str, float] | None:
    """The same of the trunk's COM."""
    adaptation = pipeline.predictor.adaptation
    return None if adaptation is None else dict(zip(("x_m", "y_m"), adaptation.shift.tolist(), strict=True))


_PUSHED = "the feet bear forces along their soles, as on a slope or by something that pushes"
_TAKEN_AS_LEVEL = "computed wrenches show no slope: it is taken as level (model.slope: level says that it is)"
_SELDOM = 0.01  # share of samples: a free run may fall now and then
_WHY = {  # by flag of the samples
    "NO_SUPPORT": "by the wrenches neither foot carries the robot (support.contact_on, support.weight)",
    "NO_REFERENCE": "there is no reference (prediction.reference)",
    "STALE_WRENCH": "the wrench of a foot is missing or too old (streams.max_wrench_age)",
    "REJECTED_STATE": "the predictions diverged",
}


def first_cause(summary: dict[str, Any]) -> str:
    """Why a bag could not be predicted: why most of a stream was rejected, else the first warning or flag."""
    needed = {name: stream["accepted"] for name, stream in summary["streams"].items() if stream["expected"]}
    rejected = {key: n for key, n in summary["rejected"].items() if n > needed.get(key.rpartition("/")[0], math.inf)}
    if rejected:
        return str(summary["last_rejection"][max(rejected, key=rejected.__getitem__)])
    if summary["warnings"]:
        return str(summary["warnings"][0])
    return next((why for flag, why in _WHY.items() if summary["flags"].get(flag)), "there is no joint state")


def _mismatches(first_ns: int, pipeline: Pipeline) -> list[dict[str, Any]]:
    """First mismatch of each channel during the run; times from the first sample on."""
    found = []
    for each in pipeline.monitor.first.values() if pipeline.monitor is not None else ():
        onset, detected = ((stamp - first_ns) * 1e-9 for stamp in (each.onset_ns, each.detected_ns))
        values = {key: value for key, value in asdict(each).items() if not key.endswith("_ns")}
        text = f"mismatch: {each}, since {onset:.1f} s"
        found.append({**values, "since_s": onset, "detected_s": detected, "text": text})
    return found
