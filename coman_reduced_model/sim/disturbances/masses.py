# SPDX-License-Identifier: BSD-3-Clause
"""Masses that are not where the URDF says, and a robot built with the usual tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from ...core.base.parameter import par
from ..describe import set_spring
from ..robot_table import RobotTable
from .base import Disturbance, joint_indices


@dataclass
class Payload(Disturbance):
    """A point mass fixed to the trunk."""

    name: ClassVar[str] = "payload"
    mass: float = par(0.0, "kg", "of the load", 0.0, 100.0)
    x: float = par(0.0, "m", "where, in base_link", -1.0, 1.0)
    y: float = par(0.0, "m", "where, in base_link", -1.0, 1.0)
    z: float = par(0.1, "m", "where, in base_link", -1.0, 1.0)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        if self.mass == 0.0:
            return
        load = spec.body("base_link").add_body(name="payload", pos=[self.x, self.y, self.z])
        load.explicitinertial, load.mass, load.inertia = True, self.mass, [1e-6 * self.mass] * 3
        load.ipos = [0.0, 0.0, 0.0]  # MuJoCo takes `pos` for it otherwise


@dataclass
class ComOffset(Disturbance):
    """The trunk's own centre of mass is elsewhere."""

    name: ClassVar[str] = "com_offset"
    x: float = par(0.0, "m", "shift of the COM of base_link", -0.2, 0.2)
    y: float = par(0.0, "m", "shift of the COM of base_link", -0.2, 0.2)
    z: float = par(0.0, "m", "shift of the COM of base_link", -0.2, 0.2)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        trunk = spec.body("base_link")
        trunk.ipos = trunk.ipos + [self.x, self.y, self.z]


@dataclass
class BodyMass(Disturbance):
    """A link that is heavier or lighter than the URDF says, its inertia with it; the COM of the link stays."""

    name: ClassVar[str] = "body_mass"
    where: str = par("", "", "joint that moves the link, or kind of joint, left, right; empty: the trunk")
    scale: float = par(1.0, "1", "real over nominal mass", 0.05, 20.0)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        joints = table.joints()
        upper = [joint.child for joint in table.upper if joint.name == self.where]
        legs = [] if upper or not self.where else [joints[i].child for i in joint_indices(table, self.where)]
        for name in upper or legs or ["base_link"]:
            body = spec.body(name)
            body.mass, body.inertia = self.scale * body.mass, self.scale * body.inertia


@dataclass
class Scatter(Disturbance):
    """A clean robot as it is built: each spring, damper and link a few percent off its data sheet, COMs a few mm.

    Normal, cut off at two standard deviations: nothing is as far off as a weak hidden effect. Drawn by a seed of its
    own, so that it is the same robot in every bag.
    """

    name: ClassVar[str] = "scatter"
    seed: int = par(0, "", "of the draw", 0, 2**31 - 1)
    spring: float = par(0.04, "1", "standard deviation of stiffness and damping", 0.0, 0.2)
    mass: float = par(0.03, "1", "standard deviation of link masses", 0.0, 0.2)
    com: float = par(0.002, "m", "standard deviation of the links' centres of mass, each axis", 0.0, 0.02)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        rng = np.random.default_rng(self.seed)

        def draw(n: int) -> np.ndarray:
            return np.clip(rng.standard_normal(n), -2.0, 2.0)

        for joint in table.joints():
            spring = spec.actuator(joint.name)
            k, d = (1.0 + self.spring * draw(2)) * [float(spring.gainprm[0]), -float(spring.biasprm[2])]
            set_spring(spring, k, d)
        for name in ("base_link", *(joint.child for joint in table.joints())):
            body = spec.body(name)
            factor = 1.0 + self.mass * float(draw(1)[0])
            body.mass, body.inertia = factor * body.mass, factor * body.inertia
            body.ipos = body.ipos + self.com * draw(3)
