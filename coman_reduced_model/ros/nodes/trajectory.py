# SPDX-License-Identifier: BSD-3-Clause
"""The reference generator: plans a walk and publishes com/reference. `ros2 run coman_reduced_model trajectory`."""

from __future__ import annotations

import gc

import numpy as np
from coman_reduced_model_msgs.msg import ComReference
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from std_srvs.srv import Trigger

from ...core.base.stream_names import REFERENCE
from ...core.config.schema import Config
from ...core.gait.walk import Walk
from ...messages import ODOM, header_to, pose_to, reference_to, ros_types
from ..interface import qos
from ..interface.parameters import ConfiguredNode, Own, declare
from ..interface.report_timer import ReportTimer

NAME = "trajectory"
OWN = Own(
    names=("gait.", "robot.name", "robot.gravity", "output.diagnostics_rate"),
    changing=("gait.", "output.diagnostics_rate"),
)
_BACK_NS = 500_000_000  # a clock that goes back by more was set, or a bag began again
_AHEAD_NS = 5_000_000_000  # ahead by less: the machine was busy, and what was missed is made up for
_PATH_POINTS = 1000


class TrajectoryNode(ConfiguredNode):
    """Adapter around a Walk. Stamps lie on a grid of the rate, whatever the timer's jitter."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self.config = declare(self, OWN, self._on_config)
        self.todo = None
        self.types = ros_types()
        self.walk = Walk(self.config)
        self._period = round(1e9 / self.config.gait.rate)
        self._ahead = round(1e9 * self.config.gait.ahead)
        self._next = 0  # stamp of the next point; 0: no time yet
        self._published = 0
        self._reference = self.create_publisher(
            ComReference, REFERENCE, qos.sensor_output(), qos_overriding_options=qos.overridable()
        )
        self._path = self.create_publisher(Path, f"{REFERENCE}_path", qos.latched())
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.display_output())
        for name in ("start", "stop", "reset"):
            self.create_service(Trigger, f"~/{name}", getattr(self, f"_on_{name}"))
        # Steady, and the time asked for at each tick: a bag played at any speed is followed.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(self._period * 1e-9, self._tick, clock=steady)
        self._timer = ReportTimer(self, self._report)
        self._timer.set_rate(self.config.output.diagnostics_rate)
        gc.collect()
        gc.freeze()
        self.get_logger().info(f"ready: {self.config.gait.name}, {len(self.walk.plan.footsteps)} steps")

    def _on_config(self, config: Config) -> None:
        """Parameters that may change at run time have changed: a gait counts for the next plan."""
        self.walk.change(config)
        if config.gait != self.config.gait:
            self.get_logger().info("another gait from the next plan on: ~/start, or the repetition of this one")
        self.config = config
        self._timer.set_rate(config.output.diagnostics_rate)

    def _tick(self) -> None:
        now = self.get_clock().now().nanoseconds
        if now <= 0:  # simulated time has not begun
            return
        now += self._ahead
        if not self._next or not -_BACK_NS < now - self._next < _AHEAD_NS:
            self._begin(now)
        while self._next <= now:
            if self.walk.go_on(self._next):
                self._publish_path()
            elif self.walk.refused:
                self.get_logger().warning(f"the walk is not repeated: it {self.walk.refused}")
                self.walk.refused = ""
            self._reference.publish(reference_to(self.types, self.walk.reference(self._next)))
            self._published += 1
            self._next += self._period

    def _begin(self, now: int) -> None:
        """Time begins, or has jumped: with it the walk, unless its start is given."""
        if self._next:
            self.walk.reset()
        self._next = now - now % self._period
        if self.config.gait.start_time >= 0.0:
            self.walk.start_ns = round(self.config.gait.start_time * 1e9)
        elif self.config.gait.autostart:
            self.walk.start(self._next)
        self._publish_path()

    def _now(self) -> int:
        """[ns]; 0: simulated time has not begun."""
        now = int(self.get_clock().now().nanoseconds)
        return self._next or (now + self._ahead if now > 0 else 0)

    def _on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not (now := self._now()):
            return self._answer(response, "waiting for /clock: there is no time yet")
        return self._answer(response, self.walk.start(now))

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self.walk.stop(self._now()))

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.walk.reset()
        return self._answer(response, None)

    def _answer(self, response: Trigger.Response, problem: str | None) -> Trigger.Response:
        response.success = problem is None
        response.message = problem or self.walk.describe(self._now())
        if response.success:
            self._publish_path()
        return response

    def _publish_path(self) -> None:
        """The whole plan, for RViz: the COM over time."""
        start = self._now() if self.walk.start_ns is None else self.walk.start_ns
        times = np.linspace(0.0, self.walk.plan.duration_s, _PATH_POINTS)
        path = Path(header=header_to(self.types, start, ODOM))
        T = np.eye(4)
        for t, com in zip(times, self.walk.plan.sample_many(times).com, strict=True):
            T[:3, 3] = com
            header = header_to(self.types, start + round(t * 1e9), ODOM)
            path.poses.append(PoseStamped(header=header, pose=pose_to(self.types, T)))
        self._path.publish(path)

    def _report(self) -> None:
        message = self.walk.describe(self._next) if self._next else "waiting for /clock"
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK if self._next else DiagnosticStatus.WARN,
            name=f"{self.get_fully_qualified_name().lstrip('/')}: walk",
            message=message,
            hardware_id=self.config.robot.name,
            values=[
                KeyValue(key="gait", value=self.config.gait.name),
                KeyValue(key="points published", value=str(self._published)),
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def finish(self) -> None:
        """Nothing is pending."""
