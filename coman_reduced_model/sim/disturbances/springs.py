# SPDX-License-Identifier: BSD-3-Clause
"""Joints that are not the linear springs and dampers of the data sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.optimize import brentq

from ...core.base.parameter import par
from ...core.base.types import Array
from ..describe import set_spring
from ..robot_table import RobotTable
from ..spring_laws import Law, SpringLaw
from .base import Disturbance, joint_indices

_EARLY_AND_LATE = 0.4, 1.0, 2.0  # of the friction
_JOINT = "joint, kind of joint, left, right; empty: all"


def _scale_springs(spec: mujoco.MjSpec, table: RobotTable, where: str, stiffness: float, damping: float) -> None:
    """Factors on what the springs are already: effects at one joint multiply."""
    for i in joint_indices(table, where):
        spring = spec.actuator(table.joint_names[i])
        set_spring(spring, stiffness * float(spring.gainprm[0]), -damping * float(spring.biasprm[2]))


def _law(law: Law, joints: list[int], *values: Array | float) -> SpringLaw:
    """A law of some joints; the others have linear springs. Values of all joints (nu,), or one for all."""
    given = np.broadcast_arrays(*values)
    all_values = np.zeros((len(values), len(given[0])))
    all_values[:, joints] = np.stack(given)[:, joints]
    return SpringLaw(law, all_values)


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
class StiffnessDrift(Disturbance):
    """Springs that change while the robot walks, as they warm up: by `change`, reached as 1 - exp(-t / time).

    As a `ramp` it is reached evenly, after twice the time.
    """

    name: ClassVar[str] = "stiffness_drift"
    where: str = par("", "", _JOINT)
    change: float = par(0.0, "1", "of the stiffness, relative, in the end", -0.95, 5.0)
    time: float = par(10.0, "s", "constant of the change", 0.1, 1e4)
    form: str = par("exponential", "", "course of the change", choices=("exponential", "ramp"))

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        more = self.change * model.actuator_gainprm[:, 0]
        law = Law.RAMP if self.form == "ramp" else Law.DRIFT
        self._laws = [_law(law, joint_indices(table, self.where), more, self.time)]

    def spring_laws(self) -> list[SpringLaw]:
        """See Disturbance."""
        return self._laws


@dataclass
class Hysteresis(Disturbance):
    """Lost motion that depends on the past: the spring's end slips against the gear within `width`, held by friction.

    An element of Prandtl in series with the spring: within the width it follows the deflection as far as the torque
    exceeds `friction`; unlike play it stays where it is when the load goes. As `several` it is divided among three
    places, of which one slips earlier and one later: it slips little by little.
    """

    name: ClassVar[str] = "hysteresis"
    where: str = par("", "", _JOINT)
    width: float = par(0.0, "rad", "lost motion, full", 0.0, 0.5)
    friction: float = par(0.5, "Nm", "torque at which it slips", 0.0, 100.0)
    form: str = par("one", "", "one place that slips, or several", choices=("one", "several"))

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        stiffness = model.actuator_gainprm[:, 0]
        joints, shares = joint_indices(table, self.where), _EARLY_AND_LATE if self.form == "several" else (1.0,)
        half, slips_at = 0.5 * self.width / len(shares), self.friction / stiffness
        self._laws = [_law(Law.HYSTERESIS, joints, half, share * slips_at, stiffness) for share in shares]

    def spring_laws(self) -> list[SpringLaw]:
        """See Disturbance."""
        return self._laws


FORMS = ("cubic", "tanh", "steps")


@dataclass
class SpringNonlinearity(Disturbance):
    """Torque k d (1 + cubic d^2): hardening above zero, softening below.

    A softening spring goes on straight where its tangent has fallen to a fifth: it never pushes the wrong way. Other
    forms have the same secant stiffness as the cubic one at the deflection `at`: `tanh` saturates (softening) or grows
    like sinh (hardening), `steps` changes its slope at 0.4 of it.
    """

    name: ClassVar[str] = "spring_nonlinearity"
    where: str = par("", "", _JOINT)
    cubic: float = par(0.0, "1/rad^2", "relative change of the secant stiffness over the squared deflection", -1e6, 1e6)
    form: str = par("cubic", "", "law of the spring", choices=FORMS)
    at: float = par(0.05, "rad", "deflection at which all forms have the same secant stiffness", 1e-3, 0.5)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        stiffness, joints = model.actuator_gainprm[:, 0], joint_indices(table, self.where)
        change = float(np.clip(self.cubic * self.at**2, -0.6, 3.0))
        if self.form == "tanh":
            self._laws = [_law(Law.TANH if change < 0.0 else Law.SINH, joints, stiffness, _bend_of(change) / self.at)]
        elif self.form == "steps":
            self._laws = [_law(Law.TWO_SLOPES, joints, stiffness * change / (1.0 - _STEP), _STEP * self.at)]
        else:
            straight_from = np.sqrt(0.8 / (3.0 * -self.cubic)) if self.cubic < 0.0 else np.inf
            self._laws = [_law(Law.CUBIC, joints, stiffness * self.cubic, straight_from)]

    def spring_laws(self) -> list[SpringLaw]:
        """See Disturbance."""
        return self._laws


_STEP = 0.4  # deflection at which `steps` changes its slope, over `at`


def _bend_of(change: float) -> float:
    """Of tanh(b) / b or sinh(b) / b, the b at which the secant stiffness changes by that share."""
    if abs(change) < 1e-9:
        return 0.0
    law = np.tanh if change < 0.0 else np.sinh
    return float(brentq(lambda b: law(b) / b - 1.0 - change, 5e-5, 10.0))


@dataclass
class Backlash(Disturbance):
    """A dead zone in series with spring and damper: nothing is transmitted until the play is taken up."""

    name: ClassVar[str] = "backlash"
    where: str = par("", "", _JOINT)
    width: float = par(0.0, "rad", "full play", 0.0, 0.5)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
        self._laws = [_law(Law.PLAY, joint_indices(table, self.where), 0.5 * self.width, stiffness, damping)]

    def spring_laws(self) -> list[SpringLaw]:
        """See Disturbance."""
        return self._laws


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
