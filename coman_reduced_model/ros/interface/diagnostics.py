# SPDX-License-Identifier: BSD-3-Clause
"""/diagnostics of the predictor: input, prediction, mismatch and latency, each with a one-line summary."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ...core.base.stream_names import JOINTS
from ...core.base.types import Array, Flags, Prediction
from ...core.config.schema import Config
from ...core.evaluation.statistics import AXES
from ...core.monitor.monitor import Monitor
from ...core.pipeline import Pipeline, Status
from . import qos
from .description import Description
from .diagnostic_report import Level, adapted_values, rate_value, rejected_values, restart_value, skill_values
from .parameters import ConfiguredNode
from .report_timer import ReportTimer

_WINDOW = 5  # reports over which errors and shares are averaged
_SILENT = 1.0  # [s] without joint states: stale
_CAPACITY = 8192  # latencies kept


class PredictingNode(ConfiguredNode):
    """A node that predicts, as far as its diagnostics look at it."""

    config: Config
    pipeline: Pipeline | None  # None until the URDF is there
    description: Description


class _Interval:
    """What happened between two reports."""

    def __init__(self) -> None:
        self.samples = 0
        self.predicted = 0
        self.squares = np.zeros(3)  # of the residual [m^2]
        self.flags: Counter[int] = Counter()


class Diagnostics:
    """Collects while predictions run and publishes at `output.diagnostics_rate`."""

    def __init__(self, node: PredictingNode) -> None:
        self._node = node
        self._arrived: dict[str, float] = {}  # by stream, when its last message came (time.perf_counter) [s]
        self._failures: Counter[str] = Counter()
        self._last_failure = ""
        self._now = _Interval()
        self._past: deque[_Interval] = deque(maxlen=_WINDOW)
        self._latencies = np.zeros(_CAPACITY)
        self._count = self._counted = 0
        self._newest_ns = 0  # stamp of the last prediction: the node's own clock may be another one
        self._received: dict[str, int] = {}
        self._rejected: dict[str, int] = {}
        self._last_report = time.perf_counter()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.display_output())
        self._timer = ReportTimer(node, self._report)
        self._timer.set_rate(node.config.output.diagnostics_rate)

    def reconfigure(self, config: Config) -> None:
        """Take over another rate."""
        self._timer.set_rate(config.output.diagnostics_rate)

    def on_message(self, stream: str, arrived: float) -> None:
        """A message of a stream was processed; it arrived at `arrived` (time.perf_counter) [s]."""
        self._arrived[stream] = arrived

    def on_prediction(self, prediction: Prediction, started: float) -> None:
        """A prediction was published; processing of its last message started at `started` [s]."""
        now = self._now
        self._newest_ns = prediction.stamp_ns
        now.samples += 1
        residual, flags = prediction.residual, prediction.flags
        square = residual * residual
        if square[2] == square[2] and not (flags and flags.diverged):  # not NaN
            now.squares += square
            now.predicted += 1
        if flags:
            now.flags[int(flags)] += 1
        self._latencies[self._count % _CAPACITY] = time.perf_counter() - started
        self._count += 1

    def on_failure(self, stream: str, error: Exception) -> None:
        """Exception in a message callback."""
        self._failures[type(error).__name__] += 1
        self._last_failure = f"{stream}: {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        self._node.get_logger().error(f"internal error, please report: {self._last_failure}", throttle_duration_sec=5.0)

    # --- reporting ---

    def _report(self) -> None:
        now = time.perf_counter()
        seconds, self._last_report = max(now - self._last_report, 1e-3), now
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        pipeline = self._node.pipeline
        if pipeline is None:
            array.status = [self._status("input", Level.WARN, self.preparing(), {})]
        else:
            self._past.append(self._now)
            self._now = _Interval()
            status = pipeline.status()
            array.status = [
                self._status("input", *self._input(status, now, seconds)),
                self._status("prediction", *self._prediction(status, pipeline)),
                self._status("mismatch", *self._mismatch(status, pipeline.monitor)),
                self._status("latency", *self._latency(seconds)),
            ]
            self._counted = self._count
        self._publisher.publish(array)

    def _status(self, part: str, level: Level, message: str, values: dict[str, Any]) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=bytes([level]),
            name=f"{self._node.get_fully_qualified_name().lstrip('/')}: {part}",
            message=message,
            hardware_id=self._node.config.robot.name,
            values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
        )

    def preparing(self) -> str:
        """Why nothing is predicted yet."""
        description = self._node.description
        return f"waiting for the URDF on {description.topic}" if description.waiting else "warming up"

    def _input(self, status: Status, now: float, seconds: float) -> tuple[Level, str, dict[str, Any]]:
        values: dict[str, Any] = {}
        for name, stream in status.streams.items():
            count = stream.received - self._received.get(name, 0)
            self._received[name] = stream.received
            if not stream.received and not stream.expected:
                continue
            values |= rate_value(name, count / seconds)
            values[f"{name}: age [s]"] = now - self._arrived[name] if name in self._arrived else math.nan
            values[f"{name}: received"] = stream.received
            values[f"{name}: accepted"] = stream.accepted
            values[f"{name}: late"] = stream.late
            if stream.expected:
                values[f"{name}: missing in samples"] = stream.incomplete
        values["foot wrenches"] = self._node.config.streams.wrench_source
        values["samples"] = status.samples
        values["waiting"] = status.waiting
        values |= rejected_values(status.rejected, status.last_rejection)
        values |= {f"implausible: {what}": count for what, count in status.suspect.items()}
        new = [
            status.last_rejection[reason]
            for reason, count in status.rejected.items()
            if count > self._rejected.get(reason, 0)
        ]
        self._rejected = status.rejected
        for reason, count in self._failures.items():
            values[f"internal error: {reason}"] = count
        if status.extra_joints:
            values["joints that the URDF lacks (ignored)"] = ", ".join(status.extra_joints)
        if status.unlisted_joints:
            values["joints that no message lists (held at zero)"] = ", ".join(status.unlisted_joints)
        for index, warning in enumerate(status.warnings):
            values[f"warning {index + 1}"] = warning.text
        return *self._input_verdict(status, now, new), values

    def _input_verdict(self, status: Status, now: float, new: list[str]) -> tuple[Level, str]:
        if self._failures:
            return Level.ERROR, f"internal error, please report: {self._last_failure}"
        joints = self._arrived.get(JOINTS)
        if joints is None or now - joints > _SILENT:
            since = "yet" if joints is None else f"for {now - joints:.1f} s"
            return Level.STALE, f"no message on {self._node.resolve_topic_name(JOINTS)} {since}"
        if status.warnings:
            missing = any(warning.prevents_prediction for warning in status.warnings)
            return Level.ERROR if missing else Level.WARN, "; ".join((*map(str, status.warnings), *new))
        if new:
            return Level.WARN, "; ".join(new)
        return Level.OK, "all streams are there"

    def _prediction(self, status: Status, pipeline: Pipeline) -> tuple[Level, str, dict[str, Any]]:
        judge, adaptation = pipeline.judge, pipeline.predictor.adaptation
        samples = sum(each.samples for each in self._past)
        predicted = sum(each.predicted for each in self._past)
        flags: Counter[int] = sum((each.flags for each in self._past), Counter())
        rms = np.full(3, math.nan)
        if predicted:
            rms = np.sqrt(sum(each.squares for each in self._past) / predicted)
        values: dict[str, Any] = {f"error RMS {axis} [mm]": 1e3 * rms[i] for i, axis in enumerate("xyz")}
        values |= skill_values(judge.skill())
        for flag in Flags:
            if flag:
                count = sum(number for bits, number in flags.items() if bits & flag)
                values[f"share {str(flag.name).lower()}"] = count / samples if samples else math.nan
        values |= restart_value(status.restarts)
        values |= {} if adaptation is None else adapted_values(adaptation.known(), adaptation.shift)
        if not samples:
            return Level.STALE, "no predictions in the last reports", values
        if not predicted:
            return Level.WARN, f"no free run: {_reasons(flags)}", values
        message = f"error RMS x, y, z: {_triple(1e3 * rms)} mm"
        singular, lost = values["share near_singular"], values["share rejected_state"]
        if lost:
            return (
                Level.WARN,
                f"{message}; a prediction diverged: check stiffness, damping, URDF and units (rad)",
                values,
            )
        if singular > 0.5:
            return Level.WARN, f"{message}; posture near singular (straight knee): stiffness is limited", values
        if simpler := judge.simpler():
            values |= {f"simpler ahead {h} s {AXES[axis]}": name for h, axis, name in simpler}
            axes = ", ".join(name for i, name in enumerate(AXES) if i in {axis for _, axis, _ in simpler})
            return Level.OK, f"{message}; ahead, simpler predictions have taken over from the model in {axes}", values
        return Level.OK, message, values

    def _mismatch(self, status: Status, monitor: Monitor | None) -> tuple[Level, str, dict[str, Any]]:
        if monitor is None:
            return Level.OK, "monitor disabled (monitor.enabled)", {}
        if (source := self._node.config.streams.wrench_source) != "sensors":
            return Level.OK, f"nothing is watched: foot wrenches are computed (streams.wrench_source: {source})", {}
        values: dict[str, Any] = {"support phases compared": monitor.phases}
        lines = [
            f"{each}, for {max(0.0, (self._newest_ns - each.onset_ns) * 1e-9):.1f} s" for each in status.mismatches
        ]
        for each, line in zip(status.mismatches, lines, strict=True):
            values[each.channel] = line
        if lines:
            others = ", ".join(each.channel for each in status.mismatches[1:])
            return Level.WARN, lines[0] + (f"; also {others}" if others else ""), values
        if not monitor.phases:
            return Level.OK, "nothing to compare yet", values
        return Level.OK, "no mismatch: residuals unchanged and within tolerance", values

    def _latency(self, seconds: float) -> tuple[Level, str, dict[str, Any]]:
        count = min(self._count - self._counted, _CAPACITY)
        if not count:
            return Level.STALE, "no predictions", {}
        recent = self._latencies[(np.arange(self._count - count, self._count)) % _CAPACITY] * 1e3
        p50, p99, worst = np.percentile(recent, 50), np.percentile(recent, 99), recent.max()
        busy = recent.sum() / (1e3 * seconds)
        values = {"p50 [ms]": p50, "p99 [ms]": p99, "max [ms]": worst, "share of time predicting": busy}
        message = f"p50 {p50:.3f} ms, p99 {p99:.3f} ms"
        if busy > 0.8:
            return (
                Level.WARN,
                f"{message}; predicting takes {100 * busy:.0f} % of the time: too slow for this rate",
                values,
            )
        return Level.OK, message, values


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _triple(values: Array) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _reasons(flags: Counter[int]) -> str:
    union = Flags(0)
    for bits in flags:
        union |= Flags(bits).invalid
    return ", ".join(str(flag.name).lower() for flag in Flags if flag and flag in union) or "unknown"
