# SPDX-License-Identifier: BSD-3-Clause
"""Motions of the virtual robot gone through, with what is hidden in it."""

from __future__ import annotations

import numpy as np
import pytest

from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.disturbances.base import Disturbance
from coman_reduced_model.sim.motion import LegKinematics, plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import VirtualRobot

G, WEIGHT = 9.81, 17.3 * 9.81
K, D = COMAN.joint_array(COMAN.stiffness), COMAN.joint_array(COMAN.damping)
KNEES = [3, 9]


class Rates(Disturbance):
    """Disturbs nothing; keeps the joints' velocities at each physics step, by its number."""

    name = "rates"

    def start(self, table, model, rng) -> None:
        self.dt, self.qd = model.opt.timestep, {}
        self.joints = [int(model.joint(name).dofadr[0]) for name in table.joint_names]

    def apply(self, t, model, data) -> None:
        self.qd[round(t / self.dt)] = data.qvel[self.joints].copy()

    def after(self, truths) -> np.ndarray:
        """(n, 12) [rad/s] after the physics steps that begin with these truths: what the integrator damps with."""
        return np.array([self.qd[round(truth.t / self.dt) + 1] for truth in truths])


class Run:
    """A motion gone through: readings and truths, period by period."""

    def __init__(self, motion, seconds: float, hide: str = "", settle: float = 1.0, **options) -> None:
        sensors = SensorOptions.exact(**options)
        self._rates = Rates()
        hidden = [*(parse(text) for text in filter(None, hide.split("+"))), self._rates]
        self.robot = VirtualRobot(COMAN, sensors, hidden)
        self.robot.reset(motion, settle_s=settle)
        self.readings, self.truths = [], []
        while self.robot.t < seconds - 1e-9:
            self.readings.append(self.robot.step())
            self.truths.append(self.robot.truth)

    def truth(self, name: str) -> np.ndarray:
        return np.array([getattr(truth, name) for truth in self.truths])

    def damped(self) -> np.ndarray:
        """(n, 12) [rad/s] between motors and links, as the integrator damps."""
        return self.truth("motor_qd") - self._rates.after(self.truths)

    def wrench(self, foot: str) -> np.ndarray:
        messages = [getattr(r, f"{foot}_wrench") for r in self.readings]
        return np.array([[*m.force, *m.torque] for m in messages])

    def positions(self, stream: str = "joint_states") -> np.ndarray:
        return np.array([getattr(r, stream).position for r in self.readings])

    @property
    def cop(self) -> np.ndarray:
        """Centre of pressure of both feet on the floor at the end (2,) [m]."""
        force, moment = np.zeros(3), np.zeros(3)
        last = self.truths[-1]
        for T, wrench in ((last.T_left, last.left_wrench), (last.T_right, last.right_wrench)):
            f = T[:3, :3] @ wrench[:3]
            force += f
            moment += np.cross(T[:3, 3], f) + T[:3, :3] @ wrench[3:]
        return np.array([-moment[1], moment[0]]) / force[2]


@pytest.fixture(scope="module")
def planned():
    """Motors and plan of the paper's test 1."""
    return plan_motion(COMAN, plan_walk(robot_gait(COMAN, "test1")))


@pytest.fixture(scope="module")
def legs() -> LegKinematics:
    return LegKinematics(COMAN)


@pytest.fixture(scope="module")
def still(standing) -> Run:
    return Run(standing, 0.1)
