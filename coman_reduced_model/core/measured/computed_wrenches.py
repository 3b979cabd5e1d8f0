# SPDX-License-Identifier: BSD-3-Clause
"""Wrenches of the ground on both feet where no sensor measures them (`streams.wrench_source`).

The equation of motion of the whole robot, its root link free, holds both wrenches w:

    RNEA(q, v, v') = [0; tau] + J_left^T w_left + J_right^T w_right

Its six rows of the root link are the balance of all forces and moments; the rows of the legs need measured torques.
With `torques` both are used, with `contacts` the balance alone, and a foot that is said to be in the air has no wrench.
The equations are solved by weighted least squares, with a weak prior: a wrench's moments are small, for the centre of
pressure is inside the sole. So one foot on the ground bears what the balance says, and two share it by the torques, or
without these by the place of the COM.

The velocity of the root link follows from the joints, the support sole being at rest, and accelerations from the slope
of velocities over the last samples: half of `WINDOW` late. What is computed holds the balance of forces by
construction. So it shows neither external forces nor wrong masses.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from ..base.compiled import apply, compiled, inverse_positive
from ..base.input_warning import InputWarning, WarningKind
from ..base.pose import LEVEL
from ..base.stream_names import JOINTS
from ..base.types import Array, Booleans, Foot, Sample
from ..config.schema import Config
from ..streams.differentiate import Differentiator
from .torque_signs import TorqueSigns

if TYPE_CHECKING:
    from ..robot.robot import Posture, Robot

FEET = (Foot.LEFT, Foot.RIGHT)
WINDOW = 0.03  # [s] over which velocities are differentiated
# Standard deviations, of forces in weights and of moments in weights times a metre.
BALANCE = {"torques": 0.1, "contacts": 0.02}  # of forces, by noisy and late accelerations; of moments a third
TORQUE = 0.005  # of measured torques
WRENCH = 1.0  # of the forces on a foot; of its moments by half the size of its sole
_EVERY = 5  # sample whose torques are compared with those that bear the robot
LEAST = 2.0  # times `support.contact_on`: what a foot bears at least that is said to be on the ground


class ComputedWrenches:
    """The wrenches of one robot, sample by sample.

    Args:
        robot: its model and soles.
        config: source, gravity, thresholds.
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        self._robot, self._gravity = robot, config.robot.gravity
        source = config.streams.wrench_source
        self._by_torques = source == "torques"
        self.reconfigure(config)
        weight = config.support.weight or robot.mass * self._gravity
        self._model, self._data = robot.model.copy(), robot.model.createData()
        self._q, self._v, self._a = pin.neutral(robot.model), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
        self._slope = Differentiator(WINDOW, config.streams.restart_gap, robot.model.nv)
        self._still = np.zeros(len(robot.joint_names))
        accuracy = weight * BALANCE[source] * np.array([1.0, 1.0, 1.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0])
        self._balance = accuracy**-2
        self._torque = (TORQUE * weight) ** -2
        self._prior = np.concatenate([(weight * _usual(robot.soles[foot])) ** -2 for foot in FEET])
        self._torque_signs = TorqueSigns(robot.joint_names)
        self.reset()

    def reset(self) -> None:
        """Forget which torques were measured."""
        self._without = self._with = 0  # samples without and with measured torques
        self._torque_signs.reset()

    def reconfigure(self, config: Config) -> None:
        """Take over the thresholds of the support phase."""
        weight = config.support.weight or self._robot.mass * self._gravity
        self._least = LEAST * config.support.contact_on * weight

    def warnings(self) -> list[InputWarning]:
        """That there are no torques to compute from, or that they are not those that bear the robot."""
        if self._with or not self._without:
            return self._torque_signs.warnings()
        text = f"{JOINTS}: gives no torques (effort) of the legs, which streams.wrench_source: torques needs"
        return [InputWarning(WarningKind.MISSING, JOINTS, text)]

    def filled(self, sample: Sample, link: Posture, foot: Foot, down: Array = LEVEL) -> Sample:
        """A sample, whose joints `link` has, with computed wrenches; itself where they cannot be computed.

        Args:
            sample: with torques, or with contacts.
            link: its posture.
            foot: the sole that is at rest; NONE: not known, the lower one is taken.
            down: (3,) direction of gravity in its frame.
        """
        contacts, tau = sample.contacts, sample.tau
        if self._by_torques:
            if tau is None or not all(_measured(tau[legs]) for legs in self._robot.legs.values()):
                self._without += 1
                return sample
            self._with += 1
            on_ground = np.array([True, True])
        elif contacts is None:
            return sample
        else:
            tau, on_ground = self._still * np.nan, np.array([contacts.left, contacts.right])
        if foot == Foot.NONE:
            foot = min(FEET, key=lambda each: float(link.up @ link.p[each]))
        needed = self._needed(sample, link, foot, down)
        if self._by_torques and self._with % _EVERY == 0:
            self._look(link, tau, needed)
        legs = self._leg(link, Foot.LEFT, tau), self._leg(link, Foot.RIGHT, tau)
        wrenches = _solve(self._prior, self._balance, self._torque, needed, link.J, legs, on_ground)
        for up, on in zip((2, 8), on_ground, strict=True):
            if on and not self._by_torques:
                wrenches[up] = max(wrenches[up], self._least)
        return replace(sample, left_wrench=wrenches[:6], right_wrench=wrenches[6:])

    def _look(self, link: Posture, tau: Array, needed: Array) -> None:
        """Compare the torques of the leg whose foot is lower with those by which it bears the robot alone."""
        foot = min(FEET, key=lambda each: float(link.up @ link.p[each]))
        unknown = self._leg(link, Foot.LEFT, tau * np.nan), self._leg(link, Foot.RIGHT, tau * np.nan)
        on_ground = np.array([each == foot for each in FEET])
        wrenches = _solve(self._prior, self._balance, self._torque, needed, link.J, unknown, on_ground)
        wrench = wrenches[:6] if foot == Foot.LEFT else wrenches[6:]
        columns, joints = self._robot.leg_columns[foot], self._robot.legs[foot]
        borne = link.J[:, columns].T @ (_to_base(link.R[foot], link.p[foot]) @ wrench)
        self._torque_signs.look(joints, needed[columns] - borne, tau[joints])

    def _leg(self, link: Posture, foot: Foot, tau: Array) -> _Leg:
        robot = self._robot
        return _Leg(link.R[foot], link.p[foot], robot.leg_columns[foot], tau[robot.legs[foot]])

    def _needed(self, sample: Sample, link: Posture, foot: Foot, down: Array) -> Array:
        """(nv,) generalised forces that the motion needs, in base axes."""
        link.com_in_sole(foot)
        self._robot.scatter(sample.q, self._q)
        self._v[self._robot.idx_v] = sample.qd
        self._v[:3], self._v[3:6] = link.base_in_sole[4], link.base_in_sole[5]
        slope = self._slope.update(sample.stamp_ns, self._v)
        self._a[:] = 0.0 if slope is None else slope
        self._model.gravity.linear = self._gravity * (link.R[foot] @ down)
        needed: Array = pin.rnea(self._model, self._data, self._q, self._v, self._a)
        return needed


def _measured(tau: Array) -> bool:
    """Whether torques of a leg are: drivers without sensors give NaN, or zeros, which no loaded leg has."""
    return bool(np.nan_to_num(tau).any())


def _usual(sole: Array) -> Array:
    """(6,) how large the wrench on a sole (4,) is, its forces in weights, its moments in weights times a metre."""
    back, front, right, left = sole
    arms = 0.5 * (left - right), 0.5 * (front - back), 0.5 * max(front - back, left - right)
    return np.array([WRENCH, WRENCH, WRENCH, *arms])


class _Leg(NamedTuple):
    """Pose of a sole in base axes, and the joints of its leg."""

    R: Array  # (3, 3)
    p: Array  # (3,) [m]
    columns: Array  # (n,) indices of the joints in the velocities of the model
    tau: Array  # (n,) [Nm]; NaN: not measured


@compiled
def _solve(
    prior: Array, balance: Array, torque: float, needed: Array, J: Array, legs: tuple[_Leg, _Leg], on_ground: Booleans
) -> Array:
    """The wrenches (12,) of both feet in their sole frames, by weighted least squares.

    Args:
        prior: (12,) weights of the wrenches, balance: (6,) of its equations, torque: of those of the joints.
        needed: (nv,) generalised forces of the motion.
        J: (6, nv) of `Posture`.
        legs: left and right.
        on_ground: (2,) feet; the other ones have no wrench.
    """
    N, b, X = np.diag(prior), np.zeros(12), np.zeros((6, 12))
    for foot in range(2):
        if on_ground[foot]:
            X[:, 6 * foot : 6 * foot + 6] = _to_base(legs[foot].R, legs[foot].p)
    for i in range(6):
        _add(N, b, X[i], needed[i], balance[i])
    for foot in range(2):
        leg = legs[foot]
        for i in range(leg.columns.shape[0]):
            c = leg.columns[i]
            row = np.zeros(12)
            for j in range(6 * foot, 6 * foot + 6):
                for k in range(6):
                    row[j] += J[k, c] * X[k, j]
            if not np.isnan(leg.tau[i]):
                _add(N, b, row, needed[c] - leg.tau[i], torque)
    return apply(inverse_positive(N), b)


@compiled
def _to_base(R: Array, p: Array) -> Array:
    """(6, 6) wrench in base axes about the base origin, by one in the frame of a sole with the pose R, p."""
    X = np.zeros((6, 6))
    for j in range(3):
        for i in range(3):
            X[i, j] = X[3 + i, 3 + j] = R[i, j]
        X[3, j] = p[1] * R[2, j] - p[2] * R[1, j]
        X[4, j] = p[2] * R[0, j] - p[0] * R[2, j]
        X[5, j] = p[0] * R[1, j] - p[1] * R[0, j]
    return X


@compiled
def _add(N: Array, b: Array, row: Array, value: float, weight: float) -> None:
    """Add the equation row x = value to the normal equations N x = b, in place."""
    for i in range(row.shape[0]):
        b[i] += weight * row[i] * value
        for j in range(row.shape[0]):
            N[i, j] += weight * row[i] * row[j]
