# SPDX-License-Identifier: BSD-3-Clause
"""Total vertical force on the feet in the worlds, as it is sampled: its means over 1 s, as a share of the weight.

    python bench/sampled_force.py [--seed 7700] [--worlds 6]

Over 1 s of walking the total vertical force has to come to the weight, but for some per cent. The sensors of the worlds
read the force of one physics step of each period, always the same one, and do not filter. Each world, drawn with
the engine MuJoCo and each controller in turn, walks with the sample at five instants of the period; true forces,
nothing hidden. `one step a period`: lowest and highest mean over 1 s, whichever the instant; `all five`: the same of
the mean of the five, about what a sensor that averages over the period would read. Walks in which a robot falls are
left out.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.core.base.types import Array
from coman_reduced_model.sim.worlds import World, draw_world
from coman_reduced_model.sim.worlds.run import planned, robot_of

SECONDS, FIRST_S, INSTANTS = 10.0, 2.0, 5  # of a walk; of which not counted: it stands; instants of a period
FALLEN = 0.5  # of the weight: a mean over 1 s that is less is that of a robot that has fallen


def share_of_weight(world: World, instant: float) -> Array:
    """Means over 1 s (n,) of the total vertical force, sampled at an instant (0 to 1) of each period."""
    robot = robot_of(world, seed=world.seed)
    robot.sensors.phase["joints"] = int(instant * robot.sensors.steps)  # the truth is that of the joints' sample
    motion, _ = planned(world)
    robot.reset(motion)
    total = []
    for _ in range(round(world.duration_s / robot.period)):
        robot.step()
        truth = robot.truth
        assert truth is not None
        feet = ((truth.T_left, truth.left_wrench), (truth.T_right, truth.right_wrench))
        total.append(sum(float(T[2, :3] @ wrench[:3]) for T, wrench in feet))
    n = round(1.0 / robot.period)
    weight = -float(robot.model.opt.gravity[2] * robot.model.body_mass.sum())
    return np.convolve(total[round(FIRST_S / robot.period) :], np.full(n, 1.0 / n / weight), "valid")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=7700)
    parser.add_argument("--worlds", type=int, default=6)
    arguments = parser.parse_args()
    table = Table("controller", "world", "contact", "one step a period [%]", "all five [%]")
    for controller in ("open_loop", "imu_control", "feet_control"):
        for seed in range(arguments.seed, arguments.seed + arguments.worlds):
            world = replace(draw_world(seed, {"controller": controller, "engine": "mujoco"}), duration_s=SECONDS)
            means = np.array([share_of_weight(world, k / INSTANTS) for k in range(INSTANTS)])
            row = (controller, f"{seed}", world.kinds["contact"])
            if means.min() < FALLEN:
                table.add_row(*row, "fell", "")
                continue
            each, both = 100.0 * means, 100.0 * means.mean(axis=0)
            table.add_row(*row, f"{each.min():.1f} to {each.max():.1f}", f"{both.min():.1f} to {both.max():.1f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
