# SPDX-License-Identifier: BSD-3-Clause
"""Effects that begin in mid-walk."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ..sim.disturbances import Disturbance, Later, joint_indices, overrides
from ..sim.robot_table import RobotTable
from ..sim.spring_laws import Law, SpringLaw

FORCES = ("joint_stiffness", "joint_damping", "joint_friction", "payload")  # built into the robot, or forces: `Sudden`


class Sudden(Disturbance):
    """A change of springs, dampers, friction or load, as forces: effects that are otherwise built into the robot."""

    name = "sudden"

    def __init__(self, effect: dict[str, Any]) -> None:
        """Args: name, where and parameters of the effect, as `Disturbance.to_dict` gives them."""
        self.effect, self.where, self.values = effect["name"], effect["where"], effect["parameters"]

    def __repr__(self) -> str:
        return f"Sudden({self.effect!r}, {self.where!r}, {self.values!r})"

    def to_dict(self) -> dict[str, Any]:
        """See Disturbance."""
        return {"name": self.effect, "where": self.where, "parameters": self.values}

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self.joints = joint_indices(table, self.where)
        self.dofs = [int(model.joint(table.joint_names[i]).dofadr[0]) for i in self.joints]
        self.linear = np.stack([model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]])
        self.root = model.body("base_link").id

    def spring_laws(self) -> list[SpringLaw]:
        """See Disturbance."""
        change = np.zeros_like(self.linear)
        row = {"joint_stiffness": 0, "joint_damping": 1}.get(self.effect)
        if row is not None:
            change[row, self.joints] = (self.values["scale"] - 1.0) * self.linear[row, self.joints]
        return [SpringLaw(Law.LINEAR, change)]

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        if self.effect == "joint_friction":
            data.qfrc_applied[self.dofs] -= self.values["coulomb"] * np.tanh(data.qvel[self.dofs] / 0.05)
        elif self.effect == "payload":
            R = data.xmat[self.root].reshape(3, 3)
            at = data.xpos[self.root] + R @ [self.values[axis] for axis in "xyz"] - data.xipos[self.root]
            force = np.array([0.0, 0.0, -self.values["mass"] * 9.81])
            data.xfrc_applied[self.root] += np.concatenate([force, np.cross(at, force)])


def beginning(effect: Disturbance, after: float) -> Disturbance | None:
    """The same effect from a time [s] on; None: it cannot begin in mid-walk."""
    if effect.name in FORCES:
        return Later(Sudden(effect.to_dict()), after)
    if overrides([effect], "edit_model") or overrides([effect], "motor_loop"):
        return None
    return Later(effect, after)
