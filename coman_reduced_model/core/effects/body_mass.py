# SPDX-License-Identifier: BSD-3-Clause
"""A link that is heavier or lighter than the URDF says."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pinocchio as pin

from ...errors import ConfigError
from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Change, Measured, Unknown, World

if TYPE_CHECKING:
    from ..robot.robot import Robot

LIGHTEST = 1e-3  # [kg] of a link, from which on its mass is looked at


class BodyMass(Effect):
    """Scales mass and inertia of the link that a joint moves, with all that is fixed to it, or of the trunk.

    Its COM stays where it is. A diagnosis looks for it in links that joints move: more mass of the trunk is a
    `payload`, which also has a place.
    """

    name: ClassVar[str] = "body_mass"
    place: ClassVar[str] = "link"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", "float", 1.0, "1", "real mass over that of the URDF", 0.05, 20.0),
    )
    sentence: ClassVar[str] = "the link at {at} weighs {scale} of what the URDF says"
    experiment: ClassVar[str] = "standing on one leg with the other one raised to the front, to the side, and bent"
    exact: ClassVar[bool] = True

    def bind(self, robot: Robot) -> None:
        if self.where and self.where not in robot.joint_names:
            allowed = ", ".join(robot.joint_names)
            raise ConfigError(f"effects.{self.name}.where: no joint {self.where!r} (allowed: '', {allowed})")

    def load(self, robot: Robot) -> None:
        trunk = robot.model.frames[robot.base_id].parentJoint
        body = robot.model.getJointId(self.where) if self.where else trunk
        robot.model.inertias[body] = scaled(robot.model.inertias[body], self.values["scale"])

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        model, low = about.robot.model, float(np.log(cls.parameters[0].low))
        trunk = model.frames[about.robot.base_id].parentJoint
        prior = about.widths("body_mass.scale", "reach")
        out = []
        for joint in about.robot.joint_names:
            body = model.getJointId(joint)
            if body != trunk and model.inertias[body].mass > LIGHTEST:
                out.append(cls.unknown("scale", heavier(body), joint, low=low, logarithmic=True, **prior))
        return out


def scaled(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    """An inertia with mass and rotational inertia times a factor, its COM where it is."""
    new = pin.Inertia(inertia)
    new.mass, new.inertia = factor * inertia.mass, factor * inertia.inertia
    return new


def heavier(body: int) -> Change:
    """Scales a body by the exponential of x."""

    def apply(r: Measured, w: World, x: float) -> tuple[Measured, World]:
        model = w.model.copy()
        model.inertias[body] = scaled(model.inertias[body], float(np.exp(x)))
        return r, w.changed(model=model)

    return apply
