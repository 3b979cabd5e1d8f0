# SPDX-License-Identifier: BSD-3-Clause
"""How soon the monitor detects effects that begin in mid-walk, and how often it raises a false alarm.

    python bench/monitor.py [--seed N] [--draws 1] [--clean 3]       # --draws 3 --clean 20: some 35 minutes

Each draw is another robot (springs and masses within tolerances, default sensors) on another gait. Clean walks take
31 s. Effects are the medium ones of judge/families.py and begin 7 to 10 s into a walk of 17 s: those that `coman
record --hide ...,after=T` knows, and (marked *) a spring, damper or bearing that suddenly changes, and a load that
is added. A detection before the effect begins is a false alarm. By default the seeds are fresh: nothing was chosen or
reported on them (judge/seeds.yaml); the line to add to that file is printed at the end.
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
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.monitor.monitor import Mismatch
from coman_reduced_model.judge.cases import GAITS, data_sheet
from coman_reduced_model.judge.families import FAMILIES
from coman_reduced_model.judge.seeds import describe, entry_to_add, fresh_range
from coman_reduced_model.sim.disturbances import Disturbance, Later, Scatter, joint_indices, make, overrides
from coman_reduced_model.sim.record import plan_recording, record, robot_gait
from coman_reduced_model.sim.robot_table import ROBOTS

MEDIUM = 1
SECONDS, CLEAN_SECONDS, WITHIN = 17.0, 31.0, 5.0
BUILT_IN = ("joint_stiffness", "soft_roll", "joint_damping", "joint_friction", "payload")  # that `Sudden` can begin


class Sudden(Disturbance):
    """A change of springs, dampers, friction or load, as forces that begin in mid-walk."""

    def __init__(self, effect: dict[str, Any]) -> None:
        self.effect, self.where, self.values = effect["name"], effect["where"], effect["parameters"]

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
    """Draw the walk of a seed; None: the effect cannot begin in mid-walk."""
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


def detections(bag: Path) -> tuple[float, list[tuple[float, Mismatch]]]:
    """Length of a bag [s], and the first mismatch of each channel with its time of detection [s]."""
    config = load_config(bag.with_suffix(".yaml")).replaced({"prediction.horizons": []})
    with Session(bag, config) as session:
        results = list(session.predictions())
        monitor, start_ns = session.pipeline.monitor, session.bag.start_ns
        assert monitor is not None
        found = [((each.detected_ns - start_ns) * 1e-9, each) for each in monitor.first.values()]
    return (results[-1].stamp_ns - results[0].stamp_ns) * 1e-9, found


@dataclass(frozen=True)
class Outcome:
    """What the monitor detects in one walk."""

    case: Case
    stands: bool  # the robot did not fall
    calm: float  # [s] before the effect begins
    false: list[Mismatch]  # before the effect begins
    detected: list[tuple[float, Mismatch]]  # [s] after it has begun, within `WITHIN`

    def __str__(self) -> str:
        case = self.case
        effect = case.hidden.told() if case.hidden else ""
        first = "{:.1f} s: {}".format(*self.detected[0]) if self.detected else "nothing"
        text = "; ".join([*(f"FALSE: {each}" for each in self.false), first])
        return f"{case.seed} {case.robot} {case.gait} {effect}: {text}{'' if self.stands else '; the robot fell'}"


def watch(case: Case) -> Outcome:
    """Record a case and run the monitor on it."""
    with tempfile.TemporaryDirectory() as folder:
        stands = walk(case, Path(folder) / "walk")
        seconds, found = detections(Path(folder) / "walk")
    begins = case.after if case.family else seconds
    false = [each for at, each in found if at < begins]
    detected = [(at - begins, each) for at, each in found if begins <= at < begins + WITHIN]
    return Outcome(case, stands, min(begins, seconds), false, detected)


def by_effect(outcomes: list[Outcome]) -> Table:
    """A row for each effect."""
    table = Table("effect", "detected within 5 s", "after [s]", "first channels", "robot fell")
    for family in dict.fromkeys(each.case.family for each in outcomes if each.case.family):
        draws = [each for each in outcomes if each.case.family == family]
        firsts = [each.detected[0] for each in draws if each.detected]
        table.add_row(
            family + "*" * (family in BUILT_IN),
            f"{len(firsts)} of {len(draws)}",
            ", ".join(f"{at:.1f}" for at, _ in firsts),
            ", ".join(sorted({mismatch.channel.partition("/")[0] for _, mismatch in firsts})),
            str(sum(not each.stands for each in draws)),
        )
    return table


def main() -> None:
    """Record, watch, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, help="the first one; default: the next fresh one of judge/seeds.yaml")
    parser.add_argument("--draws", type=int, default=1, help="of each effect")
    parser.add_argument("--clean", type=int, default=3, help="clean walks")
    arguments = parser.parse_args()
    number = max(arguments.draws, arguments.clean)
    first = fresh_range("monitor", number).start if arguments.seed is None else arguments.seed
    seeds = range(first, first + number)
    state = describe("monitor", seeds)
    console = Console(width=140)
    console.print(f"seeds {seeds[0]} to {seeds[-1]}: {state}", highlight=False)
    outcomes = []
    for case in cases(first, arguments.draws, arguments.clean):
        outcomes.append(watch(case))
        console.print(str(outcomes[-1]), highlight=False)
    console.print(by_effect(outcomes))
    calm, false = sum(each.calm for each in outcomes), sum(len(each.false) for each in outcomes)
    console.print(f"without an effect: {calm:.0f} s, {false} false alarms")
    if state == "fresh":
        console.print("these seeds are spent now; add to judge/seeds.yaml under monitor, with the purpose:")
        console.print(entry_to_add(seeds), highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
