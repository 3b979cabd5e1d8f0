# SPDX-License-Identifier: BSD-3-Clause
"""Free run, estimate and predictions ahead of recordings and worlds, against simpler predictions.

    python bench/free_run.py BAG...                 # the tables of doc/results/free_run.md, for these bags alone
    python bench/free_run.py --worlds SEED|KIND[+KIND]... [--made DIR]

Worlds are recorded for it, or read from DIR, where they stay.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from full_simulation import full_simulation
from markdown import AXES, table, value
from pitch_ahead import PitchAhead
from truth import truth_of

import coman_reduced_model as coman
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Array, Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.baselines import BASELINES, best_baseline
from coman_reduced_model.core.evaluation.consistency import Consistency
from coman_reduced_model.core.evaluation.statistics import RunStatistics
from coman_reduced_model.judge.by_kind import new_kinds
from coman_reduced_model.judge.cases import data_sheet
from coman_reduced_model.sim.worlds import can_walk, world_of
from coman_reduced_model.sim.worlds.draw import draw_world, plain_kinds
from coman_reduced_model.sim.worlds.kinds import kind_named

SETTLED_NS = 8 * 10**9  # what is published is judged from then on
BEGUN_NS = 2 * 10**9  # a robot that stands, and sets off
DURATION = 20.0  # [s] of a walk in a world
KINDS = (
    "in_place", "backwards", "sideways", "turn", "imu_control", "feet_control", "whole_body", "whole_body:small",
    "slope", "steps", "imu_control+turn", "imu_control+no_reference", "imu_control+no_reference+turn",
    "feet_control+no_reference+turn", "feet_control+test2",
)  # fmt: skip
WORLDS = tuple(str(seed) for seed in range(7100, 7113))  # of 7102 the robot falls: twelve are left
SHOWN = ("engine", "contact", "floor", "controller", "body", "gait", "sensors", "streams", "imperfections")
USUAL = ("mujoco", "firm", "level", "open_loop", "legs", "usual", "tolerances", "all_streams")
AHEAD = "0.2"
LIMIT = 1.2  # times the best baseline, above which a recording is named
NONE = np.full(3, np.nan)

ByPredictor = dict[str, dict[str, Array]]  # RMSE (3,) [m] by horizon and predictor
Counts = dict[str, Array]  # (3,) by horizon, how many were judged


@dataclass
class Figures:
    """What a recording shows; RMS errors (3,) [m], [m/s], NaN where not known."""

    title: str
    by_seed: bool = False  # a world that was drawn by seed: nothing was chosen on it
    new_kind: bool = False  # and it has a kind that nothing was learnt on
    rigid: Array = field(default_factory=lambda: NONE)
    paper: Array = field(default_factory=lambda: NONE)
    default: Array = field(default_factory=lambda: NONE)
    full: Array = field(default_factory=lambda: NONE)  # simulation of the whole robot with its true constants
    pitch: tuple[float, float] = (np.nan, np.nan)  # [rad] of the trunk, rigid robot and default model
    pitch_ahead: Array = field(default_factory=lambda: NONE)  # [rad] less the rigid robot's: predicted, as now, rigid
    velocity: Array = field(default_factory=lambda: np.full((2, 3), np.nan))  # of the estimate, and of encoders alone
    position: Array = field(default_factory=lambda: np.full((2, 3), np.nan))  # the same of the position
    whole: ByPredictor = field(default_factory=dict)
    steady: ByPredictor = field(default_factory=dict)  # without setting off and stopping; empty: too short
    planned: bool = False  # there is a plan with a preview
    repeating: float = np.nan  # share of predictions through a stride that is repeated, once settled
    settled: ByPredictor = field(default_factory=dict)
    within: dict[str, Array] = field(default_factory=dict)
    begun: dict[str, Array] = field(default_factory=dict)  # the same of the first `BEGUN_NS`
    phases: dict[str, tuple[int, Array, Array]] = field(default_factory=dict)  # samples, rigid, default


def figures(title: str, bag: Path, config: Config) -> Figures:
    """Predict a recording by the default model, and by the paper's."""
    found = Figures(title)
    statistics, consistency = RunStatistics(config.streams.restart_gap), Consistency(truth_of(bag))
    pitch, repeating, first_ns, early, before = [], [], 0, None, Phase.FLIGHT
    landings: list[tuple[int, tuple[ByPredictor, Counts]]] = []  # beginnings of single supports, and errors until then
    with coman.Session(bag, config) as session:
        judge, predictor = session.pipeline.judge, session.pipeline.predictor
        turned = PitchAhead(session.robot, float(AHEAD))
        for sample in session.samples():  # one by one: predictor and judge are those of this prediction
            prediction = session.pipeline.predict([sample])[0]
            first_ns = first_ns or prediction.stamp_ns
            if not found.begun and prediction.stamp_ns - first_ns > BEGUN_NS:
                found.begun = judge.within()
            if early is None and prediction.stamp_ns - first_ns > SETTLED_NS:
                early = judge.rmse(), judge.judged
            if early is not None:
                repeating.append(prediction.repeating)
            if prediction.support.phase != before:
                before = prediction.support.phase
                if before in (Phase.LEFT, Phase.RIGHT):
                    landings.append((prediction.stamp_ns - first_ns, (judge.rmse(), judge.judged)))
            plan = predictor.sample.reference if predictor.sample else None
            found.planned |= plan is not None and len(plan.preview_com) > 0
            statistics.add(prediction)
            consistency.add(prediction)
            if np.isfinite(prediction.predicted_tilt[1]) and not prediction.flags.diverged:
                rigid = predictor.dynamics.motor.tilt[1]  # type: ignore[attr-defined]
                pitch.append(prediction.measured_tilt[1] - np.array([rigid, prediction.predicted_tilt[1]]))
                turned.add(prediction, predictor.link, rigid)
    found.whole, found.within, found.pitch_ahead = judge.rmse(), judge.within(), turned.rms()
    if early is not None:
        found.settled = since(early, (found.whole, judge.judged))
        found.repeating = float(np.mean(repeating))
    found.steady = steady(landings)
    run = statistics.summary()
    found.default, found.rigid = vector(run["rmse_m"]), vector(run["rmse_rigid_m"])
    for phase, by in run["by_phase"].items():
        found.phases[phase.lower()] = by["samples"], vector(by["rmse_rigid_m"]), vector(by["rmse_m"])
    if pitch:
        rigid, own = np.sqrt(np.mean(np.square(pitch), axis=0))
        found.pitch = float(rigid), float(own)
    if len(errors := consistency.errors):
        found.velocity = np.sqrt(np.nanmean(errors**2, axis=0))
        found.position = np.sqrt(np.nanmean(consistency.position_errors**2, axis=0))
    if config.prediction.reference != "none":
        statistics = RunStatistics(config.streams.restart_gap)
        with coman.Session(
            bag, config.replaced({"model.trunk_rotation": "without", "prediction.horizons": []})
        ) as session:
            for prediction in session.predictions():
                statistics.add(prediction)
        found.paper = vector(statistics.summary()["rmse_m"])
    return found


def vector(by_axis: Mapping[str, float]) -> Array:
    return np.array([by_axis[axis] for axis in AXES])


def since(early: tuple[ByPredictor, Counts], late: tuple[ByPredictor, Counts]) -> ByPredictor:
    """RMSE of what was judged between two moments."""
    out: ByPredictor = {}
    with np.errstate(invalid="ignore", divide="ignore"):
        for h, errors in late[0].items():
            before, after = early[1][h], late[1][h]
            out[h] = {
                name: np.sqrt((error**2 * after - np.nan_to_num(early[0][h][name]) ** 2 * before) / (after - before))
                for name, error in errors.items()
            }
    return out


def steady(landings: Sequence[tuple[int, tuple[ByPredictor, Counts]]]) -> ByPredictor:
    """RMSE from the first single support after 8 s, the third of the walk at least, to the last but one; or nothing."""
    known = [errors for k, (since_ns, errors) in enumerate(landings[:-1]) if k > 1 and since_ns > SETTLED_NS]
    return since(known[0], known[-1]) if len(known) > 2 else {}


def in_world(name: str, made: Path) -> Figures | None:
    """Of a world, see `recorded`; None: the robot falls."""
    walk = recorded(name, made)
    if walk is None:
        return None
    found = figures(*walk)
    found.full = full_simulation(*walk[1:])
    found.by_seed = name.isdigit()
    found.new_kind = found.by_seed and bool(new_kinds({"worlds": world_of(name).kinds}, load_nominal()))
    return found


def recorded(name: str, made: Path) -> tuple[str, Path, Config] | None:
    """Title, bag and data sheet of a seed or a kind, KIND:ROBOT for another robot; None: the robot falls.

    The bag is recorded in `made` if it is not there.
    """
    kind, _, robot = name.partition(":")
    drawn = draw_world(0, plain_kinds() | {kind_named(k)[0]: k for k in kind.split("+")}) if "+" in kind else None
    world = replace(drawn or world_of(kind), duration_s=DURATION)
    if robot:
        world = replace(world, robot=robot)
    bag = made / name.replace(":", "_")
    if not bag.is_dir() and not can_walk(world, bag, world.seed, force=True):
        shutil.rmtree(bag, ignore_errors=True)
        return None
    sheet = made / f"{bag.name}.sheet.yaml"
    sheet.write_text(data_sheet(world), encoding="utf-8")
    shown = [world.kinds[axis] for axis in SHOWN if world.kinds[axis] not in USUAL]
    title = f"world {kind}: {world.robot}, {', '.join(shown)}" if kind.isdigit() else f"{kind}, {world.robot}"
    return title, bag, coman.load_config(sheet)


# --- tables ---


def tables(rows: list[Figures]) -> list[str]:
    """The sections of the page, without phases."""
    judged = [row for row in rows if row.settled]
    return [
        "## Free run",
        "RMS of measured minus predicted COM over the whole recording, x, y, z [mm], and of the trunk's "
        "pitch [degrees]. Full simulation: MuJoCo with the very springs, masses and ground of the robot, driven by the "
        "recorded motors, where that is MuJoCo's robot of a shipped walk or of a world with motor encoders.",
        table(
            ["recording", "rigid robot", "the paper's model", "the default model", "full simulation",
             "pitch: rigid, default"],
            [[row.title, *(mm(each) for each in (row.rigid, row.paper, row.default, row.full)), degrees(row.pitch)]
             for row in rows],
        ),
        "## Estimate",
        "RMS error of velocity [mm/s] and position [mm] against the truth of the project's own simulation, x, y, z: of "
        "other recordings nobody knows it. How sure the estimate is: [consistency](observer.md).",
        table(
            ["recording", "velocity: estimate", "encoders alone", "position: estimate", "encoders alone"],
            [[row.title, *(mm(each, 0) for each in row.velocity), *(mm(each) for each in row.position)]
             for row in rows if np.isfinite(row.velocity).any()],
        ),
        "## Ahead of time",
        f"RMS error of the COM {AHEAD} s ahead, x, y, z [mm], from {SETTLED_NS // 10**9} s on. Published: the blend. "
        "Planned: a rigid robot whose motors go on as announced, or at their speed; deflected: the same, as far from "
        "it as now. All start from what is known at the stamp; persistence, still and LIPM from the estimate. "
        "Repeating: share of predictions through a stride that the robot repeats.",
        table(
            ["recording", "repeating", "published", "the model alone", *BASELINES, "clairvoyant"],
            [[row.title, value(row.repeating),
              *(mm(row.settled[AHEAD][name]) for name in ("published", "model", *BASELINES, "clairvoyant"))]
             for row in judged],
        ),
        pooled(judged),
        f"Pitch of the trunk {AHEAD} s ahead, over whole recordings: RMS error [degrees] of what it differs by from "
        "that of a rigid robot whose future motors are known. A horizon holds the COM alone; the pitch follows from "
        "the deflections of the joints, which are predicted beside it, without a blend. As now: the deflections stay; "
        "rigid: there are none. How the estimate knows the pitch now: the page of the observer.",
        table(
            ["recording", "predicted", "as now", "rigid"],
            [[row.title, *degrees(row.pitch_ahead).split(", ")] for row in rows if np.isfinite(row.pitch_ahead).any()],
        ),
        f"Skill of what is published {AHEAD} s ahead, over whole recordings and in steady strides: from "
        f"{SETTLED_NS // 10**9} s on, without the first two steps and the last two. Skill: see below. Aimed at: 0.6 in "
        "x and 0.4 in z over whole walks with a plan; 0.4 in x in steady strides without.",
        table(
            ["recording", "plan", "whole: x, y, z", "steady: x, y, z"],
            [[row.title, "yes" if row.planned else "no",
              *(", ".join(map(value, skill(by[AHEAD], "published"))) if by else "-" for by in (row.whole, row.steady))]
             for row in rows],
        ),
        "Skill of what is published 0.1, 0.2 and 0.4 s ahead, of whole recordings, setting off and stopping included: "
        "1 - RMSE / RMSE of the best of planned, deflected, persistence, still and LIPM. 1 is perfect, 0 as good as "
        "the best of them, below 0 worse.",
        by_horizon(rows, lambda row, h: skill(row.whole[h], "published")),
        "The same of the model alone, without the blend:",
        by_horizon(rows, lambda row, h: skill(row.whole[h], "model")),
        "Share of what is published that is within its 90 % interval [%]:",
        by_horizon(rows + means_of_worlds(rows), lambda row, h: 100.0 * row.within[h]),
        f"The same of the first {BEGUN_NS // 10**9} s, in which there are no errors to learn from at first:",
        by_horizon(rows + means_of_worlds(rows), lambda row, h: 100.0 * row.begun[h]),
    ]  # fmt: skip


def pooled(rows: Sequence[Figures]) -> str:
    """What is published over the best baseline, over all recordings and on each."""
    lines, beyond, all_of_them = [], [], 0
    for h in rows[0].settled:
        names = rows[0].settled[h]
        mean = {name: np.sqrt(np.nanmean([row.settled[h][name] ** 2 for row in rows], axis=0)) for name in names}
        each = np.array([over_best(row.settled[h]) for row in rows])
        lines.append([f"{h} s", ", ".join(value(one) for one in over_best(mean)),
                      ", ".join(value(one) for one in np.nanmax(each, axis=0))])  # fmt: skip
        all_of_them += int(np.isfinite(each).sum())
        for row, ratios in zip(rows, each, strict=True):
            beyond += [f"{row.title}, {h} s, {axis}: {ratio:.2f}" for axis, ratio in zip(AXES, ratios, strict=True)
                       if ratio > LIMIT]  # fmt: skip
    return (
        f"Published over the best baseline, x, y, z, from {SETTLED_NS // 10**9} s on; pooled: mean squares of the "
        f"{len(rows)} recordings, each counting once.\n\n"
        + table(["ahead", "pooled", "the worst recording"], lines)
        + f"\n\nAbove {LIMIT:g} times the best baseline: {len(beyond)} of {all_of_them}"
        + (f" ({'; '.join(beyond)})." if beyond else ".")
    )


def over_best(errors: Mapping[str, Array]) -> Array:
    """What is published over the best baseline (3,)."""
    return 1.0 - skill(errors, "published")


def skill(errors: Mapping[str, Array], of: str) -> Array:
    """1 - RMSE over that of the best baseline (3,)."""
    best = [best_baseline({name: each[axis] for name, each in errors.items()})[0] for axis in range(3)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return 1.0 - errors[of] / best


def by_phase(rows: Sequence[Figures]) -> str:
    """RMS errors of the free run by support phase."""
    cells = [
        [row.title, phase, str(samples), mm(rigid), mm(own)]
        for row in rows
        for phase, (samples, rigid, own) in row.phases.items()
    ]
    return table(["recording", "phase", "samples", "rigid robot", "the default model"], cells)


def by_horizon(rows: Sequence[Figures], of: Callable[[Figures, str], Array]) -> str:
    cells = [[row.title, *(", ".join(value(of(row, h)[axis]) for h in row.whole) for axis in range(3))] for row in rows]
    return table(["recording", *AXES], cells)


def means_of_worlds(rows: Sequence[Figures]) -> list[Figures]:
    """Rows whose shares are means over the worlds that were drawn by seed, each counting once."""
    means = []
    for title, some in (
        ("all worlds by seed", [row for row in rows if row.by_seed]),
        ("those with a kind that config/nominal.yaml was not learnt on", [row for row in rows if row.new_kind]),
    ):
        if some:
            within, begun = (
                {h: np.nanmean([each[h] for each in shares], axis=0) for h in some[0].within}
                for shares in ([row.within for row in some], [row.begun for row in some])
            )
            means.append(Figures(f"{title}: {len(some)}", whole=some[0].whole, within=within, begun=begun))
    return means


def mm(values: Array, digits: int = 2) -> str:
    return ", ".join(f"{1e3 * each:.{digits}f}" if np.isfinite(each) else "-" for each in values)


def degrees(pitch: Iterable[float]) -> str:
    return ", ".join(f"{np.degrees(each):.2f}" if np.isfinite(each) else "-" for each in pitch)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="*", metavar="BAG")
    parser.add_argument("--config", metavar="FILE")
    parser.add_argument("--worlds", nargs="*", default=[], metavar="NAME", help="seeds or kinds; KIND:ROBOT")
    parser.add_argument("--made", metavar="DIR", type=Path, help="where recordings of worlds are, or are put")
    arguments = parser.parse_args()
    rows = [figures(Path(bag).name, Path(bag), coman.load_config(arguments.config)) for bag in arguments.bags]
    with tempfile.TemporaryDirectory() as folder:
        rows += [row for name in arguments.worlds if (row := in_world(name, arguments.made or Path(folder)))]
    print("\n\n".join(tables(rows)))


if __name__ == "__main__":
    main()
