# SPDX-License-Identifier: BSD-3-Clause
"""What the model reaches on walks that it was not tuned on: options one by one and together, before and after tuning.

Each robot is tuned on one gait and judged on others, freshly recorded with seeds of their own, so that neither gait
nor noise have been seen. Bags of one's own take the place of the virtual robots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config.schema import OPTIONS, Config
from ..core.evaluation.statistics import RunStatistics, by_axis
from ..core.predictor import Predictor
from ..errors import BagError, ConfigError
from ..processes import workers
from ..progress import Progress
from ..topics import TopicNames
from .free_run import compile_loop
from .parameters import tune_parameters
from .recording import JoinedBag, read_recording
from .shares import measure_shares, with_shares
from .tune import chosen, tune_coefficients

PAPER: dict[str, Any] = {
    "model.stiffness": "full",
    "model.double_support": "scaled",
    "model.shares": "constant",
    "effects.active": (),
    **{f"model.{option}": "auto" for option in OPTIONS},
    "model.trunk_rotation": "without",
}


def _with(*options: str) -> dict[str, Any]:
    return PAPER | {f"model.{option}": "with" if option in options else "without" for option in OPTIONS}


# The ablation: what each changes in the configuration. None: the configuration as it is given.
VARIANTS: dict[str, dict[str, Any]] = {
    "paper": PAPER,
    "paper, stiffness condensed": PAPER | {"model.stiffness": "condensed"},
    "paper, both legs": PAPER | {"model.double_support": "both_legs"},
    "paper, measured shares": PAPER | {"model.shares": "measured"},
    "gravity_stiffness alone": _with("gravity_stiffness"),
    "lateral_compliance alone": _with("lateral_compliance"),
    "trunk_rotation alone": _with("trunk_rotation"),
    "all options": PAPER | {"model.trunk_rotation": "auto"},
    "all but gravity_stiffness": _with(*OPTIONS[1:]),
    "all but trunk_rotation": _with("gravity_stiffness", "lateral_compliance"),  # swing_momentum acts with it alone
    "all but swing_momentum": _with("gravity_stiffness", "trunk_rotation", "lateral_compliance"),
    "all but lateral_compliance": _with(*OPTIONS[:3]),
}
QUICK = ("paper", "all options")  # of these the tuned ones as well
GAITS: dict[str, dict[str, Any]] = {  # name: of a gait in core/gait/parameters.py, and what is changed in it
    "test1": {},
    "test2": {},
    "45 mm, 0.55 s": {"step_length_m": 0.045, "single_support_s": 0.55},
    "20 mm, 0.8 s, 0.3 s": {"step_length_m": 0.02, "single_support_s": 0.8, "double_support_s": 0.3},
}
TRAINED_ON = {"test1": "test2"}  # judged on test 1: tuned on test 2; on all others: tuned on test 1


@dataclass(frozen=True)
class Score:
    """How one variant did on one bag."""

    robot: str
    gait: str
    variant: str
    rmse_m: dict[str, float]
    rigid_m: dict[str, float]
    skill: dict[str, dict[str, float]]  # by horizon and axis
    pitch_deg: float  # RMS error of the trunk's pitch; NaN where the model has none


@dataclass
class RobotCase:
    """One robot: what to record or read, and the configuration of it."""

    robot: str
    config: Config
    bags: dict[str, Path] = field(default_factory=dict)  # by gait
    tuned: dict[str, dict[str, Config]] = field(default_factory=dict)  # by the gait tuned on, and variant
    names: TopicNames = field(default_factory=TopicNames)  # in `bags`
    urdf: Path | None = None  # instead of the one that bag or configuration name

    def read(self, bag: str | Path, config: Config) -> JoinedBag:
        """One of its bags, recorded or read.

        Raises:
            ComanError: it cannot be read, lacks a topic, or holds no usable sample.
        """
        return read_recording(bag, config, self.names, self.urdf)


def virtual_case(name: str, config: Config) -> RobotCase:
    """A robot of the table with its data sheet as configuration.

    Raises:
        ConfigError: there is none of that name.
    """
    from ..sim.robot_table import ROBOTS

    if name not in ROBOTS:
        raise ConfigError(f"--robots: {name!r} is not allowed (allowed: {', '.join(ROBOTS)})")
    table = ROBOTS[name]
    changes: dict[str, Any] = {"robot.name": name, "robot.urdf": ""}
    for side, leg in (("left", config.robot.left), ("right", config.robot.right)):
        joints = leg.joints or getattr(Config().robot, side).joints
        changes[f"robot.{side}.stiffness"] = [table.stiffness[joint[1:]] for joint in joints]
        changes[f"robot.{side}.damping"] = [table.damping[joint[1:]] for joint in joints]
    return RobotCase(name, config.replaced(changes))


def record_gait(robot: str, gait: str, out: Path, seed: int, duration_s: float | None) -> Path:
    """One walk with default sensors; a robot that falls is no walk.

    Raises:
        BagError: it fell.
    """
    from ..sim.record import record

    base = gait if gait in ("test1", "test2") else "test1"
    made = record(base, out, robot, seed=seed, duration_s=duration_s, changes=GAITS[gait], force=True)
    if made.fallen_s is not None:
        raise BagError(f"{out}: the virtual robot {robot} fell at {made.fallen_s:.1f} s walking {gait}")
    return out


def score(recording: JoinedBag, config: Config, robot: str, gait: str, variant: str) -> Score:
    """Runs the predictor over a bag."""
    predictor, statistics = Predictor(recording.robot, config), RunStatistics(config.streams.restart_gap)
    pitch = []
    for sample in recording.copies():
        prediction = predictor.update(sample)
        statistics.add(prediction)
        pitch.append(prediction.measured_tilt[1] - prediction.predicted_tilt[1])
    run = statistics.summary()
    known = np.array(pitch)[np.isfinite(pitch)]
    skill = {str(h): by_axis(values) for h, values in predictor.judge.skill().items()}
    lean = math.degrees(float(np.sqrt(np.mean(known**2)))) if len(known) else float("nan")
    return Score(robot, gait, variant, run["rmse_m"], run["rmse_rigid_m"], skill, lean)


def _possible(config: Config, variants: Sequence[str]) -> dict[str, Config]:
    """The variants that a configuration can have: without the motor side, the trunk does not turn."""
    found = {}
    for name in variants:
        with suppress(ConfigError):
            found[name] = config.replaced(VARIANTS[name])
    return found


def tuned_variants(recording: JoinedBag, config: Config, variants: Sequence[str]) -> dict[str, Config]:
    """The paper's model and the whole model, each tuned on a bag."""
    found = {}
    shares = measure_shares([recording])
    for variant, bare in _possible(config, variants).items():
        bare = bare.replaced({"prediction.horizons": ()})
        bare = with_shares(bare, shares)
        names = chosen(bare, "")
        own = JoinedBag(recording.bag, recording.robot, recording.samples, recording.predict(bare), ())
        # One process: the cases are already spread over all.
        made = tune_parameters([own], bare, names, processes=1) if names else tune_coefficients([own], bare)
        found[f"{variant}, tuned"] = made.config.replaced(
            {"prediction.horizons": config.prediction.horizons, "prediction.adapt": config.prediction.adapt}
        )
    return found


def _train(
    case: RobotCase, gait: str, seed: int, duration_s: float | None, folder: Path
) -> tuple[str, dict[str, Config]]:
    bag = case.bags.get(gait)
    if bag is None:
        bag = record_gait(case.robot, gait, folder / f"{case.robot}_{gait}_train", seed, duration_s)
    recording = case.read(bag, case.config.replaced(PAPER | {"prediction.horizons": ()}))
    return str(bag), tuned_variants(recording, case.config.with_joints_of(recording.robot), QUICK)


def _judge(
    case: RobotCase, gait: str, tuned: Mapping[str, Config], variants: Sequence[str], seed: int,
    duration_s: float | None, folder: Path,
) -> tuple[str, list[Score]]:  # fmt: skip
    bag = case.bags.get(gait)
    if bag is None:
        name = gait.replace(",", "").replace(" ", "_")
        bag = record_gait(case.robot, gait, folder / f"{case.robot}_{name}", seed, duration_s)
    recording = case.read(bag, case.config.replaced(PAPER | {"prediction.horizons": ()}))
    config = case.config.with_joints_of(recording.robot)
    scores = [
        score(recording, each, case.robot, gait, name)
        for name, each in (_possible(config, variants) | dict(tuned)).items()
    ]
    if config.active:  # some act while streams are joined
        recording = case.read(bag, config)
    return str(bag), [*scores, score(recording, config, case.robot, gait, "as configured")]


@dataclass(frozen=True)
class Validation:
    """All scores, the bags and the tuned configurations."""

    scores: list[Score]
    bags: dict[tuple[str, str], str]  # by robot and gait
    trained: dict[tuple[str, str], str]
    tuned: dict[tuple[str, str], dict[str, Config]]  # by robot and the gait tuned on


def validate(
    cases: Sequence[RobotCase],
    train: Sequence[str],
    judge: Sequence[str],
    folder: Path,
    variants: Sequence[str],
    seed: int = 0,
    duration_s: float | None = None,
    processes: int = 2,
    progress: Progress | None = None,
) -> Validation:
    """Tune each robot on the gaits `train`, judge it on the gaits `judge` that it was not tuned on.

    Args:
        cases: robots; what their `bags` lack is recorded.
        train, judge: names of gaits in GAITS, or those of `bags`; nothing to train on: nothing is tuned.
        folder: for recorded bags.
        variants: names in VARIANTS.
        seed: of the first recording; each has its own.
        duration_s: about how long each walk is; default: that of the gait.
        processes: how many work at a time.
        progress: called now and then.
    """
    report = progress or (lambda fraction, words: None)
    jobs = len(cases) * (len(train) + len(judge))
    done = 0
    result = Validation([], {}, {}, {})
    if train:
        compile_loop()
    with workers(processes) as pool:

        def collected(futures: dict[Any, tuple[RobotCase, str]], what: str) -> Any:
            nonlocal done
            for future in as_completed(futures):
                case, gait = futures[future]
                done += 1
                report(done / jobs, f"{case.robot} {what} {gait}")
                yield (case.robot, gait), future.result()

        numbers = iter(range(seed, seed + jobs))
        training = {
            pool.submit(_train, case, gait, next(numbers), duration_s, folder): (case, gait)
            for case in cases
            for gait in train
        }
        # As they come, but in a report always in the same order.
        result.trained.update(((case.robot, gait), "") for case in cases for gait in train)
        result.tuned.update(((case.robot, gait), {}) for case in cases for gait in train)
        result.bags.update(((case.robot, gait), "") for case in cases for gait in judge)
        for key, (bag, configs) in collected(training, "tuned on"):
            result.trained[key], result.tuned[key] = bag, configs
        judging = {}
        for case in cases:
            for gait in judge:
                first = next(iter(train), gait)
                on = TRAINED_ON.get(gait, first) if len(train) > 1 else first
                tuned = {} if on == gait else result.tuned[case.robot, on]
                arguments = (case, gait, tuned, variants, next(numbers), duration_s, folder)
                judging[pool.submit(_judge, *arguments)] = (case, gait)
        for key, (bag, scores) in collected(judging, "judged on"):
            result.bags[key] = bag
            result.scores.extend(scores)
    order = {key: number for number, key in enumerate((case.robot, gait) for case in cases for gait in judge)}
    result.scores.sort(key=lambda s: order[s.robot, s.gait])
    return result


def summarise(scores: Sequence[Score]) -> dict[str, dict[str, Any]]:
    """By variant: root of the mean squared error over all bags, the worst bag, and mean skill; rigid beside it."""
    table: dict[str, dict[str, Any]] = {}
    for variant in dict.fromkeys(s.variant for s in scores):
        own = [s for s in scores if s.variant == variant]
        table[variant] = {
            "bags": len(own),
            "rmse_m": {a: _rms([s.rmse_m[a] for s in own]) for a in "xyz"},
            "worst_m": {a: float(np.max([s.rmse_m[a] for s in own])) for a in "xyz"},
            "rigid_m": {a: _rms([s.rigid_m[a] for s in own]) for a in "xyz"},
            "skill": {h: {a: float(np.mean([s.skill[h][a] for s in own])) for a in "xyz"} for h in own[0].skill},
            "pitch_deg": _rms([s.pitch_deg for s in own]),
        }
    return table


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def rows(summary: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """The summary as a table of texts, the rigid robot first."""

    def millimetres(values: Mapping[str, float], axes: str) -> list[str]:
        return [_text(1e3 * values[a], 2) for a in axes]

    made = []
    for number, (variant, s) in enumerate(summary.items()):
        if number == 0:
            made.append(["rigid robot", str(s["bags"]), *millimetres(s["rigid_m"], "xyz"), *["-"] * 5])
        skill = s["skill"].get("0.2", {})
        ahead = [_text(skill.get(a, math.nan), 2) for a in "xz"]
        worst = millimetres(s["worst_m"], "xz")
        made.append(
            [variant, str(s["bags"]), *millimetres(s["rmse_m"], "xyz"), *worst, _text(s["pitch_deg"], 2), *ahead]
        )
    return made


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
