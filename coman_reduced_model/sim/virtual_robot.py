# SPDX-License-Identifier: BSD-3-Clause
"""The virtual robot: full-body physics, motors, springs, floor and sensors, one sensor period a step.

robot = VirtualRobot(COMAN, seed=1)
motion, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1")))
robot.reset(motion)
while robot.t < motion.end:
    readings = robot.step()      # messages of core/types
    robot.truth                  # what no sensor shows
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..core.base.types import Array
from .contact import Contact, Floor
from .controller import Controller, Stabiliser
from .describe import mujoco_spec
from .disturbances.base import Disturbance, foot_body, overrides
from .disturbances.floor import plate_body
from .engines import make_engine
from .motion import Posture
from .motors import MotorOptions, Motors
from .robot_table import COMAN, RobotTable
from .sensors import Readings, SensorOptions, Sensors, Signals

START_NS = 1_700_000_000_000_000_000  # stamp at t = 0; fixed, so that a seed gives the same bag at any time
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
        self.stiffness = self.model.actuator_gainprm[:, 0].copy()
        self.damping = -self.model.actuator_biasprm[:, 2]
        self._lead = self.damping / self.stiffness
        # Disturbances may put joints of their own between those of the robot.
        joints = [self.model.joint(name) for name in table.joint_names]
        self._q, self._v = (np.array([int(getattr(j, a)[0]) for j in joints]) for a in ("qposadr", "dofadr"))
        # What the ground does to a foot it does to the foot or to the plate that a disturbance puts below it.
        bodies = {self.model.body(i).name: i for i in range(self.model.nbody)}
        feet = [[bodies[n] for n in (foot_body(k), plate_body(k)) if n in bodies] for k in (0, 1)]
        self._soles = [self.model.site(name).id for name in ("l_sole", "r_sole")]
        self._engine = make_engine(engine, self.model, feet, self._soles, contact or Contact())
        self._imu = self.model.site("imu_link").id
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
        data.qpos[self._q] = start.q[0]
        self.sensors = Sensors(self._options, self.table, model.opt.timestep, self.start_ns, self._seed)
        self._stabiliser = Stabiliser(self._controller, self.table, self.period)
        for disturbance in self.disturbances:
            disturbance.start(self.table, model, rng)
        self._move = overrides(self.disturbances, "move_motors")
        self._springs = overrides(self.disturbances, "spring_torque")
        self._forces = overrides(self.disturbances, "apply")
        self._bear = overrides(self.disturbances, "bear")
        self._sense = overrides(self.disturbances, "sense")
        self._engine.reset(data)
        theta = motion(np.zeros(1))[0][0]
        self._motors = Motors(self._motor_options, theta) if self._motor_options else None
        self._q_history = np.tile(data.qpos[self._q], (self.sensors.steps, 1))
        steps = round(settle_s / model.opt.timestep)
        self.t = -steps * model.opt.timestep
        for first in range(0, steps, 100):
            n = min(100, steps - first)
            self._physics(np.tile(theta, (n, 1)), np.zeros((n, len(theta))), {})
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
        samples: dict[int, list[str]] = {}
        for name, phase in self.sensors.phase.items():
            samples.setdefault(phase, []).append(name)
        self._signals = Signals(*(np.empty(0) for _ in range(10)))
        self._physics(theta, rate, samples)
        self._period_index += 1
        self.t = self._period_index * n * dt
        for disturbance in self._sense:
            disturbance.sense(t, self._signals)
        readings = self.sensors.read(t, self._signals)
        self._stabiliser.update(readings)
        if not self._options.imu:  # the robot may have one without publishing it
            readings.imu = None
        return readings

    def advance(self, dt: float) -> list[Readings]:
        """Steps until dt [s] more have passed, to the nearest period."""
        return [self.step() for _ in range(round(dt / self.period))]

    def _physics(self, theta: Array, rate: Array, samples: dict[int, list[str]]) -> None:
        """Physics steps, one a row of the motor references (n, nj); samples: streams to read at a step."""
        data, dt = self.data, self.model.opt.timestep
        self._command = theta, rate
        if self._move:
            times = self.t + dt * np.arange(len(theta))
            for disturbance in self._move:
                theta, rate = disturbance.move_motors(times, theta, rate)
        ctrl = theta + self._lead * rate
        history = np.empty(theta.shape)
        slow = bool(self._springs or self._forces or self._motors)
        for i in range(len(theta)):
            history[i] = data.qpos[self._q]
            extra = None
            motor_q, motor_qd = theta[i], rate[i]
            if slow:
                motor_q, motor_qd, extra = self._slow_step(i, theta[i], rate[i], ctrl)
            if streams := samples.get(i):
                state = data.qpos.copy(), data.qvel.copy()
                data.ctrl[:] = ctrl[i]
                self._engine.sampled_step(data)
                # The integrator damps with the velocity after the step: this is the torque that it has applied.
                tau = data.actuator_force - self.damping * (data.qvel - state[1])[self._v]
                if extra is not None:
                    tau += extra
                for name in streams:
                    getattr(self, f"_take_{name}")(state, motor_q, motor_qd, tau, history[: i + 1])
                if "joints" in streams and self._options.motor_source == "commanded":
                    self._signals.motor_q, self._signals.motor_qd = (part[i].copy() for part in self._command)
            else:
                data.ctrl[:] = ctrl[i]
                self._engine.step(data)
        self.t += dt * len(theta)
        self._q_history = history

    def _slow_step(self, i: int, theta: Array, rate: Array, ctrl: Array) -> tuple[Array, Array, Array]:
        """Motors with inertia, springs that are not linear, outside forces: motor position, rate, extra torque."""
        model, data = self.model, self.data
        t = self.t + i * model.opt.timestep
        if self._motors:
            reference, reference_rate = theta, rate
            theta, rate = self._motors.theta, self._motors.rate
            ctrl[i] = theta + self._lead * rate
        deflection, deflection_rate = theta - data.qpos[self._q], rate - data.qvel[self._v]
        extra = np.zeros(len(deflection))
        for disturbance in self._springs:
            extra += disturbance.spring_torque(t, deflection, deflection_rate)
        data.qfrc_applied[:] = 0.0
        data.xfrc_applied[:] = 0.0
        data.qfrc_applied[self._v] = extra
        for disturbance in self._forces:
            disturbance.apply(t, model, data)
        if self._motors:
            torque = self.stiffness * deflection + self.damping * deflection_rate + extra
            self._motors.step(reference, reference_rate, torque, model.opt.timestep)
        return theta, rate, extra

    def _take_joints(self, state: tuple[Array, Array], motor_q: Array, motor_qd: Array, tau: Array, now: Array) -> None:
        (q, v), data, s = state, self.data, self._signals
        s.q = np.concatenate([self._q_history, now])[-self.sensors.steps :]
        s.qd, s.tau = v[self._v], tau
        s.motor_q, s.motor_qd = motor_q.copy(), motor_qd.copy()
        mujoco.mj_subtreeVel(self.model, data)
        T_left, T_right = (self._sole(k) for k in (0, 1))
        self.truth = Truth(
            self.t,
            data.subtree_com[0].copy(),
            data.subtree_linvel[0].copy(),
            q[:3],
            q[[4, 5, 6, 3]],
            T_left,
            T_right,
            self._ground_wrench(0),
            self._ground_wrench(1),
            q[self._q],
            v[self._v],
            s.motor_q,
            s.motor_qd,
            tau,
        )

    def _take_left_wrench(self, *_: object) -> None:
        self._signals.left_wrench = self._ground_wrench(0)

    def _take_right_wrench(self, *_: object) -> None:
        self._signals.right_wrench = self._ground_wrench(1)

    def _take_imu(self, state: tuple[Array, Array], *_: object) -> None:
        s, kind = self._signals, mujoco.mjtObj.mjOBJ_SITE
        motion = np.empty(6)
        s.orientation = state[0][[4, 5, 6, 3]]
        mujoco.mj_objectVelocity(self.model, self.data, kind, self._imu, motion, 1)
        s.gyro = motion[:3].copy()
        mujoco.mj_objectAcceleration(self.model, self.data, kind, self._imu, motion, 1)
        s.acceleration = motion[3:].copy()

    def _sole(self, foot: int) -> Array:
        T = np.eye(4)
        T[:3, :3] = self.data.site_xmat[self._soles[foot]].reshape(3, 3)
        T[:3, 3] = self.data.site_xpos[self._soles[foot]]
        return T

    def _ground_wrench(self, foot: int) -> Array:
        """Force and moment (6,) of the ground on a foot, in and about its sole frame."""
        wrench = self._engine.ground_wrench(self.data, foot)
        return sum((d.bear(foot, self.data) for d in self._bear), wrench)
