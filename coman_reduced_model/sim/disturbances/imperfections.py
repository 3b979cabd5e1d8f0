# SPDX-License-Identifier: BSD-3-Clause
"""What every clean robot has, all at once: small play, friction, lags, zeros, gains, cross-talk, clocks, a slope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ...core.base.compiled import compiled
from ...core.base.parameter import par
from ...core.base.types import Array
from ..robot_table import COMAN, RobotTable
from ..sensors import Signals, cross
from ..spring_laws import Law, SpringLaw
from .base import Disturbance
from .floor import GroundSlope
from .sensors import WRENCHES, EncoderDelay, WrenchDelay

# Standard deviations, or the largest of an even distribution, for an amount of 1.
PLAY, FRICTION = 1.2e-3, 0.2  # [rad] full width, [Nm] on COMAN: largest, of each joint
LAG, DELAY = 3e-3, 2e-3  # [s] of all motors: largest; the lags of single joints differ by a fifth
ENCODER_ZERO, ECCENTRICITY = 1e-3, 5e-4  # [rad] of each link encoder: deviation, largest amplitude
TORQUE_GAIN = 0.03  # of each joint torque: deviation
WRENCH_GAIN, CROSS_TALK, WRENCH_TURN = 0.015, 0.01, 0.007  # of each foot sensor: deviations; [rad] about each axis
WRENCH_LATE, LINK_LATE = 4e-3, 1.5e-3  # [s] largest
SLOPE = 0.0045  # [rad] deviation in roll and pitch; three deviations at most
PER_TURN = (1, 2, 16)  # periods of an encoder's error in a turn
STIFF = 3000.0  # [Nm/rad] springs of drives with that friction; that of softer drives of the upper body is smaller


def torque_of(table: RobotTable) -> float:
    """What a robot's joints bear, over that of COMAN's: by weight and height."""
    return float(table.mass * table.gait["com_height_m"] / (COMAN.mass * COMAN.gait["com_height_m"]))


@dataclass
class Imperfections(Disturbance):
    """Small imperfections of every joint, motor, sensor, clock and of the floor, each drawn for itself.

    Foot sensors and clocks are drawn for the robot, not for each recording.
    """

    name: ClassVar[str] = "imperfections"
    catalogued: ClassVar[bool] = False
    seed: int = par(0, "", "of the draw", 0, 2**62)
    amount: float = par(1.0, "1", "by which all are multiplied", 0.0, 5.0)

    def drawn(self, table: RobotTable) -> dict[str, Any]:
        """All values, by name; arrays are in the order of the joints: the legs, then the upper body."""
        rng, a = np.random.default_rng([41, self.seed]), self.amount
        clipped = np.clip(rng.standard_normal(2), -3.0, 3.0)
        legs = _joints(rng, len(table.leg_joints()))
        upper = _joints(np.random.default_rng([42, self.seed]), len(table.upper))
        each = {name: np.concatenate([legs[name], upper[name]]) for name in legs if np.ndim(legs[name])}
        drives = [1.0] * len(table.leg_joints()) + [min(joint.stiffness / STIFF, 1.0) for joint in table.upper]
        return {
            "play": a * PLAY * each["play"],
            "friction": a * FRICTION * torque_of(table) * each["friction"] * drives,
            "lag": a * LAG * legs["late"] * each["lag"],
            "delay": a * DELAY * legs["delay"],
            "encoder_zero": a * ENCODER_ZERO * each["encoder_zero"],
            "eccentricity": a * ECCENTRICITY * each["eccentricity"],
            "eccentric_per_turn": each["eccentric_per_turn"],
            "eccentric_phase": each["eccentric_phase"],
            "torque_gain": 1.0 + a * TORQUE_GAIN * each["torque_gain"],
            "wrench_gain": 1.0 + a * WRENCH_GAIN * rng.standard_normal((2, 6)),
            "cross_talk": a * CROSS_TALK * rng.standard_normal((2, 6, 6)),
            "wrench_turn": a * WRENCH_TURN * rng.standard_normal((2, 3)),
            "wrench_late": a * WRENCH_LATE * rng.uniform(0.0, 1.0, 2),
            "link_late": a * LINK_LATE * rng.uniform(),
            "slope": a * SLOPE * clipped,
        }

    def to_dict(self) -> dict[str, Any]:
        """See Disturbance."""
        return {"name": self.name, "where": "", "parameters": {"seed": self.seed, "amount": self.amount}}

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        values = self.drawn(table)
        for joint, friction in zip(table.joints(), values["friction"], strict=True):
            body = spec.joint(joint.name)
            body.frictionloss = max(float(np.max(body.frictionloss)), float(friction))
        self._slope = GroundSlope(*(float(angle) for angle in values["slope"]))
        self._slope.edit_model(spec, table)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._values = v = self.drawn(table)
        springs = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
        self._play = SpringLaw(Law.PLAY, np.array([0.5 * v["play"], *springs]))
        self._dt = model.opt.timestep
        self._steps = round(v["delay"] / self._dt)
        self._past: Array | None = None
        self._moved: Array = np.empty(0)
        self._wrench_errors = dict(zip(WRENCHES, self._wrench_matrices(table), strict=True))
        late = zip(("left", "right"), v["wrench_late"], strict=True)
        self._clocks: list[Disturbance] = [WrenchDelay(foot, float(delay)) for foot, delay in late]
        self._clocks.append(EncoderDelay(float(v["link_late"])))
        for clock in self._clocks:
            clock.start(table, model, rng)

    def _wrench_matrices(self, table: RobotTable) -> list[Array]:
        """What each foot's sensor makes of a wrench at the sole: (6, 6), gains, cross-talk and turn at the sensor."""
        v, units = self._values, np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # moments at 0.1 m
        to_sensor = np.eye(6)
        lever = np.array([0.0, 0.0, table.ankle_height - table.sensor_below_ankle])
        to_sensor[3:, :3] = np.array([cross(-lever, axis) for axis in np.eye(3)]).T
        found = []
        for k in (0, 1):
            mix = np.diag(v["wrench_gain"][k])
            mix += np.outer(units, 1.0 / units) * (1.0 - np.eye(6)) * v["cross_talk"][k]
            turn = np.kron(np.eye(2), Rotation.from_rotvec(v["wrench_turn"][k]).as_matrix().T)
            found.append(np.linalg.inv(to_sensor) @ mix @ turn @ to_sensor)
        return found

    def move_motors(self, t: Array, theta: Array, theta_rate: Array) -> tuple[Array, Array]:
        """See Disturbance: the references arrive late, and the motors follow them with a lag."""
        if self._past is None:
            self._past = np.tile(theta[0], (self._steps, 1))
            self._moved = theta[0].copy()
        known = np.concatenate([self._past, theta])
        wanted, self._past = known[: len(theta)], known[len(theta) :]
        before, self._moved = self._moved, self._moved.copy()
        moved = _follow(wanted, self._dt / (self._values["lag"] + self._dt), self._moved)
        return moved, (moved - np.concatenate([before[None], moved[:-1]])) / self._dt

    def spring_laws(self) -> list[SpringLaw]:
        """See Disturbance."""
        return [self._play]

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance: encoders, torques, foot sensors, clocks, and the IMU on a sloping floor."""
        v = self._values
        error = v["eccentricity"] * np.sin(v["eccentric_per_turn"] * signals.q + v["eccentric_phase"])
        signals.q += v["encoder_zero"] + error
        signals.tau *= v["torque_gain"]
        for foot, errors in self._wrench_errors.items():
            setattr(signals, foot, errors @ getattr(signals, foot))
        for clock in self._clocks:
            clock.sense(t, signals)
        self._slope.sense(t, signals)


def _joints(rng: np.random.Generator, n: int) -> dict[str, Any]:
    """Draws for n joints, before they get a size, and those that all motors share."""
    return {
        "play": rng.uniform(0.1, 1.0, n),
        "friction": rng.uniform(0.1, 1.0, n),
        "late": rng.uniform(),
        "lag": rng.uniform(0.8, 1.2, n),
        "delay": rng.uniform(),
        "encoder_zero": rng.standard_normal(n),
        "eccentricity": rng.uniform(0.0, 1.0, n),
        "eccentric_per_turn": rng.choice(PER_TURN, n),
        "eccentric_phase": rng.uniform(-np.pi, np.pi, n),
        "torque_gain": rng.standard_normal(n),
    }


@compiled
def _follow(wanted: Array, share: Array, position: Array) -> Array:
    """Positions (n, nj) that go a share (nj,) of the way to the wanted ones each step; `position` (nj,) is the last."""
    moved = np.empty_like(wanted)
    for i in range(len(wanted)):
        for j in range(len(position)):
            position[j] += share[j] * (wanted[i, j] - position[j])
            moved[i, j] = position[j]
    return moved
