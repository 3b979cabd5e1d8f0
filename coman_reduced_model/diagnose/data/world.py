# SPDX-License-Identifier: BSD-3-Clause
"""What the robot and its surroundings are believed to be: what effects change beside the measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from ...core.base.nominal import Nominal, load_nominal
from ...core.base.types import Array, Foot
from ...core.config.schema import Config
from ...core.effects.hysteresis import FRICTION
from ...core.effects.joint_friction import CREEP
from ...core.effects.stiffness_drift import TIME
from ...core.robot.robot import Robot


@dataclass
class World:
    """What the robot and its surroundings are believed to be; effects change it.

    Attributes:
        model: the URDF's model; bodies may be changed after `copy`.
        stiffness, damping: (nj,) of the series springs; NaN where the configuration names none.
        slope: roll, pitch (2,) of the floor about x, y of odom [rad].
        pull: constant force (2,) at the trunk's COM, along x, y of odom [N].
        tilting: rotation of a foot for its moment [rad/Nm]; sinking: for its force [m/N].
        softness: of the soles: rotation about y of a foot that bears the whole weight, for its moment [rad/Nm]; they
            sink accordingly.
        cubic: (nj,) torque = k d (1 + cubic d^2) [1/rad^2]; play: (nj,) full backlash [rad].
        lost, slips_at: (nj,) lost motion that friction holds [rad], and the torque under which it slips [Nm].
        drift, warming: (nj,) relative change of the stiffness while the robot walks, and its time constant [s].
        friction, creep: (nj,) at the link side, against its motion [Nm], and the speed below which it creeps [rad/s].
        yielding, settling, rotor: of the motors' position loops [rad/Nm], the time constant [s] with which they yield,
            and the reflected inertia [kg m^2] that they carry beside the spring.
        yielded: the same as yielding [rad/Nm], of motors whose states show where they really are.
        lead: share of the springs' sag under the planned torques by which motors are commanded ahead.
        slip: (2,) how far the left, the right foot slides back each time after it has landed [m].
        impulse: of the ground on each landing foot beyond the load that it takes over [Ns].
        limits: figures by name (`Nominal.limits`).
    """

    robot: Robot
    model: pin.Model
    stiffness: Array
    damping: Array
    gravity: float
    cubic: Array
    play: Array
    friction: Array
    creep: Array
    lost: Array
    slips_at: Array
    drift: Array
    warming: Array
    limits: Mapping[str, float]
    slope: Array = field(default_factory=lambda: np.zeros(2))
    pull: Array = field(default_factory=lambda: np.zeros(2))
    tilting: float = 0.0
    sinking: float = 0.0
    softness: float = 0.0
    yielding: float = 0.0
    settling: float = 0.0
    rotor: float = 0.0
    yielded: float = 0.0
    lead: float = 0.0
    slip: Array = field(default_factory=lambda: np.zeros(2))
    impulse: float = 0.0

    @classmethod
    def nominal(cls, robot: Robot, config: Config, nominal: Nominal | None = None) -> World:
        """Of a robot and its configuration, among nominal robots (default: the shipped population)."""
        stiffness = np.full(len(robot.joint_names), np.nan)
        damping = stiffness.copy()
        for foot, leg in ((Foot.LEFT, config.robot.left), (Foot.RIGHT, config.robot.right)):
            stiffness[robot.legs[foot]], damping[robot.legs[foot]] = leg.stiffness, leg.damping
        none = np.zeros(len(robot.joint_names))
        model = robot.model.copy()
        model.gravity.linear = np.array([0.0, 0.0, -config.robot.gravity])
        slips_at, warming = none + FRICTION, none + TIME
        return cls(
            robot, model, stiffness, damping, config.robot.gravity, none, none, none, none + CREEP, none, slips_at,
            none, warming, (nominal or load_nominal()).limits,
        )  # fmt: skip

    @property
    def gives_way(self) -> bool:
        """Soles move with the forces on them."""
        return bool(self.tilting or self.sinking or self.softness)

    def changed(self, **fields: object) -> World:
        """A copy with other figures."""
        return replace(self, **fields)  # type: ignore[arg-type]

    def add_mass(self, mass: float, position: Array, frame: int) -> World:
        """A copy with a point mass [kg] at a position (3,) [m] in a frame of the URDF."""
        model = self.model.copy()
        at = model.frames[frame]
        inertia = pin.Inertia(mass, at.placement.act(np.asarray(position, dtype=float)), np.zeros((3, 3)))
        model.inertias[at.parentJoint] = model.inertias[at.parentJoint] + inertia
        return self.changed(model=model)
