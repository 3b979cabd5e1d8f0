# SPDX-License-Identifier: BSD-3-Clause
"""The whole way from messages to predictions, with its counters. The node and `coman predict` both run this."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from .base.input_warning import InputWarning, WarningKind
from .base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from .base.types import Foot, ImuMessage, JointMessage, Prediction, Reference, Sample, WrenchMessage
from .config.schema import Config
from .effects.catalogue import build_effects, stream_delays
from .monitor.monitor import STALE_S, Mismatch, Monitor
from .monitor.plausibility import Plausibility
from .predictor import Predictor
from .streams.block_joiner import BlockJoiner
from .streams.stream import Refused

if TYPE_CHECKING:
    from .evaluation.horizons import HorizonJudge
    from .robot.robot import Robot

_EARLY_PLAN_S = 2.0  # a plan may be published so far ahead (`gait.ahead`)


def clock_apart(stream: str, lead_s: float, most_s: float) -> InputWarning | None:
    """That stamps of a stream are so far ahead of those of the joint states [s]; None up to `most_s`, either way."""
    early = _EARLY_PLAN_S if stream == REFERENCE else most_s
    if -most_s <= lead_s <= early:
        return None
    side = "behind" if lead_s < 0.0 else "ahead of"
    text = f"{stream}: its clock is {abs(lead_s):.3f} s {side} {JOINTS}, or it arrives at another time"
    return InputWarning(WarningKind.CLOCK, stream, text)


@dataclass(frozen=True)
class StreamStatus:
    """One input stream, as /diagnostics shows it."""

    name: str
    expected: bool  # predictions need it
    received: int  # messages, also those rejected
    accepted: int
    rate_hz: float  # of the accepted stamps, smoothed; NaN before there are two
    age_s: float  # newest joint state minus the newest of this stream; NaN if there is none
    late: int  # of the accepted: came when the samples of their stamps had gone without them
    incomplete: int  # samples that went without its value


@dataclass(frozen=True)
class Status:
    """What has happened since the start; for /diagnostics and `summary.json`."""

    streams: dict[str, StreamStatus]
    samples: int
    restarts: int  # times that the joint states broke off or went back
    waiting: int  # joint states that wait for other streams now
    rejected: dict[str, int]  # by "stream/reason"
    last_rejection: dict[str, str]  # the last sentence for each
    suspect: dict[str, int]  # looks at samples (50 a second) that found wrenches of wrong sign or foot
    extra_joints: tuple[str, ...]  # in messages, not in the URDF: ignored
    unlisted_joints: tuple[str, ...]  # in the URDF, not in messages: held at zero
    warnings: tuple[InputWarning, ...]  # what looks wrong and what to look at
    mismatches: tuple[Mismatch, ...]  # present ones, as in `Monitor`


class Pipeline:
    """Joiner, predictor and counters of one robot.

    Each `on_*` takes a message and returns the predictions that it completes: one a joint state, as soon as the other
    streams that the prediction needs have a message with its stamp or a later one.

    Example:
        >>> import numpy as np
        >>> import coman_reduced_model as coman
        >>> robot = coman.open_robot(coman.bag_path("test1"))
        >>> pipeline = coman.Pipeline(robot, coman.Config())
        >>> stamp_ns, half = 1_000_000_000, np.array((0.0, 0.0, 0.5 * 9.81 * robot.mass))
        >>> q = np.full(len(robot.joint_names), 0.1)
        >>> joints = coman.JointMessage(stamp_ns, robot.joint_names, q, np.zeros_like(q), None)
        >>> pipeline.on_motor(joints)
        []
        >>> pipeline.on_wrench(coman.Foot.LEFT, coman.WrenchMessage(stamp_ns, "l_sole", half, np.zeros(3)))
        []
        >>> pipeline.on_wrench(coman.Foot.RIGHT, coman.WrenchMessage(stamp_ns, "r_sole", half, np.zeros(3)))
        []
        >>> (prediction,) = pipeline.on_joint(joints)
        >>> prediction.support.phase
        <Phase.DOUBLE: 3>
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        self.config = config = config.with_joints_of(robot)
        self.unloaded = robot
        effects, self.robot = build_effects(config.effects, robot)
        self.joiner = BlockJoiner(robot, config, stream_delays(effects))
        self.predictor = Predictor(self.robot, config, effects)
        self.plausibility = Plausibility(self.robot, config)
        self.monitor = Monitor(self.robot, config, self.predictor.zeros) if config.monitor.enabled else None
        self.samples = 0
        self.restarts = 0
        self._gap = round(config.streams.restart_gap * 1e9)
        self._last_stamp: int | None = None
        self._add: dict[str, Callable[[Any], list[Sample]]] = {
            JOINTS: self.joiner.add_joint,
            MOTORS: self.joiner.add_motor,
            REFERENCE: self.joiner.add_reference,
            IMU: self.joiner.add_imu,
            CONTACTS: self.joiner.add_contacts,
            WRENCHES[Foot.LEFT]: partial(self.joiner.add_wrench, Foot.LEFT),
            WRENCHES[Foot.RIGHT]: partial(self.joiner.add_wrench, Foot.RIGHT),
        }

    @property
    def judge(self) -> HorizonJudge:
        """Errors of the horizon predictions so far."""
        return self.predictor.judge

    def on_joint(self, message: JointMessage) -> list[Prediction]:
        """A link-side joint state."""
        return self.predict(self.joiner.add_joint(message))

    def on_motor(self, message: JointMessage) -> list[Prediction]:
        """A motor-side joint state."""
        return self.predict(self.joiner.add_motor(message))

    def on_wrench(self, foot: Foot, message: WrenchMessage) -> list[Prediction]:
        """What the ground exerts on a foot."""
        return self.predict(self.joiner.add_wrench(foot, message))

    def on_reference(self, message: Reference) -> list[Prediction]:
        """A point of the planned motion."""
        return self.predict(self.joiner.add_reference(message))

    def on_imu(self, message: ImuMessage) -> list[Prediction]:
        """Orientation and rates of the trunk."""
        return self.predict(self.joiner.add_imu(message))

    def take(self, stream: str, message: Any, convert: Callable[[Any], Any]) -> list[Sample]:
        """Join a message of a stream, by name, as it came: `convert` (messages.FROM) makes it one of the above.

        A message that cannot be converted is counted as rejected.
        """
        try:
            converted = convert(message)
        except Refused as refused:
            self.joiner.streams[stream].received += 1
            self.joiner.rejections.add(stream, refused.reason, str(refused))
            return []
        return self._add[stream](converted)

    def feed(self, stream: str, message: Any, convert: Callable[[Any], Any]) -> list[Prediction]:
        """`take` and `predict` at once, for those who want predictions as soon as they can be made."""
        samples = self.take(stream, message, convert)
        return self.predict(samples) if samples else []

    def flush(self) -> list[Prediction]:
        """The end: predictions for the joint states that still wait for other streams."""
        return self.predict(self.joiner.flush())

    def predict(self, samples: list[Sample]) -> list[Prediction]:
        """Predictions of samples, which must come in the order in which they were joined."""
        return [self._update(sample) for sample in samples]

    def _update(self, sample: Sample) -> Prediction:
        last, self._last_stamp = self._last_stamp, sample.stamp_ns
        if last is not None and not 0 < sample.stamp_ns - last <= self._gap:
            self.restarts += 1
            self.reset(levels=not 0 < sample.stamp_ns - last <= 1e9 * STALE_S)
            self._last_stamp = sample.stamp_ns
        self.samples += 1
        self.plausibility.update(sample, self.predictor.zeros)
        prediction = self.predictor.update(sample)
        if self.monitor is not None:
            assert self.predictor.sample is not None
            self.monitor.update(self.predictor.sample, self.predictor.link, prediction)
        return prediction

    def reset(self, levels: bool = True) -> None:
        """Forget the past, as after a gap: odom begins at the next sample. Counters of messages are kept.

        What looked wrong with the input counts from then on: it may have been mended.

        Args:
            levels: also those of the monitor, and what it reports.
        """
        self._last_stamp = None
        self.predictor.reset()
        self.plausibility.reset()
        if self.monitor is not None:
            (self.monitor.reset if levels else self.monitor.interrupt)()

    def reconfigure(self, config: Config) -> None:
        """Take over parameters that may change while it runs: those of support phase and monitor.

        Another `monitor.baseline` makes the monitor begin again, another threshold does not.

        Raises:
            ConfigError: `monitor.baseline` cannot be read; nothing has changed.
        """
        config = config.with_joints_of(self.unloaded)
        old, new = self.config.monitor, config.monitor
        if (new.enabled, new.baseline) != (old.enabled, old.baseline):
            self.monitor = Monitor(self.robot, config, self.predictor.zeros) if new.enabled else None
        elif self.monitor is not None:
            self.monitor.change_threshold(new.threshold)
        self.config = config
        self.predictor.reconfigure(config)
        self.plausibility.reconfigure(config)

    def streams(self) -> dict[str, StreamStatus]:
        """The input streams by name."""
        joiner = self.joiner
        newest = joiner.streams[JOINTS].last
        found = {}
        for name, stream in joiner.streams.items():
            known = newest is not None and stream.last is not None
            found[name] = StreamStatus(
                name,
                name == JOINTS or name in joiner.incomplete,
                stream.received,
                stream.accepted,
                1.0 / stream.period_s if stream.period_s else float("nan"),
                (newest - stream.last) * 1e-9 if known else float("nan"),  # type: ignore[operator]
                stream.overdue,
                joiner.incomplete.get(name, 0),
            )
        return found

    def status(self) -> Status:
        """Counters, rates and warnings so far."""
        joiner, streams = self.joiner, self.streams()
        return Status(
            streams,
            self.samples,
            self.restarts,
            joiner.waiting,
            dict(joiner.rejections.counts),
            dict(joiner.rejections.last),
            self.plausibility.counts(),
            joiner.extra_joints,
            joiner.unlisted_joints,
            tuple(self._warnings(streams)),
            () if self.monitor is None else tuple(self.monitor.mismatches),
        )

    def _warnings(self, streams: dict[str, StreamStatus]) -> list[InputWarning]:
        if not streams[JOINTS].accepted:
            text = f"{JOINTS}: no usable message yet{self._mostly_refused(JOINTS)}"
            found = [InputWarning(WarningKind.MISSING, JOINTS, text)]
        else:
            others = [self._stream_warning(each) for each in streams.values() if each.expected and each.name != JOINTS]
            found = [each for each in others if each is not None]
            found += [] if self.predictor.computed is None else self.predictor.computed.warnings()
        given = self.config.model.of_the_point_mass
        if given and self.predictor.model.turning:
            text = f"model.{', model.'.join(given)}: of the paper's model, which trunk_rotation replaces"
            found.append(InputWarning(WarningKind.NO_USE, "", text))
        if self.config.prediction.adapt and self.predictor.adaptation is None:
            found.append(InputWarning(WarningKind.NO_USE, "", "prediction.adapt: it is not for the point mass"))
        notes = [] if self.monitor is None else self.monitor.laws.notes
        found += [InputWarning(WarningKind.BASELINE, "", f"monitor.baseline: {note}") for note in notes]
        zeros = self.predictor.zeros
        refused = self.joiner.possible.beyond
        beyond = {name: each for name, each in refused.items() if each.count > streams[name].accepted}
        suspect = self.plausibility.warnings({foot: zeros.of(foot)[2] for foot in WRENCHES}, beyond)
        # One sentence for one cause: zeros and biases are not what they seem where a sign or a unit is wrong.
        causes = [each for each in suspect if each.prevents_diagnosis]
        if causes:  # a stream that holds nothing usable for this reason
            return [each for each in found if each.stream not in beyond] + causes
        return [*found, *zeros.warnings(), *suspect]

    def _mostly_refused(self, stream: str) -> str:
        """Why most messages of a stream were refused, after a colon; empty if there were none."""
        rejections = self.joiner.rejections
        of_stream = {key: n for key, n in rejections.counts.items() if key.rpartition("/")[0] == stream}
        if not of_stream:
            return ""
        return f": {rejections.last[max(of_stream, key=lambda key: of_stream[key])].removeprefix(f'{stream}: ')}"

    def _stream_warning(self, stream: StreamStatus) -> InputWarning | None:
        """What is wrong with a stream that the predictions need beside the joint states."""
        name, limits, lead = stream.name, self.config.streams, self.joiner.clock_lead_s.get(stream.name, 0.0)
        if not stream.accepted:
            text = f"{name}: no usable message yet, and the predictions need it{self._mostly_refused(name)}"
            return InputWarning(WarningKind.MISSING, name, text)
        if stream.age_s > limits.restart_gap and abs(lead) < limits.restart_gap:
            text = f"{name}: no message for the last {stream.age_s:.2f} s of {JOINTS}"
            return InputWarning(WarningKind.STOPPED, name, text)
        return clock_apart(name, lead, limits.max_wait)
