# SPDX-License-Identifier: BSD-3-Clause
"""What the robot's description does not say: effects hidden in the physics or in the sensors, one class each.

A disturbance overrides the hooks that it needs; the others do nothing and cost nothing. Joint arrays are in the
order of `RobotTable.joint_names`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..core.types import Array
from ..errors import ConfigError
from .describe import set_spring
from .robot_table import RobotTable
from .sensors import Signals


class Disturbance:
    """One hidden effect."""

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """Changes the physical model before it is compiled: masses, springs, floor, more bodies."""

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Once, when the robot is set on its feet: draw random numbers, empty buffers."""

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        """What the motors make of their references.

        Args:
            t: (n,) [s] consecutive physics steps.
            theta: (n, 12) [rad] references.
            theta_rate: (n, 12) [rad/s].
        """
        return theta, theta_rate

    def spring_torque(self, t: float, deflection: Array, rate: Array) -> Array:
        """Torque (12,) [Nm] that springs transmit beside k deflection + d rate.

        Args:
            t: [s].
            deflection: (12,) motor minus link [rad].
            rate: (12,) its derivative [rad/s].
        """
        raise NotImplementedError

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Adds forces to `data.qfrc_applied` and `data.xfrc_applied`, which are zero before every physics step."""

    def sense(self, t: float, signals: Signals) -> None:
        """Changes the true signals in place before quantisation and noise."""


def overrides(disturbances: Sequence[Disturbance], hook: str) -> list[Disturbance]:
    """Those that override a hook."""
    return [d for d in disturbances if getattr(type(d), hook) is not getattr(Disturbance, hook)]


def joint_indices(table: RobotTable, where: str) -> list[int]:
    """Joints that a place names: a joint (LKneeSag), a kind (KneeSag: both sides), a side (L, R), or all.

    Raises:
        ConfigError: no joint has that name.
    """
    names = table.joint_names
    found = [i for i, name in enumerate(names) if where in ("all", name, name[1:], name[0])]
    if not found:
        raise ConfigError(f"where = {where!r}: allowed: all, L, R, {', '.join(table.links)}, {', '.join(names)}")
    return found


@dataclass
class SpringScale(Disturbance):
    """Springs (and dampers) that are not nominal."""

    where: str
    stiffness: float = 1.0  # factor
    damping: float = 1.0  # factor

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        for i in joint_indices(table, self.where):
            joint = table.joints()[i]
            set_spring(spec.actuator(joint.name), self.stiffness * joint.stiffness, self.damping * joint.damping)


@dataclass
class Backlash(Disturbance):
    """A dead zone in series with the spring: it transmits nothing until the play is taken up."""

    where: str
    play: float  # [rad] full width

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._half = np.zeros(model.nu)
        self._half[joint_indices(table, self.where)] = self.play / 2.0
        self._stiffness = model.actuator_gainprm[:, 0].copy()
        self._damping = -model.actuator_biasprm[:, 2]

    def spring_torque(self, t: float, deflection: Array, rate: Array) -> Array:
        """See Disturbance; the damper is in series with the play, too."""
        lost = np.clip(deflection, -self._half, self._half)
        free = (np.abs(deflection) < self._half) * self._damping * rate
        return -self._stiffness * lost - free


@dataclass
class Payload(Disturbance):
    """A mass that the URDF lacks, as a point fixed to a body."""

    mass: float  # [kg]
    body: str = "base_link"
    position: tuple[float, float, float] = (0.0, 0.0, 0.1)  # [m] in the body's frame

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        load = spec.body(self.body).add_body(name="payload", pos=self.position)
        load.explicitinertial, load.mass, load.inertia = True, self.mass, [1e-6 * self.mass] * 3


@dataclass
class EncoderBias(Disturbance):
    """Constant error of link encoders."""

    where: str
    bias: float  # [rad]

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._where = joint_indices(table, self.where)

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        signals.q[:, self._where] += self.bias
