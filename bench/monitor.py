# SPDX-License-Identifier: BSD-3-Clause
"""How soon the monitor tells of effects that begin in mid-walk, and whether it is silent while nothing is wrong.

    python bench/monitor.py [--seed 43000] [--draws 1] [--clean 3]       # --draws 3 --clean 20: some 35 minutes

Every draw is a robot of its own (springs, masses scattered, default sensors) on a gait of its own. Clean walks take
31 s. Effects are medium as `judge/families.py` has them, and begin 7 to 10 s into a walk of 17 s: those that `coman
record --hide ...,after=T` knows, and (marked *) a spring, damper or bearing that suddenly is another, and a load that
is hung on. What is told before the effect begins is a false alarm as well. Seeds below 43000 chose
what is in it, or were reported.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config import load_config
from coman_reduced_model.core.monitor import Mismatch
from coman_reduced_model.judge.cases import GAITS, data_sheet
from coman_reduced_model.judge.families import FAMILIES
from coman_reduced_model.sim.disturbances import Disturbance, Later, Scatter, joint_indices, make, overrides
from coman_reduced_model.sim.record import plan_recording, record, robot_gait
from coman_reduced_model.sim.robot_table import ROBOTS

MEDIUM = 1
SECONDS, CLEAN_SECONDS, WITHIN = 17.0, 31.0, 5.0
BUILT_IN = ("joint_stiffness", "soft_roll", "joint_damping", "joint_friction", "payload")  # that `Sudden` can begin


class Sudden(Disturbance):
    """What is built into the virtual robot, as forces that begin in mid-walk."""

    def __init__(self, told: dict[str, Any]) -> None:
        self.effect, self.where, self.values = told["name"], told["where"], told["parameters"]

    def __repr__(self) -> str:
        return f"Sudden({self.effect!r}, {self.where!r}, {self.values!r})"

    def told(self) -> dict[str, Any]:
        return {"name": self.effect, "where": self.where, "parameters": self.values}

    def start(self, table: Any, model: Any, rng: Any) -> None:
        self.joints = joint_indices(table, self.where)
        self.dofs = [int(model.joint(table.joint_names[i]).dofadr[0]) for i in self.joints]
        self.k, self.d = model.actuator_gainprm[:, 0].copy(), -model.actuator_biasprm[:, 2]
        self.root = model.body("base_link").id

    def spring_torque(self, t: float, deflection: np.ndarray, rate: np.ndarray) -> np.ndarray:
        more = np.zeros_like(deflection)
        if self.effect == "joint_stiffness":
            more[self.joints] = ((self.values["scale"] - 1.0) * self.k * deflection)[self.joints]
        elif self.effect == "joint_damping":
            more[self.joints] = ((self.values["scale"] - 1.0) * self.d * rate)[self.joints]
        return more

    def apply(self, t: float, model: Any, data: Any) -> None:
        if self.effect == "joint_friction":
            data.qfrc_applied[self.dofs] -= self.values["coulomb"] * np.tanh(data.qvel[self.dofs] / 0.05)
        elif self.effect == "payload":
            R = data.xmat[self.root].reshape(3, 3)
            at = data.xpos[self.root] + R @ [self.values[axis] for axis in "xyz"] - data.xipos[self.root]
            force = np.array([0.0, 0.0, -self.values["mass"] * 9.81])
            data.xfrc_applied[self.root] += np.concatenate([force, np.cross(at, force)])


@dataclass(frozen=True)
class Case:
    """One walk."""

    seed: int
    robot: str
    gait: str
    family: str = ""  # clean
    after: float = 0.0
    hidden: Disturbance | None = None


def draw(seed: int, family: str = "") -> Case | None:
    """The walk of a seed; None: the effect cannot begin in mid-walk."""
    rng = np.random.default_rng([23, seed, *family.encode()])
    robot, gait = str(rng.choice(["coman", "coman", "tall", "small"])), str(rng.choice(list(GAITS)))
    if not family:
        return Case(seed, robot, gait)
    after = float(rng.uniform(7.0, 10.0))
    one = FAMILIES[family]
    hidden = make(one.effect, one.parameters(rng, MEDIUM, ROBOTS[robot]))
    if family in BUILT_IN:
        hidden = Sudden(hidden.told())
    elif overrides([hidden], "edit_model") or overrides([hidden], "motor_loop"):
        return None
    return Case(seed, robot, gait, family, after, hidden)


_plans: dict[tuple[str, str, float], Any] = {}


def walk(case: Case, bag: Path) -> bool:
    """Record a case and its robot's data sheet; False: the robot fell."""
    key = case.robot, case.gait, SECONDS if case.family else CLEAN_SECONDS
    if key not in _plans:
        base, changes = GAITS[case.gait]
        gait = robot_gait(ROBOTS[case.robot], base, key[2], **changes)
        _plans[key] = gait, plan_recording(gait, ROBOTS[case.robot])
    gait, planned = _plans[key]
    hidden: list[Disturbance] = [Scatter(case.seed)]
    if case.hidden is not None:
        hidden.append(Later(case.hidden, case.after))
    fallen = record(gait, bag, ROBOTS[case.robot], None, hidden, seed=case.seed, planned=planned).fallen_s
    bag.with_suffix(".yaml").write_text(data_sheet(ROBOTS[case.robot]), encoding="utf-8")
    return fallen is None


def cases(seed: int, draws: int, clean: int) -> Iterator[Case]:
    """Clean walks, then effects by family."""
    for i in range(clean):
        yield draw(seed + i)  # type: ignore[misc]
    for family in FAMILIES:
        for i in range(draws):
            if case := draw(seed + i, family):
                yield case


def told(bag: Path) -> tuple[float, list[tuple[float, Mismatch]]]:
    """Length of a bag [s], and when [s] the monitor told what of it for the first time."""
    config = load_config(bag.with_suffix(".yaml")).replaced({"prediction.horizons": []})
    with Session(bag, config) as session:
        results = list(session.predictions())
        monitor, start_ns = session.pipeline.monitor, session.bag.start_ns
        assert monitor is not None
        found = [((each.told_ns - start_ns) * 1e-9, each) for each in monitor.first.values()]
    return (results[-1].stamp_ns - results[0].stamp_ns) * 1e-9, found


def main() -> None:
    """Record, watch, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=43000, help="the first one")
    parser.add_argument("--draws", type=int, default=1, help="of each effect")
    parser.add_argument("--clean", type=int, default=3, help="clean walks")
    arguments = parser.parse_args()
    console = Console(width=140)
    silent, false = 0.0, 0  # seconds without anything wrong, and what was told in them
    rows: dict[str, list[tuple[bool, float | None, str]]] = {}
    for case in cases(arguments.seed, arguments.draws, arguments.clean):
        with tempfile.TemporaryDirectory() as folder:
            stands = walk(case, Path(folder) / "walk")
            seconds, found = told(Path(folder) / "walk")
        begins = case.after if case.family else seconds
        early = [each for at, each in found if at < begins]
        late = [(at - begins, each) for at, each in found if begins <= at < begins + WITHIN]
        silent, false = silent + min(begins, seconds), false + len(early)
        said = f"{late[0][0]:.1f} s: {late[0][1]}" if late else "nothing"
        text = "; ".join([*(f"FALSE: {each}" for each in early), said])
        effect = case.hidden.told() if case.hidden else ""
        fell = "" if stands else "; the robot fell"
        console.print(f"{case.seed} {case.robot} {case.gait} {effect}: {text}{fell}", highlight=False)
        if case.family:
            rows.setdefault(case.family + "*" * (case.family in BUILT_IN), []).append(
                (stands, late[0][0] if late else None, late[0][1].channel if late else "")
            )
    table = Table("effect", "told within 5 s", "after [s]", "first channels", "robot fell")
    for family, draws in rows.items():
        after = [at for _, at, _ in draws if at is not None]
        channels = sorted({channel.partition("/")[0] for _, at, channel in draws if at is not None})
        table.add_row(
            family, f"{len(after)} of {len(draws)}", ", ".join(f"{at:.1f}" for at in after), ", ".join(channels),
            str(sum(not stands for stands, _, _ in draws)),
        )  # fmt: skip
    console.print(table)
    console.print(f"nothing wrong: {silent:.0f} s, in which {false} mismatches were told")


if __name__ == "__main__":
    main()
