# SPDX-License-Identifier: BSD-3-Clause
"""The virtual robot: full-body physics, motors, springs, floor and sensors, one sensor period a step.

robot = VirtualRobot(COMAN, seed=1)
motion, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1")))
robot.reset(motion)
while robot.t < motion.end:
    readings = robot.step()      # messages of core/base/types
    robot.truth                  # what no sensor shows
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ..core.base.types import Array
from .contact import Contact, Floor
from .controller import Controller, Stabiliser
from .describe import mujoco_spec
from .disturbances.base import Disturbance, foot_body, overrides
from .disturbances.floor import plate_body
from .engines import make_engine
from .motion import Posture
from .motors import MotorOptions
from .physics import JOINTS, LEFT, Body, Drive, Sampled
from .robot_table import COMAN, RobotTable
from .sensors import STREAMS, Readings, SensorOptions, Sensors, Signals
from .spring_laws import SpringLaws

START_NS = 1_700_000_000_000_000_000  # stamp at t = 0; fixed, so that a seed gives the same bag at any time
SETTLE_STEPS = 100  # physics steps at once while the robot comes to rest
Motion = Callable[[Array], "tuple[Array, Array]"]  # times (n,) -> motor positions, velocities (n, nj)


@dataclass(slots=True)
class Truth:
    """What is really so at the joint sample of the last step; positions in the world, z up from the floor."""

    t: float  # [s]
    com: Array  # (3,) [m] of everything that the robot carries
    com_vel: Array  # (3,) [m/s]
    base_position: Array  # (3,) [m] of base_link
    base_orientation: Array  # (4,) quaternion x y z w
    T_left: Array  # (4, 4) left sole
    T_right: Array  # (4, 4)
    left_wrench: Array  # (6,) of the ground on the foot, in its sole frame [N, Nm]
    right_wrench: Array  # (6,)
    q: Array  # (nj,) [rad]
    qd: Array  # (nj,) [rad/s]
    motor_q: Array  # (nj,) [rad]
    motor_qd: Array  # (nj,) [rad/s]
    tau: Array  # (nj,) [Nm] transmitted


class VirtualRobot:
    """A robot of a table on a floor, with what disturbs it.

    Attributes:
        t: time since `reset` [s].
        truth: the last step's truth; None before the first one.
        table, model, data: the robot, and MuJoCo's model and state of it.
        stiffness, damping: of the joints (nj,), as they really are [Nm/rad, Nms/rad].
        start_ns: stamp at t = 0 [ns].
    """

    def __init__(
        self,
        table: RobotTable = COMAN,
        sensors: SensorOptions | None = None,
        disturbances: Sequence[Disturbance] = (),
        motors: MotorOptions | None = None,
        seed: int = 0,
        start_ns: int = START_NS,
        contact: Contact | None = None,
        floor: Floor | None = None,
        controller: Controller | None = None,
        engine: str = "mujoco",
    ):
        """Builds it.

        Args:
            table: the robot.
            sensors: default: those of SensorOptions.
            disturbances: hidden effects.
            motors: None: the motors follow their references exactly (A1).
            seed: of all random numbers.
            start_ns: stamp at t = 0 [ns].
            contact, floor: how soles meet the floor, and its shape; default: a hard plane.
            controller: a stabiliser; default: the motors follow their plan, open loop.
            engine: of the physics: mujoco or drake.

        Raises:
            ConfigError: an option or a disturbance is not possible.
        """
        self.table = table
        spec = mujoco_spec(table, contact, floor)
        for disturbance in disturbances:
            disturbance.edit_model(spec, table)
            motors = disturbance.motor_loop(motors)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.truth: Truth | None = None
        self.t = 0.0
        self._motor_options, self._seed, self.start_ns = motors, seed, start_ns
        self._options = sensors or SensorOptions()
        self._controller = controller or Controller()
        self.disturbances = list(disturbances)
        self._body = Body.of(self.model, self.data, table.joint_names)
        self._imu_mount = table.imu_mount if any(table.imu_turn) else None
        self.stiffness, self.damping = self._body.stiffness, self._body.damping
        # What the ground does to a foot it does to the foot or to the plate that a disturbance puts below it.
        bodies = {self.model.body(i).name: i for i in range(self.model.nbody)}
        feet = [[bodies[n] for n in (foot_body(k), plate_body(k)) if n in bodies] for k in (0, 1)]
        self._engine = make_engine(engine, self.model, self.data, feet, contact or Contact())
        self.sensors = Sensors(self._options, table, self.model.opt.timestep, start_ns, seed)

    @property
    def period(self) -> float:
        """Of the sensors [s]."""
        return self.sensors.steps * self.model.opt.timestep

    @property
    def fallen(self) -> bool:
        """The trunk leans by more than 45 degrees, or is at half its height."""
        up = 1.0 - 2.0 * float(self.data.qpos[4] ** 2 + self.data.qpos[5] ** 2)
        return up < np.sqrt(0.5) or float(self.data.qpos[2]) < 0.5 * self._height

    def reset(self, motion: Motion, start: Posture | None = None, settle_s: float = 1.0) -> None:
        """Sets the robot on its feet and lets it come to rest on its springs.

        Args:
            motion: motor positions and velocities (n, nj) at times (n,) from now on.
            start: where it stands; default: `motion.start`.
            settle_s: [s] spent with the motors still, before t = 0.
        """
        start = start or motion.start  # type: ignore[attr-defined]
        model, data, rng = self.model, self.data, np.random.default_rng(self._seed)
        mujoco.mj_resetData(model, data)
        data.qpos[:3], self._height = start.base[0], float(start.base[0, 2])
        data.qpos[3:7] = [np.cos(start.yaw[0] / 2.0), 0.0, 0.0, np.sin(start.yaw[0] / 2.0)]
        data.qpos[self._body.q] = start.q[0]
        self.sensors = Sensors(self._options, self.table, model.opt.timestep, self.start_ns, self._seed)
        self._stabiliser = Stabiliser(self._controller, self.table, self.period)
        for disturbance in self.disturbances:
            disturbance.start(self.table, model, rng)
        self._move = overrides(self.disturbances, "move_motors")
        self._forces = overrides(self.disturbances, "apply")
        self._bear = overrides(self.disturbances, "bear")
        self._sense = overrides(self.disturbances, "sense")
        self._engine.reset(data)
        theta = motion(np.zeros(1))[0][0]
        laws = SpringLaws.of([law for d in self.disturbances for law in d.spring_laws()], len(theta))
        loop = astuple(self._motor_options) if self._motor_options else ()
        self._drive = Drive.of(max(SETTLE_STEPS, self.sensors.steps), len(theta), laws, loop)
        self._drive.motor[0] = theta
        self._sampled, self._borne = Sampled.of(self._body, self._options.wrench_average), np.zeros((2, 6))
        self._q_history = np.tile(data.qpos[self._body.q], (self.sensors.steps, 1))
        steps = round(settle_s / model.opt.timestep)
        self.t = -steps * model.opt.timestep
        for first in range(0, steps, SETTLE_STEPS):
            n = min(SETTLE_STEPS, steps - first)
            self._physics(np.tile(theta, (n, 1)), np.zeros((n, len(theta))))
        self._sampled.at[:] = [self.sensors.phase[name] for name in STREAMS]
        self._sampled.sums[:] = 0.0
        self._sampled.steps[:] = 0
        self._borne = np.zeros((2, 6))
        self.motion, self._period_index, self.truth = motion, 0, None

    def step(self) -> Readings:
        """Reads the sensors at t (each at its phase within the period) and moves on by one period."""
        n, dt = self.sensors.steps, self.model.opt.timestep
        self.t = t = self._period_index * n * dt
        times = t + dt * np.arange(n)
        theta, rate = self.motion(times)
        if self._controller.kind != "none":
            offset, offset_rate = self._stabiliser.over(n, dt)
            theta, rate = theta + offset, rate + offset_rate
        before = self._q_history
        self._physics(theta, rate)
        signals = self._signals(before, theta, rate)
        self.truth = self._truth(t, signals)
        self._period_index += 1
        self.t = self._period_index * n * dt
        for disturbance in self._sense:
            disturbance.sense(t, signals)
        readings = self.sensors.read(t, signals)
        self._stabiliser.update(readings)
        if not self._options.imu:  # the robot may have one without publishing it
            readings.imu = None
        return readings

    def advance(self, dt: float) -> list[Readings]:
        """Steps until dt [s] more have passed, to the nearest period."""
        return [self.step() for _ in range(round(dt / self.period))]

    def _physics(self, theta: Array, rate: Array) -> None:
        """Physics steps, one a row of the motor references (n, nj)."""
        n, dt = len(theta), self._body.dt
        if self._move:
            times = np.asarray(self.t + dt * np.arange(n), dtype=np.float64)
            for disturbance in self._move:
                theta, rate = disturbance.move_motors(times, theta, rate)
        self._drive.theta[:n], self._drive.rate[:n] = theta, rate
        state = self._body, self._drive, self._sampled
        if self._forces:
            for i in range(n):
                self._apply_forces(self.t + i * dt)
                self._engine.steps(i, i + 1, self.t, *state, True)
                self._add_borne(i)
        else:
            self._engine.steps(0, n, self.t, *state, False)
        self.t += dt * n
        self._q_history = self._drive.history[:n].copy()

    def _apply_forces(self, t: float) -> None:
        self.data.qfrc_applied[:] = 0.0
        self.data.xfrc_applied[:] = 0.0
        for disturbance in self._forces:
            disturbance.apply(t, self.model, self.data)

    def _add_borne(self, step: int) -> None:
        """What the ground exerts on the feet beside the contacts, in what is sampled."""
        at, steps = self._sampled.at, self.sensors.steps if self._options.wrench_average else 1
        for foot in (0, 1):
            for disturbance in self._bear:
                if at[JOINTS] == step:
                    self._sampled.wrenches[foot] += disturbance.bear(foot, self.data)
                if steps > 1 or at[LEFT + foot] == step:
                    self._borne[foot] += disturbance.bear(foot, self.data) / steps
            if at[LEFT + foot] == step:
                self._sampled.felt[foot] += self._borne[foot]
                self._borne[foot] = 0.0

    def _signals(self, before: Array, theta: Array, rate: Array) -> Signals:
        """What the sensors read of the last period; before: joint positions (n, nj) in the one before it."""
        s = self._sampled
        steps, first = self.sensors.steps, s.at[JOINTS]
        motor_q, motor_qd = s.motor.copy()
        if self._options.motor_source == "commanded":
            motor_q, motor_qd = theta[first].copy(), rate[first].copy()
        return Signals(
            np.concatenate([before, self._q_history[: first + 1]])[-steps:],
            s.qd.copy(),
            s.tau.copy(),
            motor_q,
            motor_qd,
            s.felt[0].copy(),
            s.felt[1].copy(),
            self._imu_orientation(),
            s.motion[0, :3].copy(),
            s.motion[1, 3:].copy(),
        )

    def _imu_orientation(self) -> Array:
        """(4,) quaternion x y z w, world <- imu, as it is mounted."""
        if self._imu_mount is None:
            return self._sampled.orientation.copy()
        return np.asarray((Rotation.from_quat(self._sampled.orientation) * self._imu_mount).as_quat())

    def _truth(self, t: float, signals: Signals) -> Truth:
        s = self._sampled
        com, com_vel = s.com.copy()
        base, motor_q, motor_qd = s.base.copy(), *s.motor.copy()
        left, right = s.wrenches.copy()
        T_left, T_right = s.soles.copy()
        q = signals.q[-1].copy()
        return Truth(
            t, com, com_vel, base[:3], base[3:], T_left, T_right, left, right, q, s.qd.copy(), motor_q, motor_qd,
            s.tau.copy(),
        )  # fmt: skip
