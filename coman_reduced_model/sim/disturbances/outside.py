# SPDX-License-Identifier: BSD-3-Clause
"""What no effect of the catalogue describes. Loads take their mass from the trunk: the weight is as in the URDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from ...core.base.parameter import par
from ...core.base.types import Array
from ..robot_table import RobotTable
from ..sensors import Signals
from .base import Disturbance, feet, joint_indices, take_mass
from .sensors import WRENCHES


@dataclass
class SloshingLoad(Disturbance):
    """Part of the trunk's mass slides in x and y on springs, as liquid in a tank does."""

    name: ClassVar[str] = "sloshing_load"
    catalogued: ClassVar[bool] = False
    mass: float = par(0.0, "kg", "that moves", 0.0, 50.0)
    frequency: float = par(1.5, "Hz", "of the sloshing", 0.2, 20.0)
    damping: float = par(0.05, "1", "share of critical damping", 0.0, 2.0)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        if self.mass == 0.0:
            return
        trunk = spec.body("base_link")
        at = np.array(trunk.ipos)
        take_mass(trunk, self.mass, at)
        load = trunk.add_body(name="sloshing_load", pos=at)
        load.explicitinertial, load.mass, load.inertia = True, self.mass, [1e-4 * self.mass] * 3
        load.ipos = [0.0, 0.0, 0.0]  # MuJoCo takes `pos` for it otherwise
        omega = 2.0 * np.pi * self.frequency
        for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]):
            joint = load.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
            joint.stiffness[0], joint.damping[0] = self.mass * omega**2, 2.0 * self.damping * self.mass * omega


@dataclass
class SwingingArms(Disturbance):
    """Two arms at the trunk's sides that swing fore and aft by a drive of their own, from when the robot walks."""

    name: ClassVar[str] = "swinging_arms"
    catalogued: ClassVar[bool] = False
    mass: float = par(0.0, "kg", "of one arm", 0.0, 20.0)
    length: float = par(0.25, "m", "from the shoulder to the arm's mass", 0.05, 1.0)
    amplitude: float = par(0.5, "rad", "of the swing", 0.0, 1.5)
    frequency: float = par(0.7, "Hz", "of the swing", 0.1, 5.0)
    phase: float = par(3.141592653589793, "rad", "of the right arm against the left one", -6.3, 6.3)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        if self.mass == 0.0:
            return
        trunk = spec.body("base_link")
        for side, name in ((1.0, "left_arm"), (-1.0, "right_arm")):
            shoulder = np.array([0.0, side * 0.6 * table.trunk.box[1], table.trunk.box[2]])
            take_mass(trunk, self.mass, shoulder - [0.0, 0.0, self.length])
            arm = trunk.add_body(name=name, pos=shoulder)
            arm.explicitinertial, arm.mass, arm.ipos = True, self.mass, [0.0, 0.0, -self.length]
            arm.inertia = [1e-4 * self.mass] * 3
            arm.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0])

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        joints = [model.joint(name) for name in ("left_arm", "right_arm")] if self.mass > 0.0 else []
        self._q, self._v = (
            np.array([int(getattr(joint, a)[0]) for joint in joints], dtype=int) for a in ("qposadr", "dofadr")
        )
        self._inertia = self.mass * self.length**2

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance: a servo of 10 Hz follows the swing, which grows over the first second."""
        omega, grown = 2.0 * np.pi * self.frequency, min(max(t, 0.0), 1.0)
        angle = omega * t + np.array([0.0, self.phase])[: len(self._q)]
        wanted, rate = grown * self.amplitude * np.sin(angle), grown * self.amplitude * omega * np.cos(angle)
        servo = 2.0 * np.pi * 10.0
        error, error_rate = wanted - data.qpos[self._q], rate - data.qvel[self._v]
        data.qfrc_applied[self._v] += self._inertia * (servo**2 * error + 1.4 * servo * error_rate - omega**2 * wanted)


@dataclass
class PeriodicPush(Disturbance):
    """A force on the trunk that comes and goes with a frequency of its own."""

    name: ClassVar[str] = "periodic_push"
    catalogued: ClassVar[bool] = False
    amplitude: float = par(0.0, "N", "of the force", 0.0, 1e3)
    frequency: float = par(1.7, "Hz", "of the force", 0.05, 50.0)
    direction: float = par(0.0, "rad", "of the force in the ground plane, from x to y", -6.3, 6.3)
    phase: float = par(0.0, "rad", "at t = 0", -6.3, 6.3)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._trunk = model.body("base_link").id
        self._axis = np.array([np.cos(self.direction), np.sin(self.direction)])

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        now = self.amplitude * np.sin(2.0 * np.pi * self.frequency * t + self.phase)
        data.xfrc_applied[self._trunk, :2] += now * self._axis


@dataclass
class EccentricEncoder(Disturbance):
    """A link encoder whose code disc sits off its axis or whose interpolation errs: true + A sin(n true + phase)."""

    name: ClassVar[str] = "eccentric_encoder"
    catalogued: ClassVar[bool] = False
    where: str = par("", "", "joint, kind of joint, left, right; empty: all")
    amplitude: float = par(0.0, "rad", "of the error", 0.0, 0.2)
    per_turn: int = par(1, "", "periods of the error in a turn", 1, 256)
    phase: float = par(0.0, "rad", "of the error at zero", -6.3, 6.3)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._joints = joint_indices(table, self.where)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        angle = self.per_turn * signals.q[:, self._joints] + self.phase
        signals.qd[self._joints] *= 1.0 + self.per_turn * self.amplitude * np.cos(angle[-1])
        signals.q[:, self._joints] += self.amplitude * np.sin(angle)


@dataclass
class ThermalDrift(Disturbance):
    """A link encoder whose zero wanders: slowly, steadily."""

    name: ClassVar[str] = "thermal_drift"
    catalogued: ClassVar[bool] = False
    where: str = par("", "", "joint, kind of joint, left, right; empty: all")
    rate: float = par(0.0, "rad/s", "of the zero", -0.1, 0.1)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._joints = joint_indices(table, self.where)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        signals.q[:, self._joints] += self.rate * t


@dataclass
class Cogging(Disturbance):
    """A gear behind the spring whose torque ripples with the joint's angle: torque sensors, in the spring, miss it."""

    name: ClassVar[str] = "cogging"
    catalogued: ClassVar[bool] = False
    where: str = par("", "", "joint, kind of joint, left, right; empty: all")
    amplitude: float = par(0.0, "Nm", "of the ripple", 0.0, 50.0)
    per_turn: int = par(24, "", "ripples in a turn of the joint", 1, 10_000)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        names = [table.joint_names[i] for i in joint_indices(table, self.where)]
        self._q = [int(model.joint(name).qposadr[0]) for name in names]
        self._v = [int(model.joint(name).dofadr[0]) for name in names]

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        data.qfrc_applied[self._v] += self.amplitude * np.sin(self.per_turn * data.qpos[self._q])


@dataclass
class CableDrag(Disturbance):
    """A cable at the trunk that drags over the floor: a pull against the motion, the stronger the farther it is."""

    name: ClassVar[str] = "cable_drag"
    catalogued: ClassVar[bool] = False
    friction: float = par(0.0, "N", "against the motion", 0.0, 1e3)
    spring: float = par(0.0, "N/m", "back to where it hangs", 0.0, 1e4)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._trunk = model.body("base_link").id

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        drag = -self.friction * np.tanh(data.qvel[:2] / 0.02)
        data.xfrc_applied[self._trunk, :2] += drag - self.spring * data.xpos[self._trunk, :2]


@dataclass
class StaleStream(Disturbance):
    """A driver that hangs now and then: a foot's wrench repeats its last value, noise and all, for a while."""

    name: ClassVar[str] = "stale_stream"
    catalogued: ClassVar[bool] = False
    where: str = par("", "", "left or right foot; empty: both")
    length: float = par(0.0, "s", "of a hang", 0.0, 5.0)
    every: float = par(1.0, "s", "from hang to hang", 0.01, 100.0)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        if t > 0.0 and t % self.every < self.length:
            signals.hanging = tuple(WRENCHES[foot] for foot in feet(self.where))


@dataclass
class LateClock(Disturbance):
    """The clock of both foot sensors runs slow: their values are the later, the longer the recording is."""

    name: ClassVar[str] = "late_clock"
    catalogued: ClassVar[bool] = False
    rate: float = par(0.0, "1", "delay gained in a second [s/s]", 0.0, 0.05)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._past: dict[str, list[tuple[float, Array]]] = {name: [] for name in WRENCHES}

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance: the value of the period that is nearest to the late time."""
        late = t - self.rate * max(t, 0.0)
        for name, past in self._past.items():
            past.append((t, getattr(signals, name).copy()))
            while len(past) > 1 and past[1][0] - late <= late - past[0][0]:
                past.pop(0)
            setattr(signals, name, past[0][1].copy())
