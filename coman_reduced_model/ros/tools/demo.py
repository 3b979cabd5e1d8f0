# SPDX-License-Identifier: BSD-3-Clause
"""The demonstration: the real nodes on a recorded bag, through DDS, in the bag's own time; what they say is recorded.

The trajectory node is real too: the bag's own com/reference is not played. The plan of a bag that `coman record` made
begins at the bag's first log time, which the node gets as `gait.start_time`. That its feet are where the bag's
reference had them is checked: without a plan that fits, there is no trajectory node, and the bag's own one is played.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...bag.reader import Bag
from ...bag.types import typestore
from ...bag.writer import BagWriter
from ...core.base.stream_names import JOINTS, REFERENCE
from ...core.config.schema import Config
from ...core.evaluation.statistics import RunStatistics
from ...core.gait.gait import plan_walk
from ...core.gait.parameters import GAITS
from ...core.gait.walk import gait_of
from ...core.streams.expected import expected_streams
from ...errors import BagError, ConfigError
from ...messages import COM_PREDICTION, matrix_from, prediction_from, stamp_of
from ...resources import version
from ...schemas import VERSION as SCHEMA_VERSION
from ...topics import OF_PREDICTOR, PREDICTION
from ..interface.diagnostic_report import Level
from ..runtime.processes import NodeFailed, Nodes
from .listener import Listener
from .replay import Progress, Replay

PREDICTIONS_BAG = "predictions"
_COMPLETE = 0.99  # share of the bag's joint states that must have been answered
_START_S = 150.0  # [s] that nodes may take to start; compiling for the first time takes most of it
_FITS_M = 0.005  # [m] a plan whose soles are farther off is not that of the bag


class DemoFailed(Exception):
    """The demonstration did not show what it is there to show."""


@dataclass
class Result:
    """What was seen; `summary` has the schema of `summary.json` of `coman predict`."""

    summary: dict[str, Any]
    live: dict[str, Any] = field(default_factory=dict)


def plan_of(bag: Bag, config: Config) -> Config | None:
    """The configuration with the gait of a bag's plan, which begins at its first log time; None if there is no such.

    The gait is the configured one, or that which the bag is named after.
    """
    topic = f"/{REFERENCE}"
    if not bag.counts.get(topic):
        return None
    names = dict.fromkeys([*(name for name in GAITS if name in bag.path.name), config.gait.name])
    for name in names:
        changed = config.replaced({"gait.name": name, "gait.start_time": bag.start_ns * 1e-9})
        try:
            plan = plan_walk(gait_of(changed))
        except ConfigError:
            continue
        worst = 0.0
        for count, (_, _, message) in enumerate(bag.messages([topic])):
            if count % 100 == 0:
                point = plan.sample((stamp_of(message.header) - bag.start_ns) * 1e-9)
                pairs = ((point.T_odom_left, message.left_sole), (point.T_odom_right, message.right_sole))
                worst = max(worst, *(float(np.abs(T - matrix_from(pose)).max()) for T, pose in pairs))
        if worst < _FITS_M:
            return changed
    return None


def run_demo(
    path: Path, config: Config, config_file: Path, folder: Path, rate: float, on_progress: Callable[[float, str], None]
) -> Result:
    """Play a bag to the nodes and record what they answer as the bag `predictions` in a folder.

    Args:
        path: of the bag.
        config: as in the file.
        config_file: what the nodes load.
        folder: exists.
        rate: of the replay.
        on_progress: fraction done, what is being done.

    Raises:
        ComanError: the bag or the configuration cannot be used.
        NodeFailed: a node has ended early.
        DemoFailed: predictions are missing.
    """
    statistics = RunStatistics(config.streams.restart_gap)
    began = time.monotonic()
    with ExitStack() as stack:
        writer = stack.enter_context(BagWriter(folder / PREDICTIONS_BAG, {f"/{PREDICTION}": COM_PREDICTION}))
        store, robot_name = typestore(), config.robot.name

        def on_prediction(raw: bytes) -> None:
            message: Any = store.deserialize_cdr(raw, COM_PREDICTION)
            statistics.add(prediction_from(message))
            writer.write_raw(f"/{PREDICTION}", stamp_of(message.header), raw)

        def all_run() -> bool:
            nodes.check()
            return True

        nodes = stack.enter_context(Nodes(config_file))
        listener = stack.enter_context(Listener("demo", on_prediction))
        with Bag(path) as bag:
            planned = plan_of(bag, config)
        # What a predictor said while the bag was recorded would be taken for what this one says.
        recorded = (*(topic.lstrip("/") for topic in OF_PREDICTOR), "diagnostics")
        replay = Replay(listener.node, path, (*recorded, REFERENCE) if planned else recorded)
        stack.callback(replay.close)
        needed = _needed(replay, config)
        nodes.start("predictor", {"use_sim_time": True})
        if planned:
            gait = {key: value for key, value in planned.flat().items() if key.startswith("gait.") and value != -1}
            nodes.start("trajectory", {**gait, "use_sim_time": True})
        on_progress(0.0, "starting the nodes")
        replay.wait_for_subscribers(needed, _START_S, all_run)
        if planned:
            _wait(lambda: listener.node.count_publishers(REFERENCE) > 0, nodes, f"{REFERENCE} is published")
        started_s = time.monotonic() - began

        latency = "not reported"  # the last report of /diagnostics while messages came

        def keep_going(progress: Progress) -> bool:
            nonlocal latency
            if progress.messages % 100 == 0:
                nodes.check()
                report = listener.reports.get("predictor: latency")
                if report is not None and report.level != Level.STALE:
                    latency = report.message
                on_progress(progress.messages / progress.total, f"{statistics.samples} predictions")
            return True

        played = replay.play(rate, False, keep_going)
        _wait(lambda: statistics.samples >= 0.98 * replay.bag.counts[f"/{JOINTS}"], nodes, "", 3.0)
        time.sleep(1.2 / config.output.diagnostics_rate)  # the last report of /diagnostics
        nodes.check()
        nodes.stop()  # the predictor answers what still waits
        time.sleep(0.3)
        if bad := {name: code for name, code in nodes.exit_codes.items() if code}:
            raise NodeFailed(f"not stopped cleanly: {bad}")
        asked = replay.bag.counts[f"/{JOINTS}"]
        summary = {
            "schema_version": SCHEMA_VERSION,
            "bag": str(path),
            "version": version(),
            "robot": {"name": robot_name},
            **statistics.summary(),
            **_reported(listener, config),
            "warnings": [*replay.bag.warnings],
            "config": config.flat(),
        }
    live = {
        "joint_states": asked,
        "predictions": summary["samples"],
        "max_lag_s": played.max_lag_s,
        "start_s": started_s,
        "trajectory_node": planned is not None,
        "latency": latency,
    }
    if summary["samples"] < _COMPLETE * asked or not summary["judged_samples"]:
        why = listener.report("predictor: input").message or "no /diagnostics came"
        raise DemoFailed(
            f"{summary['samples']} predictions for {asked} joint states, {summary['judged_samples']} of them with a "
            f"free run; predictor: {why}"
        )
    return Result({**summary, "live": live}, live)


def _needed(replay: Replay, config: Config) -> list[str]:
    needed = [JOINTS, *(stream for stream in expected_streams(config) if stream != REFERENCE)]
    if missing := [topic for topic in needed if not replay.bag.counts.get(f"/{topic}")]:
        raise BagError(f"{replay.bag.path}: no messages on {', '.join('/' + topic for topic in missing)}")
    return needed


def _wait(condition: Callable[[], bool], nodes: Nodes, what: str, timeout_s: float = 30.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        nodes.check()
        if time.monotonic() > end:
            if what:
                raise DemoFailed(f"waited {timeout_s:g} s in vain until {what}")
            return
        time.sleep(0.05)


def _reported(listener: Listener, config: Config) -> dict[str, Any]:
    """What only the node itself knows, from its last /diagnostics."""
    prediction = listener.report("predictor: prediction")
    return {
        "skill": prediction.skill(tuple(f"{h:g}" for h in sorted(config.prediction.horizons))),
        "rejected": listener.report("predictor: input").rejected(),
        "restarts": prediction.restarts(),
    }
