# SPDX-License-Identifier: BSD-3-Clause
"""The two experiments that identify the joint springs, as the virtual robot does them.

*Load*: standing on both feet, the motors slowly move the trunk and squeeze the legs against each other, so that every
spring is loaded without inertia. *Decay*: standing on one leg with every spring of it clamped but one, the trunk gets
small pushes and swings free as an inverted pendulum about that joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from ..core.base.types import Array, Phase
from ..errors import ConfigError
from ..progress import Progress
from .disturbances import Disturbance
from .motion import LegKinematics, MotorMotion, Posture
from .record import RecordedBag, check_duration, record_motion
from .robot_table import ROBOTS, RobotTable
from .sensors import SensorOptions
from .virtual_robot import VirtualRobot

EXPERIMENTS = ("load", "decay")
SOFT = ("LKneeSag", "LAnkSag", "RKneeSag", "RAnkSag")  # springs that the decay is measured of
_KICK, _KICK_S = 0.08, 0.1  # impulse [m/s] of the whole mass, its length [s]
_EVERY, _PUSHES = 10.5, 10  # time from push to push [s] for every metre of COM height; how many


class Clamps(Disturbance):
    """Joints that are locked at an angle [rad], by joint name.

    Constraints rather than stiffer springs: those make the contacts of the foot chatter.
    """

    name = "clamps"

    def __init__(self, angles: Mapping[str, float]) -> None:
        self.angles = angles

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        for name, angle in self.angles.items():
            clamp = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=name,
                solref=[0.002, 1.0],
                solimp=[0.99, 0.999, 0.001, 0.5, 2.0],
            )
            clamp.data[:5] = [angle, 0.0, 0.0, 0.0, 0.0]


class Kicks(Disturbance):
    """Short pushes at the trunk, forward and backward in turn, none as hard as another."""

    name = "kicks"

    def __init__(self, impulse: float, every: float) -> None:
        """Args: about how hard [Ns]; how often [s]."""
        self.impulse, self.every = impulse, every

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._impulses = self.impulse * rng.uniform(0.7, 1.3, 1000) * np.tile([1.0, -1.0], 500)
        self._trunk = model.body("base_link").id

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        count, after = divmod(t - 1.0, self.every)
        if 0.0 <= count < len(self._impulses) and after < _KICK_S:
            shape = 0.5 * np.pi / _KICK_S * np.sin(np.pi * after / _KICK_S)
            data.xfrc_applied[self._trunk, 0] += self._impulses[int(count)] * shape


def load_motion(table: RobotTable, duration_s: float = 60.0) -> MotorMotion:
    """Both feet stay flat; trunk and internal forces move slowly, each at a frequency of its own below 0.4 Hz."""
    legs = LegKinematics(table)
    t = np.linspace(0.0, duration_s, max(int(duration_s / 0.02), 50) + 1)
    ends = np.clip(np.minimum(t, duration_s - t) / 2.0 - 0.5, 0.0, 1.0)
    window = ends**3 * (10.0 + ends * (6.0 * ends - 15.0))
    height = table.gait["com_height_m"]
    size = height / 0.38

    def wave(amplitude: float, frequency: float, phase: float = 0.0) -> Array:
        return window * amplitude * np.sin(2.0 * np.pi * frequency * t + phase)

    com = np.tile([table.gait["zmp_offset_x_m"], 0.0, height], (len(t), 1))
    com[:, 0] += size * wave(0.015, 0.21)
    com[:, 1] += size * wave(0.020, 0.13)
    com[:, 2] += size * (wave(0.012, 0.34) - 0.012 * window)
    # What the floor does not let the feet do becomes force between the legs.
    T_left, T_right = (np.tile(np.eye(4), (len(t), 1, 1)) for _ in range(2))
    for T, side in ((T_left, 1.0), (T_right, -1.0)):
        T[:, 1, 3] = side * (table.gait["step_width_m"] / 2.0 + size * wave(0.004, 0.17, 1.0))
        T[:, 0, 3] = side * size * wave(0.008, 0.11)
        yaw = side * wave(0.006, 0.07)
        T[:, 0, 0] = T[:, 1, 1] = np.cos(yaw)
        T[:, 1, 0], T[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    posture = legs.inverse(com, T_left, T_right)
    still = np.zeros((len(t), legs.model.nv))
    phase = np.full(len(t), Phase.DOUBLE)
    theta = posture.q + legs.planned_torques(posture, still, still, T_left, T_right, phase) / legs.stiffness
    yaws = [i for i, name in enumerate(table.joint_names) if name.endswith("HipYaw")]
    theta[:, yaws] += wave(0.06, 0.29)[:, None]  # the trunk turns: link encoders run through many counts
    return MotorMotion(t, theta, Posture(posture.q[:1], posture.base[:1], posture.yaw[:1]))


def decay_motion(table: RobotTable, soft: str, duration_s: float) -> MotorMotion:
    """Motors that hold the robot on the leg of a joint, the COM over its foot, the other foot in the air."""
    legs = LegKinematics(table)
    side = 1.0 if soft.startswith("L") else -1.0
    height, width = table.gait["com_height_m"], table.gait["step_width_m"]
    middle = (table.foot_front - table.foot_back) / 2.0
    stance, swing = np.eye(4)[None], np.eye(4)[None].copy()
    swing[0, :3, 3] = 0.0, -side * width, 0.12 * height
    T = (stance, swing) if side > 0.0 else (swing, stance)
    posture = legs.inverse(np.array([[middle, 0.0, height]]), *T)
    still = np.zeros((1, legs.model.nv))
    phase = np.array([Phase.LEFT if side > 0.0 else Phase.RIGHT])
    theta = posture.q + legs.planned_torques(posture, still, still, *T, phase) / legs.stiffness
    return MotorMotion(
        np.array([0.0, duration_s]),
        np.repeat(theta, 2, axis=0),
        Posture(posture.q[:1], posture.base[:1], posture.yaw[:1]),
    )


def record_experiment(
    name: str,
    out: str | Path,
    joint: str = "",
    robot: str | RobotTable = "coman",
    sensors: SensorOptions | None = None,
    disturbances: Sequence[Disturbance] = (),
    seed: int = 0,
    duration_s: float | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> RecordedBag:
    """Does an experiment and writes its bag `out` and the truth beside it.

    Args:
        name: one of EXPERIMENTS.
        out: folder of the bag.
        joint: for `decay`, the soft one; one of SOFT.
        robot: a name in `ROBOTS` or a table.
        sensors: default: SensorOptions().
        disturbances: hidden effects, such as Scatter: springs to be found.
        seed: of the sensors' noise and of the pushes.
        duration_s: default: 60 s of load, ten pushes of decay.
        force: replace an existing bag.
        progress: called now and then.

    Raises:
        ConfigError: no such experiment, robot or joint.
        OutputError: `out` exists, or cannot be written.
    """
    if isinstance(robot, str):
        if robot not in ROBOTS:
            raise ConfigError(f"robot: {robot!r} is not allowed (allowed: {', '.join(ROBOTS)})")
        robot = ROBOTS[robot]
    check_duration(duration_s)
    hidden = list(disturbances)
    if name == "load":
        motion = load_motion(robot, duration_s or 60.0)
    elif name == "decay":
        if joint not in SOFT:
            raise ConfigError(f"joint: {joint!r} is not allowed (allowed: {', '.join(SOFT)})")
        every = _EVERY * robot.gait["com_height_m"]
        motion = decay_motion(robot, joint, duration_s or _PUSHES * every + 2.0)
        held = dict(zip(robot.joint_names, motion(np.zeros(1))[0][0].tolist(), strict=True))
        hidden += [Clamps({n: held[n] for n in SOFT if n != joint}), Kicks(_KICK * robot.mass, every)]
    else:
        raise ConfigError(f"experiment: {name!r} is not allowed (allowed: {', '.join(EXPERIMENTS)})")
    body = VirtualRobot(robot, sensors, hidden, seed=seed)
    return record_motion(body, motion, out, motion.end, force, progress)
