# SPDX-License-Identifier: BSD-3-Clause
"""Cases drawn by seed, and their bags: a robot in a world, what is hidden in it, a training walk and two held-out ones.

A seed gives the same case in any range, at one version: sizes go by what the diagnosis' laws leave open (sizes.py).
Each block of forty seeds (from a multiple of forty on) holds 20 clean robots, 12 single effects, 4 pairs and 4 effects
outside the catalogue; families and levels take turns. The world of a case (sim/worlds) is drawn from its seed, but for
streams in which alone what is hidden shows (families.STREAMS).
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import ConfigError, EngineError
from ..output import OutputFolder
from ..sim.disturbances import DISTURBANCES, Disturbance, TooHeavyError, make
from ..sim.worlds import World, draw_world, record_world, world_yaml
from ..sim.worlds.kinds import GAITS
from ..sim.worlds.run import with_gait
from .families import CATALOGUED, FAMILIES, LEVELS, OUTSIDE, STREAMS, class_of, draw_effect
from .sizes import Draw, times_to_show

KINDS = ("clean", "single", "pair", "unknown")
BAGS = ("train", "hold1", "hold2")
HEALTHY = 3  # recordings of a robot before anything was hidden in it, for its baseline
HELD_OUT_S = 10.0  # [s] of a held-out walk
ATTEMPTS = 4  # draws at a level before the next lower level is taken
_KINDS_OF_BLOCK = [*["clean"] * 20, *["single"] * 12, *["pair"] * 4, *["unknown"] * 4]
BLOCK = len(_KINDS_OF_BLOCK)
SHARES = {kind: _KINDS_OF_BLOCK.count(kind) / BLOCK for kind in KINDS}  # of all cases
PAIRS = [
    pair
    for pair in combinations(CATALOGUED, 2)
    if class_of(FAMILIES[pair[0]].effect, "") != class_of(FAMILIES[pair[1]].effect, "")
]


@dataclass(frozen=True)
class HiddenCase:
    """What is hidden in which robot of which world, and how it is recorded."""

    seed: int
    kind: str
    world: World
    families: tuple[str, ...] = ()
    levels: tuple[str, ...] = ()
    effects: tuple[dict[str, Any], ...] = ()  # name, where, parameters
    gaits: dict[str, str] = field(default_factory=dict)  # by bag
    attempt: int = 0  # draws before this one whose robot fell
    wanted: tuple[str, ...] = ()  # levels that were asked for

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
        family = _deal(list(CATALOGUED), number, 12)
        level = _deal(list(LEVELS), number // len(CATALOGUED), 100 + list(CATALOGUED).index(family))
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
    seed: int,
    attempt: int = 0,
    kind: str | None = None,
    families: tuple[str, ...] = (),
    level: str | None = None,
    worlds: Mapping[str, str] | None = None,
    duration_s: float | None = None,
    times: Sequence[float] = (),
) -> HiddenCase:
    """Draw the case of a seed.

    Args:
        seed: not negative.
        attempt: number of earlier draws in which the robot fell: families and kinds of world stay, the world and the
            place of the effect are drawn again, and after every `ATTEMPTS` draws the level is one lower.
        kind, families, level: given instead of drawn.
        worlds: by axis, the kind of world, given instead of drawn.
        duration_s: of the training walk; held-out ones are no longer than it.
        times: one for each effect, as in `draw_effect`; none: clean robots vary by more than its recording leaves open.
    """
    drawn, number = _kind_and_number(seed)
    kind = kind or drawn
    rng = np.random.default_rng([17, seed, attempt])
    dealt, wanted = _families_and_levels(kind, number)
    families = families or dealt
    if level:
        wanted = (level,) * len(families)
    world = draw_world(seed, kinds_for(families, worlds))
    if attempt:
        world = draw_world(seed + 1_000_003 * attempt, world.kinds)
    if duration_s is not None:
        world = replace(world, duration_s=duration_s)
    effects, levels = [], []
    for family, one, larger in zip(families, wanted, times or (1.0,) * len(families), strict=True):
        lowest = max(LEVELS.index(one) - attempt // ATTEMPTS, 0)
        effect, reached = draw_effect(family, rng, lowest, world, larger)
        effects.append(make(FAMILIES[family].effect, effect).to_dict())
        levels.append(LEVELS[reached])
    others = [name for name in GAITS if name != world.kinds["gait"]]
    held = [str(name) for name in rng.choice(others, len(BAGS) - 1, replace=False)]
    gaits = dict(zip(BAGS, (world.kinds["gait"], *held), strict=True))
    return HiddenCase(seed, kind, world, tuple(families), tuple(levels), tuple(effects), gaits, attempt, tuple(wanted))


def kinds_for(families: Sequence[str], worlds: Mapping[str, str] | None) -> dict[str, str]:
    """Kinds of world by axis that are given: by the caller, and by what shows in some streams alone."""
    streams = [STREAMS[each] for each in families if each in STREAMS]
    return ({"streams": streams[0]} if streams else {}) | dict(worlds or {})


def write_case(case: HiddenCase, folder: str | Path, force: bool = False) -> dict[str, Any] | None:
    """Record the bags of a case, and write the configuration of its robot with the constants of the data sheet.

    Args:
        case: see draw_case.
        folder: gets `train`, `hold1`, `hold2` and `robot.yaml`, and nothing that shows what is hidden.
        force: replace them.

    Returns:
        The answer; None: the robot fell or its engine could not go on, and nothing was written.
    """
    try:
        with OutputFolder(folder, force) as temporary:
            for bag, seed in zip(BAGS, _seeds(case), strict=True):
                duration = case.world.duration_s if bag == BAGS[0] else min(case.world.duration_s, HELD_OUT_S)
                walk = with_gait(case.world, case.gaits[bag], duration)
                if not _walks(walk, temporary / bag, hidden_effects(case), seed):
                    raise _NoWalkError
            (temporary / "robot.yaml").write_text(data_sheet(case.world), encoding="utf-8")
    except _NoWalkError:
        return None
    return answer(case)


class _NoWalkError(Exception):
    """The robot fell, its engine could not go on, or its load is too heavy."""


def _seeds(case: HiddenCase) -> list[int]:
    """Of the noise of its bags."""
    return [int(seed) for seed in np.random.default_rng([18, case.seed]).integers(0, 2**31, len(BAGS))]


def times_of(world: World, draw: Draw, seed: int) -> tuple[float, ...]:
    """`sizes.times_to_show` by a recording of a robot before anything was hidden in it; 1 each if it falls."""
    effects, _ = draw(())
    if not any(DISTURBANCES[effect["name"]].catalogued for effect in effects):
        return (1.0,) * len(effects)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "robot.yaml").write_text(data_sheet(world), encoding="utf-8")
        if not _walks(world, folder / BAGS[0], (), seed):
            return (1.0,) * len(effects)
        return times_to_show(folder, world, draw)


def write_healthy(world: World, seed: int, folder: str | Path, force: bool = False) -> None:
    """Record the robot of a case without what is hidden: on HEALTHY gaits, drawn of those on which it does not fall."""
    rng = np.random.default_rng([19, seed])
    with OutputFolder(folder, force) as temporary:
        for gait in rng.permutation(list(GAITS)):
            bag = temporary / str(gait)
            if not _walks(with_gait(world, str(gait), world.duration_s), bag, (), int(rng.integers(2**31))):
                shutil.rmtree(bag, ignore_errors=True)
            elif len(list(temporary.iterdir())) == HEALTHY:
                break


def _walks(world: World, bag: Path, hidden: Sequence[Disturbance], seed: int) -> bool:
    """Record a bag without its truth; False: it fell, its engine could not go on, or its load is too heavy."""
    try:
        result = record_world(world, bag, hidden, seed, store=False)
    except (EngineError, TooHeavyError):
        return False
    result.truth.unlink()
    return result.fallen_s is None


def hidden_effects(case: HiddenCase) -> list[Disturbance]:
    """The hidden effects of a case, as the virtual robot takes them: zeros of sensors are added to what they read."""
    return [
        make(e["name"], {**e["parameters"], **({"where": e["where"]} if e["where"] else {})})
        for e in sorted(case.effects, key=lambda e: e["name"] == "wrench_bias")
    ]


def write_seed(seed: int, folder: str | Path, force: bool = False, **fixed: Any) -> tuple[HiddenCase, dict[str, Any]]:
    """Draw the case of a seed until its robot does not fall, and write it into folder / case.name.

    Raises:
        ConfigError: the robot falls at every level.
    """
    for attempt in range(ATTEMPTS * len(LEVELS)):
        case = draw_case(seed, attempt, **fixed)
        if case.effects:
            walk = with_gait(case.world, case.gaits[BAGS[0]], case.world.duration_s)

            def draw(times: Sequence[float], attempt: int = attempt) -> tuple[Sequence[dict[str, Any]], Sequence[str]]:
                drawn = draw_case(seed, attempt, times=times, **fixed)
                return drawn.effects, drawn.levels

            times = times_of(walk, draw, _seeds(case)[0])
            case = draw_case(seed, attempt, times=times, **fixed)
        if found := write_case(case, Path(folder) / case.name, force):
            return case, found
    raise ConfigError(f"seed {seed}: {', '.join(case.families) or 'a clean robot'}: it falls at every level")


def answer(case: HiddenCase) -> dict[str, Any]:
    """What is hidden in a case: only the scorer reads it."""
    return {
        "seed": case.seed,
        "kind": case.kind,
        "robot": case.world.robot,
        "families": list(case.families),
        "levels": list(case.levels),
        "wanted": list(case.wanted),
        "effects": list(case.effects),
        "classes": sorted({class_of(effect["name"], effect["where"]) for effect in case.effects}),
        "gaits": case.gaits,
        "attempt": case.attempt,
        "worlds": case.world.kinds,
        "world": world_yaml(case.world),
    }


def data_sheet(world: World) -> str:
    """The configuration file of a world's robot with nominal constants; without motor states, it does without them."""
    table = world.table

    def leg(side: str) -> dict[str, Any]:
        joints = [joint for joint in table.leg_joints() if joint.name[0] == side]
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
    without_motors = {} if world.sensors.motor_states else {"prediction": {"reference": "none"}}
    parameters = {"robot": robot, **without_motors}
    return yaml.safe_dump({"/**": {"ros__parameters": parameters}}, sort_keys=False)
