# SPDX-License-Identifier: BSD-3-Clause
"""Sensors that err: the physics is as described, what is published of it is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ...core.base.parameter import par
from ...core.base.types import Array
from ..robot_table import RobotTable
from ..sensors import Signals, cross
from .base import Disturbance, feet, joint_indices

WRENCHES = ("left_wrench", "right_wrench")
_FOOT = "left or right foot; empty: both"


class _Late:
    """A signal sampled once a period, delayed by linear interpolation; before the first sample it stood still."""

    def __init__(self) -> None:
        self._past: list[Array] = []

    def __call__(self, value: Array, periods: float) -> Array:
        whole = int(periods)
        self._past = (self._past or [value] * (whole + 2))[-(whole + 1) :] + [value]
        part = periods - whole
        return (1.0 - part) * self._past[-1 - whole] + part * self._past[-2 - whole]


@dataclass
class EncoderBias(Disturbance):
    """A link encoder reads true + bias."""

    name: ClassVar[str] = "encoder_bias"
    where: str = par("", "", "joint, kind of joint, left, right; empty: all")
    bias: float = par(0.0, "rad", "constant error", -0.5, 0.5)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._joints = joint_indices(table, self.where)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        signals.q[:, self._joints] += self.bias


@dataclass
class EncoderDelay(Disturbance):
    """The link side (positions, velocities, torques) is stamped late: stamp = true time + delay.

    The stamps stay those of the motor states, as from one driver that reads the link side over a slower bus: only
    what the values say gives the delay away.
    """

    name: ClassVar[str] = "encoder_delay"
    delay: float = par(0.0, "s", "of /joint_states", 0.0, 0.2)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._dt = model.opt.timestep
        self._steps = round(self.delay / self._dt)
        self._q: Array | None = None
        self._rest = _Late()

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance; positions are late by whole physics steps, the others interpolated between samples."""
        n = len(signals.q)
        if self._q is None:
            self._q = np.tile(signals.q[0], (self._steps, 1))
        known = np.concatenate([self._q, signals.q])
        signals.q, self._q = known[:n], known[n:]
        late = self._rest(np.concatenate([signals.qd, signals.tau]), self._steps / n)
        signals.qd, signals.tau = np.split(late, 2)


@dataclass
class WrenchDelay(Disturbance):
    """A foot's wrench is stamped late: stamp = true time + delay."""

    name: ClassVar[str] = "wrench_delay"
    where: str = par("", "", _FOOT)
    delay: float = par(0.0, "s", "of the wrench", 0.0, 0.2)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._dt = model.opt.timestep
        self._late = {WRENCHES[foot]: _Late() for foot in feet(self.where)}

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        for name, late in self._late.items():
            setattr(signals, name, late(getattr(signals, name), self.delay / (self._dt * len(signals.q))))


@dataclass
class WrenchScale(Disturbance):
    """A foot's sensor reads all six components times a factor."""

    name: ClassVar[str] = "wrench_scale"
    where: str = par("", "", _FOOT)
    scale: float = par(1.0, "1", "measured over true", 0.1, 10.0)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        for foot in feet(self.where):
            setattr(signals, WRENCHES[foot], self.scale * getattr(signals, WRENCHES[foot]))


@dataclass
class WrenchBias(Disturbance):
    """A foot's sensor reads true + bias, at the sole, along its axes."""

    name: ClassVar[str] = "wrench_bias"
    where: str = par("", "", _FOOT)
    fx: float = par(0.0, "N", "force", -1e3, 1e3)
    fy: float = par(0.0, "N", "force", -1e3, 1e3)
    fz: float = par(0.0, "N", "force", -1e3, 1e3)
    tx: float = par(0.0, "Nm", "moment about the origin of the sole", -100.0, 100.0)
    ty: float = par(0.0, "Nm", "moment about the origin of the sole", -100.0, 100.0)
    tz: float = par(0.0, "Nm", "moment about the origin of the sole", -100.0, 100.0)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        bias = np.array([self.fx, self.fy, self.fz, self.tx, self.ty, self.tz])
        for foot in feet(self.where):
            setattr(signals, WRENCHES[foot], getattr(signals, WRENCHES[foot]) + bias)


@dataclass
class SensorRotation(Disturbance):
    """A foot's sensor whose axes are turned against its frame in the URDF; it stays where it is."""

    name: ClassVar[str] = "sensor_rotation"
    where: str = par("", "", _FOOT)
    axis: str = par("z", "", "it is turned about", choices=("x", "y", "z"))
    angle: float = par(0.0, "rad", "of the turn", -3.2, 3.2)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._turn = Rotation.from_euler(self.axis, self.angle).inv().as_matrix()
        self._lever = np.array([0.0, 0.0, table.ankle_height - table.sensor_below_ankle])

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance: values along turned axes are published as if they were straight."""
        for foot in feet(self.where):
            wrench = getattr(signals, WRENCHES[foot])
            force = self._turn @ wrench[:3]
            moment = self._turn @ (wrench[3:] - cross(self._lever, wrench[:3])) + cross(self._lever, force)
            setattr(signals, WRENCHES[foot], np.concatenate([force, moment]))


@dataclass
class WrenchCrossTalk(Disturbance):
    """A foot's sensor in which a share of the vertical force shows in the shear forces."""

    name: ClassVar[str] = "wrench_cross_talk"
    where: str = par("", "", _FOOT)
    fx: float = par(0.0, "1", "share of fz that shows in fx", -1.0, 1.0)
    fy: float = par(0.0, "1", "share of fz that shows in fy", -1.0, 1.0)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        for foot in feet(self.where):
            wrench = getattr(signals, WRENCHES[foot])
            more = np.array([self.fx * wrench[2], self.fy * wrench[2], 0.0, 0.0, 0.0, 0.0])
            setattr(signals, WRENCHES[foot], wrench + more)
