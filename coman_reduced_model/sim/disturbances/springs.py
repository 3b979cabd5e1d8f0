# SPDX-License-Identifier: BSD-3-Clause
"""Joints that are not the linear springs and dampers of the data sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from ...core.base.parameter import par
from ...core.base.types import Array
from ..describe import set_spring
from ..robot_table import RobotTable
from .base import Disturbance, joint_indices

_JOINT = "joint, kind of joint, left, right; empty: all"


def _scale_springs(spec: mujoco.MjSpec, table: RobotTable, where: str, stiffness: float, damping: float) -> None:
    """Factors on what the springs are already: effects at one joint multiply."""
    for i in joint_indices(table, where):
        spring = spec.actuator(table.joint_names[i])
        set_spring(spring, stiffness * float(spring.gainprm[0]), -damping * float(spring.biasprm[2]))


@dataclass
class JointStiffness(Disturbance):
    """Springs softer or stiffer than nominal; their dampers stay."""

    name: ClassVar[str] = "joint_stiffness"
    where: str = par("", "", _JOINT)
    scale: float = par(1.0, "1", "real over nominal stiffness", 0.05, 20.0)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        _scale_springs(spec, table, self.where, self.scale, 1.0)


@dataclass
class JointDamping(Disturbance):
    """Dampers weaker or stronger than nominal."""

    name: ClassVar[str] = "joint_damping"
    where: str = par("", "", _JOINT)
    scale: float = par(1.0, "1", "real over nominal damping", 0.0, 20.0)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        _scale_springs(spec, table, self.where, 1.0, self.scale)


@dataclass
class SpringNonlinearity(Disturbance):
    """Torque k d (1 + cubic d^2): hardening above zero, softening below.

    A softening spring goes on straight where its tangent has fallen to a fifth: it never pushes the wrong way.
    """

    name: ClassVar[str] = "spring_nonlinearity"
    where: str = par("", "", _JOINT)
    cubic: float = par(0.0, "1/rad^2", "relative change of the secant stiffness over the squared deflection", -1e6, 1e6)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._cubic = np.zeros(model.nu)
        self._cubic[joint_indices(table, self.where)] = self.cubic
        self._stiffness = model.actuator_gainprm[:, 0].copy()
        self._straight_from = np.sqrt(0.8 / (3.0 * -self.cubic)) if self.cubic < 0.0 else np.inf

    def spring_torque(self, t: float, deflection: Array, rate: Array) -> Array:
        """See Disturbance."""
        bent = np.clip(deflection, -self._straight_from, self._straight_from)
        beyond = deflection - bent
        return self._stiffness * self._cubic * (bent**3 + 3.0 * bent**2 * beyond)


@dataclass
class Backlash(Disturbance):
    """A dead zone in series with spring and damper: nothing is transmitted until the play is taken up."""

    name: ClassVar[str] = "backlash"
    where: str = par("", "", _JOINT)
    width: float = par(0.0, "rad", "full play", 0.0, 0.5)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._half = np.zeros(model.nu)
        self._half[joint_indices(table, self.where)] = self.width / 2.0
        self._stiffness = model.actuator_gainprm[:, 0].copy()
        self._damping = -model.actuator_biasprm[:, 2]

    def spring_torque(self, t: float, deflection: Array, rate: Array) -> Array:
        """See Disturbance."""
        lost = np.clip(deflection, -self._half, self._half)
        free = (np.abs(deflection) < self._half) * self._damping * rate
        return -self._stiffness * lost - free


@dataclass
class JointFriction(Disturbance):
    """Coulomb friction on the link side, in the joint's bearing: the torque sensor in the spring does not see it."""

    name: ClassVar[str] = "joint_friction"
    where: str = par("", "", _JOINT)
    coulomb: float = par(0.0, "Nm", "friction torque", 0.0, 100.0)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        for i in joint_indices(table, self.where):
            joint = spec.joint(table.joint_names[i])
            joint.frictionloss = self.coulomb
            joint.solref_friction = [0.002, 1.0]  # sticks within a few steps of the integrator instead of creeping
