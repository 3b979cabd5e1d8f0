# SPDX-License-Identifier: BSD-3-Clause
"""How clean robots of each kind of world differ from the plain virtual robot, and how often they fall.

    python bench/worlds.py [--draws 24] [--pictures DIR]        # a minute or two on two cores; 240 draws: ten

First each kind alone, all else as in the plain world: a walk of 6 s. Then worlds drawn by seed, each walking both gaits
of the paper for 8 s: falls by kind, and speed. Kinds that are drawn by their name alone, and long walks, at their full
length, are given to one seed in twelve.

com: true COM minus the one that the motors' plan was made for, RMS, x, y, z. force: largest vertical force that a foot
sensor reads, over the robot's weight. knee: what its
torque sensor reads minus the data sheet's spring and damper, RMS over the largest torque.

x real time: simulated over CPU time, sensors and bag included; beside it, that CPU time over what MuJoCo's steps alone
take of it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table
from rosbags.highlevel import AnyReader

from coman_reduced_model.sim.record import load_truth
from coman_reduced_model.sim.worlds import AXES, World, draw_world, record_world, world_of
from coman_reduced_model.sim.worlds.run import planned, robot_of

ALONE_S, DRAWN_S = 6.0, 8.0
GAITS = ("test1", "test2")
LONG = ("length", "long")
KNEE = "RKneeSag"


@dataclass(frozen=True)
class Walk:
    """Curves of a walk: times (n,) [s] and values."""

    com_t: Any
    com: Any  # (n, 3) [mm] truth minus plan
    force_t: Any
    force: Any  # (n,) measured vertical force of the right foot over weight
    deflection: Any  # (n,) [mrad] measured; empty: not published
    torque: Any  # (n,) [Nm] measured
    law_error: float  # see the docstring of the module; nan: not published


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=24, help="worlds, each with both gaits")
    parser.add_argument("--first", type=int, default=5000, help="their first seed")
    parser.add_argument("--pictures", type=Path, help="folder for a picture of each axis")
    arguments = parser.parse_args()
    console = Console(width=130, markup=False)
    names = [kind for kinds in AXES.values() for kind in kinds]
    with ProcessPoolExecutor(2) as pool:
        walks = dict(zip(names, pool.map(alone, names), strict=True))
        console.print(by_kind_alone(walks))
        if arguments.pictures:
            draw(walks, arguments.pictures)
        seeds = range(arguments.first, arguments.first + arguments.draws)
        rows = list(pool.map(drawn, [(seed, {"gait": gait}) for seed in seeds for gait in GAITS]))
        console.print(by_kind_drawn(rows, f"worlds as drawn, both gaits of the paper, {DRAWN_S:g} s"))
        by_name = [(axis, name) for axis, kinds in AXES.items() for name, kind in kinds.items() if not kind.weight]
        given = [{"gait": gait, axis: name} for axis, name in [*by_name, LONG] for gait in GAITS]
        rows = list(pool.map(drawn, [(seed, fixed) for fixed in given for seed in seeds[::12]]))
        console.print(by_kind_drawn(rows, "worlds with a kind that is given", [*by_name, LONG]))


# --- each kind alone ---


def alone(kind: str) -> Walk:
    """The plain world but for one axis."""
    world = replace(world_of(kind), duration_s=ALONE_S)
    with tempfile.TemporaryDirectory() as folder:
        record_world(world, Path(folder) / "walk")
        return walk_of(world, Path(folder) / "walk")


def walk_of(world: World, bag: Path) -> Walk:
    truth = load_truth(bag.with_name(f"{bag.name}.truth.npz"))
    _, plan = planned(world)
    com = 1e3 * (truth["com"] - plan.sample_many(truth["t"]).com)
    rows = read(bag)
    weight = world.table.mass * 9.81
    force_t, force = rows.get("/right_foot/wrench", np.full((2, 1), np.nan))
    joints = dict(zip(world.table.joint_names, range(99), strict=False))
    k = joints[KNEE]
    joint = world.table.joints()[k]
    (t, q, qd, tau), motors = rows["/joint_states"], rows.get("/motor_states")
    deflection = torque = np.empty(0)
    error = np.nan
    if motors is not None and len(motors[0]) and tau.size:
        theta, rate = (np.interp(t, motors[0], motors[i][:, k]) for i in (1, 2))
        deflection, torque = 1e3 * (theta - q[:, k]), tau[:, k]
        law = joint.stiffness * (theta - q[:, k]) + joint.damping * (rate - qd[:, k])
        error = float(np.sqrt(np.mean((torque - law) ** 2)) / np.abs(torque).max())
    return Walk(truth["t"], com, force_t, force / weight, deflection, torque, error)


def read(bag: Path) -> dict[str, Any]:
    """By topic: times and arrays of joint states, motor states and the right foot's vertical force."""
    out: dict[str, list[Any]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            if not connection.topic.endswith(("joint_states", "motor_states", "right_foot/wrench")):
                continue
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec - 1.7e9
            if hasattr(message, "wrench"):
                row = (stamp, message.wrench.force.z)
            else:
                row = (stamp, message.position, message.velocity, message.effort)
            out.setdefault(connection.topic, []).append(row)
    return {topic: tuple(np.array(column) for column in zip(*rows, strict=True)) for topic, rows in out.items()}


def by_kind_alone(walks: Mapping[str, Walk]) -> Table:
    table = Table("axis", "kind", "com [mm]", "force", "knee", title="each kind alone")
    for axis, kinds in AXES.items():
        for n, kind in enumerate(kinds):
            walk = walks[kind]
            rms = np.sqrt(np.mean(walk.com**2, axis=0))
            table.add_row(
                axis if n == 0 else "",
                kind,
                ", ".join(f"{value:.2f}" for value in rms),
                f"{walk.force.max():.2f}",
                "-" if np.isnan(walk.law_error) else f"{100 * walk.law_error:.1f} %",
            )
    return table


def draw(walks: Mapping[str, Walk], folder: Path) -> None:
    """A picture of each axis: a row for each kind, beside the plain world in grey."""
    from matplotlib.figure import Figure

    plain = walks[next(iter(AXES["engine"]))]
    for axis, kinds in AXES.items():
        if axis == "length":
            continue
        figure = Figure((10.0, 1.75 * len(kinds) + 0.5), layout="constrained")
        panels = figure.subplots(len(kinds), 3, squeeze=False)
        for row, kind in zip(panels, kinds, strict=True):
            for walk, colours, width in (
                (plain, ("#b9bec9", "#b9bec9"), 1.0),
                (walks[kind], ("#0072b2", "#d55e00"), 1.1),
            ):
                row[0].plot(walk.com_t, walk.com[:, 0], color=colours[0], linewidth=width)
                row[0].plot(walk.com_t, walk.com[:, 2], color=colours[1], linewidth=width)
                row[1].plot(walk.force_t, walk.force, color=colours[0], linewidth=width)
                row[2].plot(walk.deflection, walk.torque, ".", color=colours[0], markersize=1.2)
            row[0].set_ylabel(kind)
            row[0].set_xlim(1.5, ALONE_S)
            row[1].set_xlim(1.5, ALONE_S)
            if not len(walks[kind].deflection):
                row[2].text(0.5, 0.1, "not published", transform=row[2].transAxes, ha="center", fontsize="small")
            for panel in row:
                panel.tick_params(labelsize="x-small")
                panel.grid(color="#e4e7ed", linewidth=0.5)
        panels[0][0].set_title("COM - plan [mm]: x blue, z orange", fontsize="small")
        panels[0][1].set_title("right foot's sensor, fz / weight", fontsize="small")
        panels[0][2].set_title("right knee: torque [Nm] over deflection [mrad]", fontsize="small")
        for panel in panels[-1][:2]:
            panel.set_xlabel("time [s]", fontsize="x-small")
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / f"worlds_{axis}.png", dpi=75, metadata={"Software": None})


# --- worlds as they are drawn ---


def drawn(task: tuple[int, dict[str, str]]) -> dict[str, Any]:
    """Whether the robot of a seed, with kinds that are given, falls, and how fast it was simulated."""
    seed, fixed = task
    world = draw_world(seed, fixed)
    if LONG not in fixed.items():
        world = replace(world, duration_s=DRAWN_S)
    with tempfile.TemporaryDirectory() as folder:
        planned(world)
        began = time.process_time()
        result = record_world(world, Path(folder) / "walk")
        speed = result.duration_s / (time.process_time() - began)
    row = {"kinds": world.kinds, "fell": result.fallen_s is not None, "speed": speed}
    return row | {"over_mujoco": bare_speed(world) / speed if world.engine == "mujoco" else np.nan}


def bare_speed(world: World) -> float:
    """Simulated over CPU time of MuJoCo's steps alone, for a second of the walk."""
    motion, _ = planned(world)
    robot = robot_of(world)
    robot.reset(motion)
    positions = motion(np.arange(0.0, 1.0, robot.model.opt.timestep))[0]
    began = time.process_time()
    for row in positions:
        robot.data.ctrl[:] = row
        mujoco.mj_step(robot.model, robot.data)
    return 1.0 / (time.process_time() - began)


def by_kind_drawn(rows: list[dict[str, Any]], what: str, pairs: Sequence[tuple[str, str]] = ()) -> Table:
    """Falls and speed by axis and kind; default: of all that are drawn."""
    head = ("axis", "kind", "walks", "fell", "x real time, median", "time / MuJoCo's steps")
    table = Table(*head, title=f"{len(rows)} walks: {what}")
    pairs = pairs or [("", "all")] + [
        (axis, kind) for axis, kinds in AXES.items() for kind in kinds if axis != "length"
    ]
    for axis, kind in pairs:
        of = [row for row in rows if kind == "all" or row["kinds"][axis] == kind]
        if of:
            median = np.median([row["speed"] for row in of])
            over = [row["over_mujoco"] for row in of if not np.isnan(row["over_mujoco"])]
            ratio = f"{np.median(over):.1f}" if over else "-"
            table.add_row(axis, kind, str(len(of)), str(sum(row["fell"] for row in of)), f"{median:.1f}", ratio)
    return table


if __name__ == "__main__":
    main()
