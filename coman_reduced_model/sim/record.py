# SPDX-License-Identifier: BSD-3-Clause
"""Walks the virtual robot and records what it publishes as a bag, and the truth beside it.

The truth is a file of its own next to the bag (`OUT.truth.npz`), which nothing that predicts or diagnoses reads.
"""

from __future__ import annotations

import heapq
import math
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import count, repeat
from pathlib import Path
from typing import Any

import numpy as np

from ..bag.encode_input import ENCODE
from ..bag.types import bag_types
from ..bag.writer import BagWriter
from ..core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ..core.base.types import Foot, Reference
from ..core.gait.gait import WalkPlan, plan_walk
from ..core.gait.parameters import GaitParameters, gait
from ..errors import ConfigError, OutputError
from ..messages import INPUT_TYPES, STRING
from ..output import OutputFolder, check_file
from ..progress import Progress
from ..topics import DESCRIPTION, INPUT_TOPICS
from .contact import Contact, Floor
from .controller import Controller
from .describe import urdf
from .disturbances import Disturbance
from .motion import MotorMotion, plan_motion
from .motors import MotorOptions
from .robot_table import COMAN, ROBOTS, RobotTable
from .sensors import Readings, SensorOptions
from .upper_motion import UpperMotion
from .virtual_robot import Motion, Truth, VirtualRobot

REFERENCE_RATE = 200.0  # [Hz] of com/reference at most
PREVIEW_DT, PREVIEW_N = 0.02, 25  # half a second: farther than any horizon
BLOCK = 200  # sensor periods of which the plan is computed at once
CONTACT_FORCE = 1.0  # [N] above which the truth says that a foot touches the floor


@dataclass(frozen=True)
class RecordedBag:
    """What `record` made."""

    bag: Path
    truth: Path
    duration_s: float
    messages: dict[str, int]  # by topic
    fallen_s: float | None  # when the robot fell; None: it did not
    realtime_factor: float


def suiting(table: RobotTable, name: str) -> dict[str, float]:
    """What suits a robot, but for what makes the named gait: `wide` is wider than its usual step."""
    usual, named = GaitParameters(), gait(name)
    return {key: value for key, value in table.gait.items() if getattr(named, key) == getattr(usual, key)}


def check_duration(duration_s: float | None) -> None:
    """Refuse what is no duration [s]; None: it is not given.

    Raises:
        ConfigError: it is not positive, or not finite.
    """
    if duration_s is not None and not 0.0 < duration_s < math.inf:
        raise ConfigError(f"duration: {duration_s:g} s (allowed: a positive number)")


def robot_gait(table: RobotTable, name: str, duration_s: float | None = None, **overrides: Any) -> GaitParameters:
    """A named gait with the figures that suit a robot (RobotTable.gait).

    Args:
        table: the robot.
        name: one of core.gait.GAITS.
        duration_s: about how long the plan shall last: sets the number of steps, or the time that it stands.
        overrides: other gait parameters; they go first.

    Raises:
        ConfigError: an unknown gait, a value out of range, or a duration too short for a step.
    """
    p = gait(name, **{**suiting(table, name), **overrides})
    check_duration(duration_s)
    if duration_s is None:
        return p
    if p.steps == 0:
        return replace(p, stand_before_s=duration_s / 2.0, stand_after_s=duration_s / 2.0)
    walking = duration_s - p.stand_before_s - p.stand_after_s - p.double_support_s
    steps = int((walking + 1e-6) / (p.single_support_s + p.double_support_s))
    if steps < 1:
        shortest = duration_s - walking + p.single_support_s + p.double_support_s
        raise ConfigError(f"duration: {duration_s:g} s is too short for a step (allowed: {shortest:g} s and more)")
    return replace(p, steps=steps)


def sway(plan: WalkPlan) -> WalkPlan:
    """A standing plan whose COM moves slowly in all directions: quasi-static load on every spring, both feet flat.

    15 mm fore and aft, 20 mm to the sides, 16 mm down, each at a frequency of its own below 0.4 Hz. The first and
    the last two seconds are still.
    """
    t = np.linspace(0.0, plan.duration_s, max(int(np.ceil(plan.duration_s / 0.01)), 2) + 1)
    ends = np.clip(np.minimum(t, plan.duration_s - t) / 2.0 - 1.0, 0.0, 1.0)
    window = ends**3 * (10.0 + ends * (6.0 * ends - 15.0))
    amplitude, frequency = np.array([0.015, 0.020, -0.008]), np.array([0.21, 0.13, 0.34])
    moved = window[:, None] * amplitude * np.sin(2.0 * np.pi * frequency * t[:, None])
    moved[:, 2] -= 0.008 * window  # only downwards: upwards the knees would straighten
    return plan.with_com(t, plan.sample_many(t).com + moved)


def record(
    walk: str | GaitParameters,
    out: str | Path,
    robot: str | RobotTable = COMAN,
    sensors: SensorOptions | None = None,
    disturbances: Sequence[Disturbance] = (),
    motors: MotorOptions | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    changes: Mapping[str, Any] | None = None,
    sag: float = 0.8,
    force: bool = False,
    progress: Progress | None = None,
    planned: tuple[MotorMotion, WalkPlan] | None = None,
    upper: UpperMotion | None = None,
    contact: Contact | None = None,
    floor: Floor | None = None,
    controller: Controller | None = None,
    engine: str = "mujoco",
    reference: bool = True,
) -> RecordedBag:
    """Plans a gait, walks the virtual robot through it, writes the bag `out` and the truth `out`.truth.npz.

    Args:
        walk: name of a gait (`robot_gait` chooses the rest), or parameters. Without steps the robot sways slowly.
        out: folder of the bag.
        robot: a name in `ROBOTS` or a table.
        sensors: default: SensorOptions().
        disturbances: hidden effects.
        motors: None: they follow their references exactly.
        seed: of all random numbers.
        duration_s: see robot_gait; only with the name of a gait.
        changes: other parameters of the named gait.
        sag: see plan_motion.
        force: replace an existing bag.
        progress: called now and then.
        planned: what `plan_recording` makes of the same walk and robot, if it is known already.
        upper: how the upper body moves, if the robot has one.
        contact, floor, controller, engine: see VirtualRobot.
        reference: whether `com/reference` is published.

    Raises:
        ConfigError: the gait, the robot or an option is not possible.
        OutputError: `out` exists, or cannot be written.
    """
    if isinstance(robot, str):
        if robot not in ROBOTS:
            raise ConfigError(f"robot: {robot!r} is not allowed (allowed: {', '.join(ROBOTS)})")
        robot = ROBOTS[robot]
    if isinstance(walk, str):
        walk = robot_gait(robot, walk, duration_s, **(changes or {}))
    elif duration_s is not None or changes:
        raise ConfigError("duration, changes: only with a named gait; GaitParameters have all of it")
    world = {"contact": contact, "floor": floor, "controller": controller, "engine": engine}
    body = VirtualRobot(robot, sensors, disturbances, motors, seed, **world)  # type: ignore[arg-type]
    destination = _Destination(out, force)
    if progress:
        progress(0.0, "planning the motion")
    motion, plan = planned or plan_recording(walk, robot, sag, upper, floor)
    return _run(body, motion, plan if reference else None, destination, plan.duration_s, progress)


def plan_recording(
    walk: GaitParameters,
    robot: RobotTable,
    sag: float = 0.8,
    upper: UpperMotion | None = None,
    floor: Floor | None = None,
) -> tuple[MotorMotion, WalkPlan]:
    """Motion of the motors and plan of a gait, for the slope and the heights of a floor; the arguments of `record`."""
    plan = plan_walk(walk)
    if floor is not None and (floor.kerb or floor.platform):
        plan = plan.on_floor(floor.height)
    if walk.steps:
        return plan_motion(robot, plan, sag, upper=upper, floor=floor)
    return plan_motion(robot, sway(plan), sag, passes=0, upper=upper, floor=floor)


def record_motion(
    robot: VirtualRobot,
    motion: Motion,
    out: str | Path,
    duration_s: float,
    force: bool = False,
    progress: Progress | None = None,
) -> RecordedBag:
    """The same for any motion of the motors (see VirtualRobot.reset), such as the experiments that identify springs.

    There is no plan then, and no com/reference in the bag.
    """
    return _run(robot, motion, None, _Destination(out, force), duration_s, progress)


class _Destination:
    """Where bag and truth go; both are there at the end, or neither."""

    def __init__(self, out: str | Path, force: bool) -> None:
        self.bag = Path(out)
        if not self.bag.name:
            raise OutputError(f"{out}: no name for a bag")
        self.truth = self.bag.with_name(f"{self.bag.name}.truth.npz")
        check_file(self.truth, force)
        self._folder = OutputFolder(self.bag, force)
        self._partial = self.truth.with_name(f".part.{self.truth.name}")

    def __enter__(self) -> tuple[Path, Path]:
        """Where the folder of the bag, and the file of the truth, are written first."""
        return self._folder.__enter__(), self._partial

    def __exit__(self, *error: object) -> None:
        try:
            self._folder.__exit__(*error)
            if error[0] is None:
                self._partial.replace(self.truth)
        except OSError as failed:
            raise OutputError(f"{self.truth}: cannot be written: {failed.strerror or failed}") from None
        finally:
            self._partial.unlink(missing_ok=True)


def _run(
    robot: VirtualRobot,
    motion: Motion | MotorMotion,
    plan: WalkPlan | None,
    destination: _Destination,
    duration_s: float,
    progress: Progress | None,
) -> RecordedBag:
    names = {stream: f"/{topic}" for stream, topic in INPUT_TOPICS.items() if plan or stream != REFERENCE}
    if not robot.sensors.options.contact_switches:
        names.pop(CONTACTS, None)
    topics = {f"/{DESCRIPTION}": STRING, **{name: INPUT_TYPES[stream] for stream, name in names.items()}}
    truths: list[Truth] = []
    fallen = None
    began = time.perf_counter()
    with destination as (temporary, truth):
        inner = temporary / destination.bag.name
        with BagWriter(inner, topics, latched=(f"/{DESCRIPTION}",)) as bag:
            bag.write(f"/{DESCRIPTION}", robot.start_ns, bag_types().String(data=urdf(robot.table)))
            robot.reset(motion)
            stream = _Stream(bag, names, robot, plan)
            for k in range(round(duration_s / robot.period)):
                stream.add(robot.step())
                truths.append(robot.truth)  # type: ignore[arg-type]
                if fallen is None and robot.fallen:
                    fallen = robot.t
                if fallen is not None and robot.t > fallen + 1.0:
                    break
                if progress and k % 100 == 0:
                    progress(robot.t / duration_s, f"{robot.t:.0f} of {duration_s:.0f} s")
            stream.flush()
        for path in list(inner.iterdir()):  # the bag is the folder that the user named, not one in it
            shutil.move(path, temporary / path.name)
        inner.rmdir()
        try:
            save_truth(truth, truths, robot)
        except OSError as error:
            raise OutputError(f"{destination.truth}: cannot be written: {error.strerror or error}") from None
    if progress:
        progress(1.0, "done")
    factor = robot.t / (time.perf_counter() - began)
    return RecordedBag(destination.bag, destination.truth, robot.t, bag.counts, fallen, factor)


class _Stream:
    """Messages in the order in which they reach the bag."""

    def __init__(self, bag: BagWriter, names: dict[str, str], robot: VirtualRobot, plan: WalkPlan | None) -> None:
        self._bag, self._names, self._robot = bag, names, robot
        self._latency = round(1e9 * robot.sensors.options.latency_s)
        self._pending: list[tuple[int, int, str, bytes]] = []
        self._order = count()
        self._references = _references(plan, robot) if plan else repeat(None)

    def add(self, readings: Readings) -> None:
        """One period's readings, and the point of the plan for it."""
        for stream, message in (
            (JOINTS, readings.joint_states),
            (MOTORS, readings.motor_states),
            (WRENCHES[Foot.LEFT], readings.left_wrench),
            (WRENCHES[Foot.RIGHT], readings.right_wrench),
            (IMU, readings.imu),
            (CONTACTS, readings.contacts),
        ):
            if message is not None:
                self._push(stream, message.stamp_ns + self._latency, message)
        if (reference := next(self._references)) is not None:
            self._push(REFERENCE, reference.stamp_ns, reference)
        # Nothing of a later period is stamped a whole period before it begins.
        self.flush(self._robot.start_ns + round(1e9 * (readings.t - self._robot.period)))

    def _push(self, stream: str, log_time_ns: int, message: Any) -> None:
        heapq.heappush(self._pending, (log_time_ns, next(self._order), self._names[stream], ENCODE[stream](message)))

    def flush(self, until_ns: int | None = None) -> None:
        """Write what is due by then, or everything."""
        while self._pending and (until_ns is None or self._pending[0][0] <= until_ns):
            log_time, _, topic, data = heapq.heappop(self._pending)
            self._bag.write_raw(topic, max(log_time, self._robot.start_ns), data)


def _references(plan: WalkPlan, robot: VirtualRobot) -> Iterator[Reference | None]:
    """The plan at each sensor period, or None where none is due; without end."""
    every = max(1, math.ceil(1.0 / (robot.period * REFERENCE_RATE) - 1e-9))
    step = robot.model.opt.timestep * robot.sensors.steps
    for first in count(0, BLOCK):
        t = step * np.arange(first, first + BLOCK)[-first % every :: every]
        stamps = [robot.start_ns + round(1e9 * each) for each in t]
        due = iter(plan.references(t, stamps, PREVIEW_DT, PREVIEW_N))
        for k in range(first, first + BLOCK):
            if k % every:
                yield None
                continue
            point = next(due)
            if not plan.parameters.steps:  # the ZMP of a sway is where its COM has it
                height = point.com[2] - point.zmp[2]
                point.zmp[:2] = point.com[:2] - height / plan.parameters.gravity * point.com_acc[:2]
            yield point


def save_truth(path: str | Path, truths: Sequence[Truth], robot: VirtualRobot) -> None:
    """Writes truths, one row a sensor period, as arrays by the names of the fields of Truth (float32 but for t).

    Besides: stamp_ns, contact (n, 2: left, right), joint_names, stiffness and damping of the joints, disturbances, and
    gravity (3,) in the world [m/s^2], whose z is that of the floor.
    """
    arrays: dict[str, Any] = {
        f.name: np.array([getattr(truth, f.name) for truth in truths], dtype=np.float32) for f in fields(Truth)
    }
    arrays["t"] = np.array([truth.t for truth in truths])
    arrays["stamp_ns"] = robot.start_ns + np.round(1e9 * arrays["t"]).astype(np.int64)
    arrays["contact"] = np.column_stack([arrays["left_wrench"][:, 2], arrays["right_wrench"][:, 2]]) > CONTACT_FORCE
    arrays["joint_names"] = np.array(robot.table.joint_names)
    arrays["gravity"] = np.array(robot.model.opt.gravity)
    arrays["stiffness"], arrays["damping"] = robot.stiffness, robot.damping
    arrays["disturbances"] = np.array([repr(disturbance) for disturbance in robot.disturbances])
    np.savez_compressed(path, **arrays)


def load_truth(path: str | Path) -> dict[str, Any]:
    """The arrays of a truth file."""
    with np.load(path, allow_pickle=False) as file:
        return dict(file)
