# SPDX-License-Identifier: BSD-3-Clause
"""The virtual robot in real time: follows com/reference, publishes what a robot would.

`ros2 run coman_reduced_model virtual_robot`
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from coman_reduced_model_msgs.msg import ComReference, FootContacts
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String

from ...core.base.stream_names import CONTACTS, IMU, JOINTS, MOTORS, REFERENCE, WRENCHES
from ...core.base.types import Foot, Reference
from ...core.config.schema import Config
from ...core.gait.walk import Walk, gait_of
from ...core.streams.stream import Refused
from ...errors import ConfigError, EngineError
from ...messages import contacts_to, imu_to, joint_from, joint_to, reference_from, ros_types, stamp_of, wrench_to
from ...sim.describe import urdf
from ...sim.motion import LegKinematics
from ...sim.robot_table import COMAN, ROBOTS
from ...sim.sensors import Readings, SensorOptions
from ...sim.upper_motion import stride_s
from ...sim.worlds import World, robot_of, world_for
from ...topics import DESCRIPTION, INPUT_TOPICS, PLANNED_DEFLECTION
from ..interface import qos
from ..interface.diagnostic_report import IN_TIME, REAL_TIME
from ..interface.parameters import ConfiguredNode, Own, declare
from ..interface.report_timer import ReportTimer
from .planned_lead import PlannedLead
from .stream_motion import DELAY_NS, SPACING_NS, StreamMotion, at_rest

NAME = "virtual_robot"
OWN = Own(
    names=("virtual_robot.", "gait.", "robot.name", "robot.gravity", "output.diagnostics_rate"),
    changing=("output.diagnostics_rate",),
)
_HOPELESS_NS = 3_000_000_000  # so far behind, the robot's time is set forward, and that is said
_PATIENCE_NS = 500_000_000  # so long the robot waits for late references


class VirtualRobotNode(ConfiguredNode):
    """Adapter around the virtual robot of a world; its stamps are the simulated time, which follows the clock."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._timer = ReportTimer(self, self._report)
        self.config = declare(self, OWN, self._on_config)
        self.types = ros_types()
        self.world = self._world()
        self.table = self.world.table
        self._legs = LegKinematics(self.table)
        self._planned = PlannedLead(self.table.joint_names) if self.config.virtual_robot.compensate else None
        self._received = self._refused = self._skipped = self._places = 0
        self._placing_ns = 300_000_000  # what the last placing took: the robot settles on its springs meanwhile
        self._problem = ""
        self._following = False  # a robot can only set off where the plan stands still
        self._periods = 0
        self._last_report = time.monotonic()
        self._advertise()
        self.todo = self._begin

    def _world(self) -> World:
        """The world that the parameters name; by default the plain virtual robot, without tolerances.

        Raises:
            ConfigError: there is none of that name, or it has another robot than the configuration.
        """
        options, name = self.config.virtual_robot, self.config.robot.name
        if not options.world:
            kind = SensorOptions if options.noise else SensorOptions.exact
            robot = name if name in ROBOTS else COMAN.name
            return World(robot=robot, sensors=kind(rate_hz=options.rate), tolerances=False)
        return world_for(name, options.world)

    def _advertise(self) -> None:
        def publisher(kind: type, topic: str) -> Any:
            return self.create_publisher(kind, topic, qos.sensor_output(), qos_overriding_options=qos.overridable())

        self._joints, self._motors = publisher(JointState, JOINTS), publisher(JointState, MOTORS)
        self._wrenches = {foot: publisher(WrenchStamped, topic) for foot, topic in WRENCHES.items()}
        self._contacts = publisher(FootContacts, CONTACTS)
        self._imu = publisher(Imu, INPUT_TOPICS[IMU])
        self._description = self.create_publisher(String, DESCRIPTION, qos.latched())
        self._description.publish(String(data=urdf(self.table)))
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.display_output())

    def _begin(self) -> None:
        self._first = Walk(self.config).reference(0)
        self._place(self._first)
        self.create_subscription(
            ComReference, REFERENCE, self._on_reference, qos.sensor_input(), qos_overriding_options=qos.overridable()
        )
        if self._planned is not None:
            self.create_subscription(
                JointState, PLANNED_DEFLECTION, self._on_planned, qos.sensor_input(),
                qos_overriding_options=qos.overridable(),
            )  # fmt: skip
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self.world.sensors.rate_hz, self._tick, clock=steady)
        self._timer.set_rate(self.config.output.diagnostics_rate)
        gc.collect()
        gc.freeze()
        self.get_logger().info(f"ready: {self.table.name}, {self.table.mass:.2f} kg, waiting for com/reference")

    def _on_config(self, config: Config) -> None:
        self.config = config
        self._timer.set_rate(config.output.diagnostics_rate)

    def _place(self, reference: Reference) -> None:
        """Put the robot where a reference has it, at rest: it waits for a plan that stands still.

        Raises:
            ConfigError: the legs cannot reach it; the robot stays where it is.
        """
        began = time.monotonic()
        start = self._now() - DELAY_NS + self._placing_ns  # from when on it can walk
        seed = self.config.virtual_robot.seed + self._places
        robot = robot_of(self.world, seed=seed, start_ns=start)
        stride = stride_s(gait_of(self.config))
        lead = self.config.virtual_robot.lead
        motion = StreamMotion(self._legs, reference, start, self.world.upper, stride, lead, self._planned)
        robot.reset(motion, motion.start)
        self.robot, self.motion, self._start, self._following = robot, motion, start, False
        self._places += 1
        self._placing_ns = round(1.2e9 * (time.monotonic() - began))

    def _place_again(self, last: Reference) -> None:
        """Put the robot where the last reference has it, or where it stood first if the legs cannot reach that."""
        try:
            self._place(last)
        except ConfigError as error:
            self._problem = str(error)
            self._place(self._first)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_reference(self, message: ComReference) -> None:
        self._received += 1
        if self._following and 0 < stamp_of(message.header) - self.motion.last.stamp_ns < SPACING_NS // 2:
            return  # not the next knot by far: not worth converting
        try:
            reference = reference_from(message)
            if self._following and not self.robot.fallen and not self.motion.jumps(reference):
                self.motion.add(reference)
            elif at_rest(reference):
                if self.robot.fallen or self.motion.jumps(reference):
                    self._place(reference)
                self._following = True
            else:
                self._following = False
        except (Refused, ConfigError, ValueError) as error:
            self._refused += 1
            self._problem = str(error)

    def _on_planned(self, message: JointState) -> None:
        assert self._planned is not None
        try:
            self._planned.add(joint_from(message))
        except Refused as error:
            self._problem = str(error)

    def _tick(self) -> None:
        target = self._now() - DELAY_NS
        if self._following and not at_rest(self.motion.last) and target - self.motion.known_ns < _PATIENCE_NS:
            target = min(target, self.motion.known_ns)  # late references: wait, rather than stop in mid-step and fall
        lag = self._now() - DELAY_NS - self._stamp()
        if lag > _HOPELESS_NS:
            self._skip(lag)
        elif lag < -_HOPELESS_NS:  # the clock was set back: its stamp would be later than those of the next plan
            self._place_again(replace(self.motion.last, stamp_ns=0))
        for _ in range(20):  # then other callbacks have their turn
            if self._stamp() > target:
                break
            try:
                readings = self.robot.step()
            except EngineError as error:
                self.get_logger().warning(f"{error}; the robot stands again")
                self._place_again(self.motion.last)
                break
            self._publish(readings)
            self._periods += 1

    def _stamp(self) -> int:
        return self._start + round(self.robot.t * 1e9)

    def _skip(self, lag: int) -> None:
        """Too slow: say it and place the robot again in the present, rather than drift."""
        self._skipped += 1
        self.get_logger().warning(
            f"too slow for real time: {lag * 1e-9:.1f} s behind, set forward (lower virtual_robot.rate, or a faster "
            "machine)"
        )
        self._place_again(self.motion.last)

    def _publish(self, readings: Readings) -> None:
        types = self.types
        streams: tuple[tuple[Any, Any, Callable[..., Any]], ...] = (
            (self._wrenches[Foot.LEFT], readings.left_wrench, wrench_to),
            (self._wrenches[Foot.RIGHT], readings.right_wrench, wrench_to),
            (self._imu, readings.imu, imu_to),
            (self._contacts, readings.contacts, contacts_to),
            (self._motors, readings.motor_states, joint_to),
            (self._joints, readings.joint_states, joint_to),
        )
        for publisher, message, convert in streams:
            if message is not None:
                publisher.publish(convert(types, message))

    def _report(self) -> None:
        now = time.monotonic()
        seconds, self._last_report = now - self._last_report, now
        factor, self._periods = self._periods * self.robot.period / seconds, 0
        lag = (self._now() - DELAY_NS - self._stamp()) * 1e-9
        level, message = DiagnosticStatus.OK, "follows com/reference"
        if self.robot.fallen:
            level, message = DiagnosticStatus.ERROR, "has fallen; it stands up when the plan stands still"
        elif not self._received:
            message = "stands, waiting for com/reference"
        elif not self._following:
            level, message = DiagnosticStatus.WARN, "stands, waiting for the plan to stand still (trajectory: ~/reset)"
        elif lag > 0.1:
            level, message = DiagnosticStatus.WARN, f"cannot keep real time: {lag:.2f} s behind"
        elif self._problem:
            level, message = DiagnosticStatus.WARN, f"reference refused: {self._problem}"
        values = {
            REAL_TIME: f"{factor:.3f}",
            "lag [s]": f"{max(lag, 0.0):.4f}",
            "set forward": self._skipped,
            "references received": self._received,
            "references refused": self._refused,
        }
        if self._planned is not None:
            values["share of the lead that is compensated"] = f"{self._planned.share:.2f}"
            values[IN_TIME] = f"{self._planned.in_time / max(1, self._planned.asked):.3f}"
        self._problem = ""
        status = DiagnosticStatus(
            level=level,
            name=f"{self.get_fully_qualified_name().lstrip('/')}: simulation",
            message=message,
            hardware_id=self.table.name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def finish(self) -> None:
        """Nothing is pending."""
