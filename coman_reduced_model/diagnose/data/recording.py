# SPDX-License-Identifier: BSD-3-Clause
"""A bag as arrays on one clock: what the structured residuals are computed from.

The samples are those that the predictor would get (the same joiner), put on a uniform grid. The IMU, which the joiner
only takes at its nearest message, is interpolated here: a few milliseconds matter when delays are looked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...bag.session import Session
from ...core.base.input_warning import WarningKind
from ...core.base.stream_names import IMU
from ...core.base.types import Array, Booleans, Foot, Integers, Phase, Sample
from ...core.config.schema import Config
from ...core.effects.base import Effect
from ...core.measured.odometry import FootOdometry
from ...core.measured.support import SupportDetector
from ...core.predictor import Predictor
from ...core.robot.robot import Robot
from ...errors import BagError
from ...progress import Progress
from ...topics import TopicNames
from .computed import NOT_SHOWN, with_computed_wrenches
from .streams import (
    LEAST_THERE,
    PAUSE,
    clocks_apart,
    longest_run,
    near,
    resample,
    rising,
    rows_of,
    seldom_there,
    there,
    up_by_imu,
)
from .torques import from_deflection

RATE = 200.0  # [Hz] of the grid; nothing that is looked for is faster
_SHORTEST = 2.0  # [s] of recording
_SETTLED, _SWINGS = 0.1, 3  # [s] after and before a contact; swings from which the zero's drift is known
_LIFTED = 1.0  # [s] of a foot in the air
_OF_SENSORS = (WarningKind.ZERO, WarningKind.BIAS, WarningKind.HELD)  # seen only once all samples are there
MENDED_FIRST = "until that is mended nothing can be learnt of the robot"
FEET = (Foot.LEFT, Foot.RIGHT)
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass(frozen=True)
class Recording:
    """One bag on a uniform grid of n times; joints in the order of `Robot.joint_names`.

    Attributes:
        name: of the bag.
        t: (n,) [s] since the first sample.
        q: (n, nj) link side [rad].
        tau: (n, nj) measured torques [Nm], NaN columns where a joint has none; None: no efforts at all.
        motor_q: (n, nj) motor side [rad]; None: no motor states.
        wrench: by foot (n, 6) force, torque of the ground at the sole, in its frame [N, Nm].
        up: (n, 3) against gravity by the IMU, in the root link's frame; None: no orientation.
        plan, moved: (n, 2) x, y of the COM in the frame of the stance sole, as com/reference plans it and as the motor
            side moved it [m]; None: not both are known.
        phase: (n,) of Phase; left_share: (n,).
        yaw: by foot (n,) of its sole in odom [rad], which is the predictor's: it starts at the first support sole.
        valid: (n,) bool, no gap here.
        count: (nj,) what one count of a link encoder is [rad]; 0 where none shows.
        period: between samples [s], in the median.
        computed: whether the wrenches are: laws that contain them say nothing then.
        turned: what makes its wrenches look turned about the vertical; empty: nothing.
        clocks: of the warnings, those of streams whose clocks are apart from that of the joint states.
    """

    name: str
    t: Array
    q: Array
    tau: Array | None
    motor_q: Array | None
    wrench: dict[Foot, Array]
    up: Array | None
    plan: Array | None
    moved: Array | None
    phase: Integers
    left_share: Array
    valid: Booleans
    count: Array
    yaw: dict[Foot, Array]
    warnings: tuple[str, ...] = ()
    period: float = 1.0 / RATE
    computed: bool = False
    turned: str = ""
    clocks: tuple[str, ...] = ()

    @property
    def rate(self) -> float:
        """Of the grid [Hz]."""
        return RATE

    @property
    def stride(self) -> int:
        """Grid points from one sample to the next; of slower streams the others lie on lines between samples."""
        return max(1, round(self.period * RATE))

    def changed(self, **fields: object) -> Recording:
        """A copy with other arrays: what a hypothesis makes of the measurement."""
        return replace(self, **fields)  # type: ignore[arg-type]


def load(
    path: str | Path,
    config: Config,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    progress: Progress | None = None,
) -> tuple[Recording, Robot]:
    """Read a bag; the robot has the loads, and the recording the corrections, of effects that are configured already.

    Raises:
        ComanError: the bag, the robot or the configuration cannot be used, or it is too short to say anything.
    """
    with Session(path, config, urdf=urdf, names=names) as session:
        bag, pipeline = session.bag, session.pipeline
        samples: list[Sample] = []
        imu: list[tuple[int, Array]] = []
        before: list[int] = []  # of each of these, how many samples there were
        imu_frame = ""
        span = max(bag.end_ns - bag.start_ns, 1)
        arrived: dict[str, list[tuple[int, int]]] = {}  # by stream: log times, and stamps
        for count, (stream, log_time, raw) in enumerate(session.messages()):
            if stream == IMU:
                try:
                    message = session.decoders[IMU](raw)
                except Exception:  # counted by the pipeline on the way that predicts
                    continue
                arrived.setdefault(IMU, []).append((log_time, message.stamp_ns))
                if message.orientation is not None and np.isfinite(message.orientation).all():
                    imu.append((message.stamp_ns, message.orientation))
                    before.append(len(samples))
                    imu_frame = message.frame_id.lstrip("/")
            else:
                samples += pipeline.take(stream, raw, session.decoders[stream])
                known = pipeline.joiner.streams[stream]
                if known.last is not None:
                    arrived.setdefault(stream, []).append((log_time, known.last + known.late))
            if progress and count % 2000 == 0:
                progress((log_time - bag.start_ns) / span, f"reading {bag.path.name}")
        samples += pipeline.joiner.flush()
        for effect in pipeline.predictor.effects:
            if not of_world(type(effect)):
                for sample in samples:
                    effect.correct(sample)
        computed, measured, zeros = pipeline.predictor.computed, samples, np.zeros(2)
        begin, end, back = longest_run([sample.stamp_ns for sample in measured], config.streams.restart_gap)
        warnings = (*session.warnings, *_other_runs(measured[begin:end], back))
        if computed is None:
            zeros = _zeros(samples[begin:end], pipeline.predictor)
        else:
            samples = with_computed_wrenches(samples, computed, pipeline.robot, config)
            warnings = (*warnings, f"foot wrenches are computed from {config.streams.wrench_source}: {NOT_SHOWN}")
        imu = [each for count, each in zip(before, imu, strict=True) if begin <= count <= end]  # stamps may repeat
        for sample in measured[begin:end]:  # what is diagnosed
            pipeline.plausibility.update(sample, pipeline.predictor.zeros)
        found = pipeline.status().warnings
        suspect = [each for each in found if each.prevents_diagnosis]
        warnings = (*warnings, *(str(each) for each in found if each.kind in _OF_SENSORS))
        watched = pipeline.joiner.clock_lead_s  # by the pipeline itself
        arrived = {stream: each for stream, each in arrived.items() if stream not in watched}
        others = clocks_apart(arrived, config.streams.max_wait)
        warnings = (*warnings, *others)
        clocks = (*(str(each) for each in found if each.kind is WarningKind.CLOCK), *others)
        for warning in suspect:
            if warning.kind is not WarningKind.TURNED:
                raise BagError(f"{bag.path.name}: {warning}; {MENDED_FIRST}")
    robot = pipeline.robot
    recording = _grid(Path(path).name, samples[begin:end], zeros, imu, imu_frame, robot, config, warnings)
    return recording.changed(turned=str(suspect[0]) if suspect else "", clocks=clocks), robot


def _other_runs(samples: list[Sample], back: int) -> list[str]:
    """That there are others beside the longest run, of these samples."""
    if not back:
        return []
    lasts = 1e-9 * (samples[-1].stamp_ns - samples[0].stamp_ns)
    text = f"time goes back, or joint states pause for {PAUSE:g} s and more, {back} times: only the longest run"
    return [f"{text}, {lasts:.1f} s, is diagnosed"]


def of_world(kind: type[Effect]) -> bool:
    """Whether an effect of a configuration is part of the `World`; others are applied while a recording is read."""
    return kind.moves_com() and kind.load is Effect.load


def _zeros(samples: list[Sample], predictor: Predictor) -> Array:
    """(2,) what both sensors read vertically without load [N], where that is so much that it hides the phases.

    As the predictor learns it, in the end. Only phases are freed of it: zeros are unknowns of the diagnosis.
    """
    for sample in samples:
        predictor.link.update(sample.q, sample.qd)
        predictor.zeros.corrected(sample, predictor.link)
    return predictor.zeros.both[[2, 8]]  # of those that explain something


def _grid(
    name: str,
    samples: list[Sample],
    zeros: Array,
    imu: list[tuple[int, Array]],
    imu_frame: str,
    robot: Robot,
    config: Config,
    warnings: tuple[str, ...],
) -> Recording:
    complete = [s for s in samples if s.left_wrench is not None and s.right_wrench is not None]
    if len(complete) < 10 or (complete[-1].stamp_ns - complete[0].stamp_ns) * 1e-9 < _SHORTEST:
        why = f" ({warnings[0]})" if warnings else ""
        text = f"{name}: less than {_SHORTEST:g} s of joint states with both wrenches: nothing to diagnose{why}"
        raise BagError(text)
    stamps = np.array([s.stamp_ns for s in complete])
    order = np.flatnonzero(rising(stamps))
    complete, stamps = [complete[i] for i in order], stamps[order]
    at = (stamps - stamps[0]) * 1e-9
    period = float(np.median(np.diff(at)))
    t = np.arange(0.0, at[-1], 1.0 / RATE)
    valid = near(at, t)

    def used(values: Array | None, where: Booleans, name: str) -> Array | None:
        """The values of a stream, where it is there most of the time; what it lacks is a gap of the recording."""
        nonlocal valid, warnings
        if values is None or where.all():
            return values
        if where.mean() < LEAST_THERE:
            warnings = (*warnings, f"{name} are there {where.mean():.0%} of the time: too little, they are not used")
            return None
        valid &= where
        return values

    rows = {field: rows_of(complete, field) for field in ("left_wrench", "right_wrench", "q", "motor_q", "tau")}
    left, right, q, motor_q, tau = (None if each is None else resample(at, each, t) for each in rows.values())
    assert left is not None and right is not None and q is not None
    forces = np.array([[s.left_wrench[2], s.right_wrench[2]] for s in complete]) - zeros  # type: ignore[index]
    phases, shares, supports = _phases(stamps, forces, robot.mass * config.robot.gravity, config)
    later = np.searchsorted(at, t).clip(0, len(at) - 1)  # the sample at each time, or after it
    for wrench, other in ((left, Phase.RIGHT), (right, Phase.LEFT)):
        wrench -= _drift(wrench, phases[later] == other)
    motor_q = used(motor_q, there(at, rows["motor_q"], t), "motor states")
    if rows["tau"] is not None and tau is not None and (seldom := _seldom(rows["tau"])).any():
        tau[:, seldom] = np.nan
        named = ", ".join(name for name, one in zip(robot.joint_names, seldom, strict=True) if one)
        warnings = (*warnings, f"torques of {named} are there less than {LEAST_THERE:.0%} of the time: not used")
    tau = used(_efforts(tau), there(at, rows["tau"], t), "joint torques")
    counts = _counts(np.array([s.q for s in complete]))
    if tau is not None and from_deflection(rows["tau"], rows["motor_q"], rows["q"], counts):
        tau = None
        warnings = (*warnings, "torques are computed from the springs' deflection: no measurement, they are not used")
    up = used(*up_by_imu(imu, stamps[0], t, robot, imu_frame, q), "orientations of the IMU")
    plan, moved, planned = _plan(complete, phases, shares, robot, at, t)
    if used(plan, planned, "motor states and com/reference together") is None:
        plan = moved = None
    every = np.array([s.stamp_ns for s in samples])
    restarts = every[1:][np.diff(every) > 1e9 * config.streams.restart_gap]  # as the predictor does
    begins = np.searchsorted(restarts, stamps[0] + 1e9 * t, side="right")
    return Recording(
        name, t, q, tau, motor_q,
        {Foot.LEFT: left, Foot.RIGHT: right}, up, plan, moved,
        phases[later],
        np.interp(t, at, np.nan_to_num(shares, nan=0.5)),
        valid, counts, _yaws(robot, q, supports[later], begins),
        warnings, period, config.streams.wrench_source != "sensors",
    )  # fmt: skip


def _phases(stamps: Array, forces: Array, weight: float, config: Config) -> tuple[Integers, Array, Integers]:
    """Phase, load share, support foot (n,) from vertical forces (n, 2) [N] of left and right."""
    detector = SupportDetector(config.support, weight)
    states = [detector.update(stamp, *pair) for stamp, pair in zip(stamps.tolist(), forces.tolist(), strict=True)]
    phases, shares, feet = zip(*((s.phase, s.left_share, s.support_foot) for s in states), strict=True)
    return np.array(phases), np.array(shares), np.array(feet)


def _drift(wrench: Array, air: Booleans) -> Array:
    """(n, 6) by which the zero of a foot sensor differs from its mean, by what it reads in the air; 0: not known.

    The mean is an unknown of the diagnosis.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], air, [False]]).astype(int)))
    times, zeros = [], []
    for begin, end in edges.reshape(-1, 2):
        inside = slice(begin + round(_SETTLED * RATE), end - round(_SETTLED * RATE))
        if inside.stop - inside.start >= round(_SETTLED * RATE):
            times.append(0.5 * (inside.start + inside.stop))
            zeros.append(np.median(wrench[inside], axis=0))
    if len(times) < _SWINGS:
        return np.zeros_like(wrench)
    values = np.array(zeros) - np.mean(zeros, axis=0)
    return np.column_stack([np.interp(np.arange(len(wrench)), times, column) for column in values.T])


def _plan(
    samples: list[Sample], phases: Integers, shares: Array, robot: Robot, at: Array, t: Array
) -> tuple[Array | None, Array | None, Booleans]:
    """Planned and motor-side COM (n, 2) in the stance sole, at the grid's times; where both are there."""
    if not any(s.reference is not None and s.motor_q is not None for s in samples):
        return None, None, np.zeros(len(t), dtype=bool)
    motors = robot.posture()
    rows = np.full((len(samples), 4), np.nan)
    still = np.zeros(len(robot.joint_names))
    for i, (sample, phase, share) in enumerate(zip(samples, phases, shares, strict=True)):
        if sample.reference is None or sample.motor_q is None:
            continue
        left = phase == Phase.LEFT or (phase != Phase.RIGHT and share >= 0.5)
        foot = Foot.LEFT if left else Foot.RIGHT
        T = sample.reference.sole_pose(foot)
        motors.update(sample.motor_q, still)
        com, _ = motors.com_in_sole(foot)
        rows[i, :2], rows[i, 2:] = (T[:3, :3].T @ (sample.reference.com - T[:3, 3]))[:2], com[:2]
    values = resample(at, rows, t)
    return values[:, :2], values[:, 2:], there(at, rows, t)


def _yaws(robot: Robot, q: Array, supports: Array, begins: Array) -> dict[Foot, Array]:
    """Yaw (n,) [rad] in odom of each sole, by joints q (n, nj) and support feet (n,).

    Where the number `begins` (n,) changes, odom starts again.
    """
    posture, odometry, still = robot.posture(), FootOdometry(), np.zeros(q.shape[1])
    out = {foot: np.zeros(len(q)) for foot in FEET}
    for i, support in enumerate(map(Foot, supports.tolist())):
        if i and begins[i] != begins[i - 1]:
            odometry.reset()
        if support == Foot.NONE:
            continue
        posture.update(q[i], still)
        T = odometry.update(support, *(x for foot in FEET for x in (posture.R[foot], posture.p[foot])))
        R, _ = posture.sole_to_sole(support, support.other)
        out[support][i] = np.arctan2(T[1, 0], T[0, 0])
        out[support.other][i] = out[support][i] + np.arctan2(R[1, 0], R[0, 0])
    return out


def _counts(q: Array) -> Array:
    """(nj,) resolution that positions (n, nj) show: the gap between neighbouring values that come again and again."""
    out = np.zeros(q.shape[1])
    for j in range(q.shape[1]):
        values = np.unique(np.round(q[:, j], 9))
        gaps = np.diff(values)
        if 2 <= len(values) < 0.8 * len(q) and gaps.size:
            out[j] = np.percentile(gaps, 10.0)
    return out


def _seldom(tau: Array) -> Booleans:
    """(nj,) joints whose torques (n, nj) are there, and seldom."""
    return np.asarray(seldom_there(tau) & np.isfinite(tau).any(axis=0))


def _efforts(tau: Array | None) -> Array | None:
    """NaN where a joint measures none, which a driver may also say by zeros; None where no joint does."""
    if tau is None:
        return None
    measured = (np.abs(np.diff(tau, axis=0)) > 0.0).any(axis=0)
    return np.where(measured, tau, np.nan) if measured.any() else None


def lifts_a_foot(phase: Integers) -> bool:
    """Whether a foot is in the air for some time: what only stands excites nothing."""
    return bool(np.isin(phase, (Phase.LEFT, Phase.RIGHT)).sum() > _LIFTED * RATE)


def moving(phase: Integers) -> bool:
    """Whether it walks: both feet are in the air some time."""
    return bool((phase == Phase.LEFT).any() and (phase == Phase.RIGHT).any())
