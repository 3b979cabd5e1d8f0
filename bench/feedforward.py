# SPDX-License-Identifier: BSD-3-Clause
"""How well the COM follows its plan, by what the motors lead the joints by.

    python bench/feedforward.py [--specimens 3]        # some five minutes

error: RMS of true COM minus plan, both against the support sole, while the robot walks; x, y, z. push: RMS of half the
difference of both feet's shear forces in double support, x, y: how much the feet push against each other.

*Own lead*: a share of the springs' static deflection in the planned motion. *Planned*: what `com/planned_deflection`
says, without any own lead. *Fed back*: an own lead of 0.5, and besides a share of the deflection that is measured, in
single support, in double support, or always. Specimens: springs, dampers and masses are some per cent off the data
sheet, on which the feedforward is computed.

A lead that follows the measured deflection by a share c makes a spring k into k / (1 - c). In single support this only
resists the sinking and leaning of the robot: the load is what the plan has. With both feet on the ground the legs are
a closed chain: what feet and plan differ by, the stiffened springs turn into a push of foot against foot, up to
1 / (1 - c) times as large, and the sole slides. The planned deflection has no such loop: nothing measured enters.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model import load_config
from coman_reduced_model.core.base.types import Foot, Phase
from coman_reduced_model.core.feedforward.feedforward import Feedforward
from coman_reduced_model.core.gait.gait import WalkPlan, plan_walk
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.disturbances import Scatter
from coman_reduced_model.sim.motion import MotorMotion, plan_motion
from coman_reduced_model.sim.record import robot_gait
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import Truth, VirtualRobot

GAITS = ("test1", "test2")
OWN = (("own lead 0.5", "own", 0.5), ("own lead 0.8", "own", 0.8))
SPACING = 0.01  # [s]
SLOW = 0.5  # share of the way to a new fed-back lead in a sensor period of 5 ms


def compensated(plan: WalkPlan, links: MotorMotion) -> MotorMotion:
    """Motors that lead the joints of a motion without own lead by the planned deflection of the data sheet."""
    config = load_config()
    robot = Robot(urdf(COMAN), config.robot)
    feedforward = Feedforward(robot, config)
    first = dict(zip(COMAN.joint_names, links(np.zeros(1))[0][0], strict=True))
    feedforward.start(np.array([first[name] for name in robot.joint_names]))
    order = [COMAN.joint_names.index(name) for name in robot.config.leg_joints]
    t = np.arange(-2.0 * SPACING, plan.duration_s + 2.0 * SPACING, SPACING)
    times, motors = [], []
    for point in plan.references(t, [round(1e9 * (each + 1.0)) for each in t], 0.0, 0):
        if (planned := feedforward.update(point)) is not None:
            times.append(1e-9 * planned.stamp_ns - 1.0)
            motors.append(links(np.array(times[-1:]))[0][0])
            motors[-1][order] -= planned.deflection
    return MotorMotion(np.array(times), np.array(motors), links.start)


class FedBack:
    """A motion that also leads by a share of the deflection that was measured last."""

    def __init__(self, motion: MotorMotion, share: float, phases: tuple[Phase, ...], plan: WalkPlan) -> None:
        self.start, self._motion, self._share, self._phases, self._plan = motion.start, motion, share, phases, plan
        self._lead, self._next = np.zeros((2, len(COMAN.joint_names)))

    def __call__(self, t: Any) -> tuple[Any, Any]:
        """Motor positions and velocities, each (n, nj), at times (n,) [s]."""
        theta, rate = self._motion(t)
        step = (self._next - self._lead) / len(t)
        return theta + self._lead + np.arange(len(t))[:, None] * step, rate + step / (t[1] - t[0])

    def take(self, truth: Truth) -> None:
        """The measured deflection."""
        self._lead = self._next
        fits = self._plan.sample(truth.t).phase in self._phases and truth.t > 0.5
        wanted = self._share * (truth.motor_q - truth.q) if fits else 0.0 * truth.q
        self._next = self._lead + SLOW * (wanted - self._lead)


def walk(task: tuple[str, str, float, float, tuple[Phase, ...], int]) -> str:
    """Error and push of a walk: gait, `own` or `planned`, own lead, share that is fed back and when, specimen."""
    gait, kind, lead, share, phases, specimen = task
    motion, plan = plan_motion(COMAN, plan_walk(robot_gait(COMAN, gait)), lead)
    moved: Any = compensated(plan, motion) if kind == "planned" else motion
    if share:
        moved = FedBack(motion, share, phases, plan)
    hidden = [Scatter(seed=specimen)] if specimen else []
    robot = VirtualRobot(COMAN, SensorOptions.exact(rate_hz=200.0), hidden)
    robot.reset(moved)
    truths: list[Truth] = []
    while robot.t < motion.end and not robot.fallen:
        robot.step()
        assert robot.truth is not None
        truths.append(robot.truth)
        if share:
            moved.take(robot.truth)
    return "fell" if robot.fallen else described(truths, plan)


def described(truths: list[Truth], plan: WalkPlan) -> str:
    """Errors and push as text."""
    begin, end = plan.parameters.stand_before_s, plan.duration_s - plan.parameters.stand_after_s
    points = plan.sample_many(np.array([each.t for each in truths]))
    errors, pushes = [], []
    for k, truth in enumerate(truths):
        if not begin < truth.t < end:
            continue
        foot = Foot.LEFT if truth.left_wrench[2] >= truth.right_wrench[2] else Foot.RIGHT
        there = truth.T_left if foot == Foot.LEFT else truth.T_right
        planned = (points.T_odom_left if foot == Foot.LEFT else points.T_odom_right)[k]
        errors.append(heading(there) @ (truth.com - there[:3, 3]) - heading(planned) @ (points.com[k] - planned[:3, 3]))
        if points.phase[k] == Phase.DOUBLE:
            pushes.append(0.5 * (truth.left_wrench[:2] - truth.right_wrench[:2]))
    error, push = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (errors, pushes))
    return f"{', '.join(f'{1e3 * e:.2f}' for e in error)}   {push[0]:.0f}, {push[1]:.0f}"


def heading(T: Any) -> Any:
    """(3, 3) from odom to the axes of a sole, taken as flat."""
    c, s = T[:2, 0] / np.hypot(*T[:2, 0])
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=3, help="robots off the data sheet")
    arguments = parser.parse_args()
    single, double = (Phase.LEFT, Phase.RIGHT), (Phase.DOUBLE,)
    rows: list[tuple[str, str, float, float, tuple[Phase, ...], int]] = [
        *((f"own lead {lead:g}", "own", lead, 0.0, (), 0) for lead in (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0)),
        ("planned", "planned", 0.0, 0.0, (), 0),
        *(
            (f"fed back {share:g}, {when}", "own", 0.5, share, phases, 0)
            for when, phases in (("single support", single), ("double support", double), ("always", single + double))
            for share in (0.25, 0.5)
        ),
        *(
            (f"{name}, specimen {k}", kind, lead, 0.0, (), k)
            for k in range(1, arguments.specimens + 1)
            for name, kind, lead in (*OWN, ("planned", "planned", 0.0))
        ),
    ]  # fmt: skip
    table = Table("motors lead by", *(f"{gait}: error [mm]   push [N]" for gait in GAITS))
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(walk, [(gait, *row[1:]) for row in rows for gait in GAITS]))
    for i, row in enumerate(rows):
        table.add_row(row[0], *found[2 * i : 2 * i + 2])
    Console(width=110, markup=False).print(table)


if __name__ == "__main__":
    main()
