# SPDX-License-Identifier: BSD-3-Clause
"""The page of `coman validate`: the result as one picture, the ablation, and figures like the paper's 10 to 12."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..core.config.schema import Config
from ..core.evaluation.run import run_of
from ..tuning.validate import PAPER, QUICK, VARIANTS, RobotCase, Score, Validation, rows
from . import figures
from .draw import SERIES, legend, new_figure, title
from .page import Part, Section, Table, Text, page, picture

_SHOWN = ("rigid robot", "paper", "paper, tuned", "all options", "all options, tuned")
PICTURE = "validation"


def validation_page(done: Validation, cases: Sequence[RobotCase], result: Mapping[str, Any], folder: Path) -> str:
    """The HTML; the figures also as PNG files in `folder`."""
    summary = result["summary"]
    head = ["model", "walks", "x [mm]", "y [mm]", "z [mm]", "worst x", "worst z", "pitch [deg]", "skill x", "skill z"]
    cells = rows(summary)
    strong = [i for i, row in enumerate(cells) if row[0] in _SHOWN]
    overview: list[Part] = [
        picture(
            PICTURE,
            lambda: overview_figure(done.scores),
            "RMS error of the COM in x and z on walks not tuned on, by robot and model.",
            "RMS error of the free run, started again at each touchdown, on walks that were not tuned on. One bar a "
            "robot, over all its walks.",
            folder,
        ),
        Table(
            head,
            cells,
            "Root of the mean squared error of the free run over all walks; the worst walk; RMS error of the trunk's "
            "pitch; skill of predictions 0.2 s ahead (1 - RMSE / RMSE of the best baseline). "
            "Constants are those of the data sheet; tuned: on another gait (for test 1 on test 2, else on test 1).",
            strong=strong,
        ),
    ]
    sections = [
        Section("Result", overview, "result"),
        Section("As in the paper", _paper_figures(done, cases[0], folder), "paper"),
        Section("Walk by walk", [_walks(done.scores)], "walks"),
        Section("What tuning found", _tuned(done), "tuned"),
    ]
    return page("The model on walks that it was not tuned on", _lead(summary), sections, _facts(done, result))


def overview_figure(scores: Sequence[Score]) -> Figure:
    """Bars: x and z, a group a model, a bar a robot."""
    robots = list(dict.fromkeys(s.robot for s in scores))
    figure, plots = new_figure(1, 2, 3.2)
    shown = _shown(scores)
    for ax, axis in zip(plots, "xz", strict=True):
        for k, robot in enumerate(robots):
            heights = []
            for model in shown:
                own = [
                    s
                    for s in scores
                    if s.robot == robot and s.variant == (model if model != "rigid robot" else "paper")
                ]
                values = [(s.rigid_m if model == "rigid robot" else s.rmse_m)[axis] for s in own]
                heights.append(1e3 * float(np.sqrt(np.mean(np.square(values)))) if values else np.nan)
            place = np.arange(len(shown)) + (k - (len(robots) - 1) / 2) * 0.8 / len(robots)
            bars = ax.bar(place, heights, 0.74 / len(robots), color=SERIES[k], label=robot)
            ax.bar_label(
                bars,
                [f"{h:.{1 if h >= 1.0 else 2}f}" if np.isfinite(h) else "" for h in heights],
                fontsize=7.5,
                padding=1,
            )
        title(ax, figures.DIRECTIONS[axis])
        ax.set_xticks(range(len(shown)), [name.replace(", ", ",\n").replace(" ", "\n", 1) for name in shown])
        ax.set_ylabel("RMS error [mm]")
        ax.grid(False, axis="x")
    legend(figure, plots[0])
    return figure


def _paper_figures(done: Validation, case: RobotCase, folder: Path) -> list[Part]:
    """Figs. 10 to 12 on the first robot: before and after tuning, another gait; and the whole model on it."""
    trained = next((gait for robot, gait in done.trained if robot == case.robot), None)
    judged = [gait for robot, gait in done.bags if robot == case.robot and gait != trained]
    if trained is None or not judged:
        return []
    tuned = done.tuned[case.robot, trained]
    train, held = done.trained[case.robot, trained], done.bags[case.robot, judged[0]]
    paper, whole = QUICK
    other = f"tuned on {trained}, on another gait ({judged[0]})"
    wanted: list[tuple[str, str, str, Config]] = [
        ("fig10", train, f"the paper's model, not tuned ({trained})", case.config.replaced(VARIANTS[paper])),
        ("fig11", train, f"the paper's model, tuned on this walk ({trained})", tuned[f"{paper}, tuned"]),
        ("fig12", held, f"the paper's model, {other}", tuned[f"{paper}, tuned"]),
        ("whole", held, f"all options, not tuned ({judged[0]})", case.config.replaced(VARIANTS[whole])),
        ("whole_tuned", held, f"all options, {other}", tuned[f"{whole}, tuned"]),
    ]
    bare = case.config.replaced(PAPER | {"prediction.horizons": ()})
    recordings = {bag: case.read(bag, bare) for bag in (train, held)}
    parts: list[Part] = [
        Text(f"Robot {case.robot}. Three steps from the middle of the walk, chosen by place and not by fit.")
    ]
    for name, bag, words, config in wanted:
        run = run_of(recordings[bag].predict(config.replaced({"prediction.horizons": ()})))
        draw = partial(figures.three_steps, run)
        parts.append(picture(name, draw, f"COM over three steps: {words}.", f"{words[0].upper()}{words[1:]}.", folder))
    return parts


def _shown(scores: Sequence[Score]) -> list[str]:
    return [name for name in _SHOWN if name == "rigid robot" or any(s.variant == name for s in scores)]


def _walks(scores: Sequence[Score]) -> Table:
    body, shown = [], _shown(scores)
    for robot, gait in dict.fromkeys((s.robot, s.gait) for s in scores):
        own = {s.variant: s for s in scores if (s.robot, s.gait) == (robot, gait)}
        cells = []
        for model in shown:
            s = own.get("paper" if model == "rigid robot" else model)
            values = None if s is None else s.rigid_m if model == "rigid robot" else s.rmse_m
            cells.append("-" if values is None else ", ".join(f"{1e3 * values[a]:.2f}" for a in "xyz"))
        body.append([f"{robot}, {gait}", *cells])
    return Table(["walk", *shown], body, "RMS error of x, y, z [mm].")


def _tuned(done: Validation) -> list[Part]:
    parts: list[Part] = []
    for (robot, gait), configs in done.tuned.items():
        for name, config in configs.items():
            flat = config.flat()
            keys = [f"model.{n}" for n in ("a1", "b1", "c1", "e1", "a2", "b2", "c2", "e2")]
            if config.turning:
                keys = ["robot.left.stiffness", "robot.right.stiffness", "model.friction"]
            rows = [[key, str(flat[key])] for key in keys if key in flat]
            parts.append(Table(["parameter", "value"], rows, words=2, folded=f"{robot}, {name} on {gait}"))
    return parts


def _lead(summary: Mapping[str, Any]) -> str:
    best, paper = summary.get("all options"), summary["paper"]
    text = f"On walks not tuned on, x and z of the COM are off by {_mm(paper['rigid_m'])} mm for a rigid robot, "
    text += f"{_mm(paper['rmse_m'])} mm by the paper's model"
    if best:
        text += f" and {_mm(best['rmse_m'])} mm by the turning trunk"
    return text + " (RMS)."


def _mm(values: Mapping[str, float]) -> str:
    return " and ".join(f"{1e3 * values[a]:.2f}" for a in "xz")


def _facts(done: Validation, result: Mapping[str, Any]) -> list[tuple[str, str]]:
    robots = list(dict.fromkeys(robot for robot, _ in done.bags))
    return [("robots", ", ".join(robots)), ("walks", str(len(done.bags))), ("first seed", str(result["seed"]))]
