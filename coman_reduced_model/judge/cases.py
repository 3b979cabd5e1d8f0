# SPDX-License-Identifier: BSD-3-Clause
"""Cases drawn by seed, and their bags: a robot, what is hidden in it, a training walk and two held-out ones.

A seed gives the same case in any range. Each block of forty seeds (from a multiple of forty on) holds 12 clean robots,
18 single effects, 5 pairs and 5 effects outside the catalogue; families and levels take turns.
"""

from __future__ import annotations

import functools
import hashlib
import shutil
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..core.gait.parameters import GaitParameters
from ..errors import ConfigError
from ..output import OutputFolder
from ..sim.disturbances import Disturbance, Scatter, make
from ..sim.record import plan_recording, record, robot_gait
from ..sim.robot_table import ROBOTS, RobotTable
from ..sim.sensors import SensorOptions
from .families import CATALOGUED, FAMILIES, LEVELS, OUTSIDE, class_of

KINDS = ("clean", "single", "pair", "unknown")
BAGS = ("train", "hold1", "hold2")
SECONDS = {"train": 13.0, "hold1": 10.0, "hold2": 10.0}
GAITS: dict[str, tuple[str, dict[str, float]]] = {  # of the gait generator, with changes
    **{name: (name, {}) for name in ("test1", "test2", "in_place", "backwards", "turn", "sideways", "wide")},
    "slow": ("test1", {"single_support_s": 0.8}),
    "between": ("test1", {"step_length_m": 0.045, "single_support_s": 0.55}),
    "quick": ("test1", {"single_support_s": 0.4, "double_support_s": 0.15}),
}
ATTEMPTS = 4  # draws of place, gait and tolerances at a level before the next lower level is taken
_KINDS_OF_BLOCK = [*["clean"] * 12, *["single"] * 18, *["pair"] * 5, *["unknown"] * 5]
BLOCK = len(_KINDS_OF_BLOCK)
PAIRS = [
    pair
    for pair in combinations(CATALOGUED, 2)
    if class_of(FAMILIES[pair[0]].effect) != class_of(FAMILIES[pair[1]].effect)
]


@dataclass(frozen=True)
class HiddenCase:
    """What is hidden in which robot, and how it is recorded."""

    seed: int
    kind: str
    robot: str
    families: tuple[str, ...] = ()
    levels: tuple[str, ...] = ()
    effects: tuple[dict[str, Any], ...] = ()  # name, where, parameters
    gaits: dict[str, str] = field(default_factory=dict)  # by bag
    motor_states: str = "measured"
    attempt: int = 0  # draws before this one whose robot fell

    @property
    def name(self) -> str:
        """Name of the folder; it shows neither the content nor the place in the range of seeds."""
        return hashlib.sha256(f"coman case {self.seed}".encode()).hexdigest()[:10]


def _kind_and_number(seed: int) -> tuple[str, int]:
    """Kind of a seed, and how many smaller seeds have the same kind."""
    block, place = divmod(seed, BLOCK)
    order = np.random.default_rng([11, block]).permutation(BLOCK)
    kind = _KINDS_OF_BLOCK[order[place]]
    before = sum(_KINDS_OF_BLOCK[i] == kind for i in order[:place])
    return kind, block * _KINDS_OF_BLOCK.count(kind) + before


def _deal(choices: list[Any], number: int, salt: int) -> Any:
    """The choice with a number, if all are dealt in rounds, each in a shuffled order of its own."""
    round_, place = divmod(number, len(choices))
    return choices[np.random.default_rng([salt, round_]).permutation(len(choices))[place]]


def _families_and_levels(kind: str, number: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is hidden in the case of a kind with a number."""
    if kind == "single":
        family, level = _deal([(family, level) for family in CATALOGUED for level in LEVELS], number, 12)
        return (family,), (level,)
    if kind == "unknown":  # strong ones twice as often: the target is set for those
        levels = (*LEVELS, "strong")
        family, level = _deal([(family, level) for family in OUTSIDE for level in levels], number, 13)
        return (family,), (level,)
    if kind == "pair":
        levels = _deal([("medium", "medium"), ("medium", "strong"), ("strong", "medium")], number, 15)
        return tuple(_deal(PAIRS, number, 14)), tuple(levels)
    return (), ()


def draw_case(
    seed: int, attempt: int = 0, kind: str | None = None, families: tuple[str, ...] = (), level: str | None = None
) -> HiddenCase:
    """Draw the case of a seed.

    Args:
        seed: not negative.
        attempt: number of earlier draws in which the robot fell: the families stay, the robot is drawn again, and
            after every `ATTEMPTS` draws the level is one lower.
        kind, families, level: given instead of drawn.
    """
    drawn, number = _kind_and_number(seed)
    kind = kind or drawn
    rng = np.random.default_rng([17, seed, attempt])
    dealt, levels = _families_and_levels(kind, number)
    families = families or dealt
    if level:
        levels = (level,) * len(families)
    lower = attempt // ATTEMPTS
    levels = tuple(LEVELS[max(LEVELS.index(one) - lower, 0)] for one in levels)
    robot = str(rng.choice(["coman", "coman", "tall", "small"]))
    effects = []
    for family, one in zip(families, levels, strict=True):
        f = FAMILIES[family]
        effects.append(make(f.effect, f.parameters(rng, LEVELS.index(one), ROBOTS[robot])).told())
    train = str(rng.choice(["test1", "test2", str(rng.choice(list(GAITS)))]))
    others = [name for name in GAITS if name != train]
    held = [str(name) for name in rng.choice(others, 2, replace=False)]
    gaits = dict(zip(BAGS, (train, *held), strict=True))
    motor_states = "commanded" if rng.random() < 0.2 else "measured"
    return HiddenCase(seed, kind, robot, tuple(families), levels, tuple(effects), gaits, motor_states, attempt)


@functools.lru_cache(maxsize=64)
def _planned(robot: str, gait_name: str, seconds: float) -> tuple[GaitParameters, Any]:
    """A gait of a duration [s] and its motor motion, the same in all cases."""
    base, changes = GAITS[gait_name]
    walk = robot_gait(ROBOTS[robot], base, **changes)
    cycle = walk.single_support_s + walk.double_support_s
    steps = int((seconds - walk.stand_before_s - walk.stand_after_s - walk.double_support_s + 1e-6) / cycle)
    walk = replace(walk, steps=steps)
    return walk, plan_recording(walk, ROBOTS[robot])


def write_case(case: HiddenCase, folder: str | Path, force: bool = False) -> dict[str, Any] | None:
    """Record the bags of a case, and write the configuration of its robot with the constants of the data sheet.

    Args:
        case: see draw_case.
        folder: gets `train`, `hold1`, `hold2` and `robot.yaml`, and nothing that shows what is hidden.
        force: replace them.

    Returns:
        The answer; None: the robot fell, and nothing was written.
    """
    hidden: list[Disturbance] = [Scatter(seed=case.seed + 100_000 * case.attempt)]
    hidden += [
        make(e["name"], {**e["parameters"], **({"where": e["where"]} if e["where"] else {})}) for e in case.effects
    ]
    seeds = np.random.default_rng([18, case.seed]).integers(0, 2**31, len(BAGS))
    with OutputFolder(folder, force) as temporary:
        for bag, seed in zip(BAGS, seeds, strict=True):
            walk, planned = _planned(case.robot, case.gaits[bag], SECONDS[bag])
            sensors = SensorOptions(motor_source=case.motor_states)
            result = record(
                walk,
                temporary / bag,
                ROBOTS[case.robot],
                sensors,
                hidden,
                seed=int(seed),
                planned=planned,
            )
            result.truth.unlink()
            if result.fallen_s is not None:
                shutil.rmtree(temporary)
                temporary.mkdir()
                break
        else:
            (temporary / "robot.yaml").write_text(data_sheet(ROBOTS[case.robot]), encoding="utf-8")
            return answer(case)
    return None


def write_seed(seed: int, folder: str | Path, force: bool = False, **fixed: Any) -> tuple[HiddenCase, dict[str, Any]]:
    """Draw the case of a seed until its robot does not fall, and write it into folder / case.name.

    Raises:
        ConfigError: the robot falls at every level.
    """
    for attempt in range(ATTEMPTS * len(LEVELS)):
        case = draw_case(seed, attempt, **fixed)
        if found := write_case(case, Path(folder) / case.name, force):
            return case, found
    raise ConfigError(f"seed {seed}: {', '.join(case.families) or 'a clean robot'}: it falls at every level")


def answer(case: HiddenCase) -> dict[str, Any]:
    """What is hidden in a case: only the scorer reads it."""
    return {**asdict(case), "classes": sorted({class_of(effect["name"]) for effect in case.effects})}


def data_sheet(table: RobotTable) -> str:
    """The configuration file of a robot with nominal constants."""

    def leg(side: str) -> dict[str, Any]:
        joints = [joint for joint in table.joints() if joint.name[0] == side]
        return {
            "sole_frame": f"{side.lower()}_sole",
            "joints": [joint.name for joint in joints],
            "stiffness": [joint.stiffness for joint in joints],
            "damping": [joint.damping for joint in joints],
        }

    robot = {
        "name": table.name,
        "base_frame": "base_link",
        "left": leg("L"),
        "right": leg("R"),
        "foot_length": table.foot_back + table.foot_front,
        "foot_width": table.foot_width,
    }
    return yaml.safe_dump({"/**": {"ros__parameters": {"robot": robot}}}, sort_keys=False)
