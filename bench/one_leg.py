# SPDX-License-Identifier: BSD-3-Clause
"""A real robot on one leg: springs identified on the first seconds, the free run judged on the rest.

    python bench/one_leg.py BAG CONFIG [--seconds 20] [--picture FILE]

RMS errors after the first seconds, x, y, z [mm]. Data sheet: the configuration as it is. Identified, tuned: by what
`coman identify` and `coman tune` make of the first seconds alone (joints that are not excited there keep their
constants). Adapted: with `prediction.adapt` besides, which learns all the time, or only in the first seconds. Rigid:
where the motors, without springs, put the COM. Ahead, of each of these configurations: what is published, and the model
alone, against the best causal baseline of each axis. One row of all of them: their predictions ahead are the same.
Where no stride is repeated the deflection stays or fades, whatever the springs. Nothing was chosen on the recording.

In the picture: without springs, x is 2 mm off on one leg, and the springs of the data sheet are too soft; what is left
of x wanders with the hip pitch, whose deflection at one torque depends on the past (hysteresis, right). y is off
because the COM by the encoders, zeros of a degree, loads the ankle roll of the stance leg more than the ground does;
adaptation takes that up as a zero, in part.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from free_run import mm, since, skill
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array, Foot, Phase
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.baselines import best_baseline
from coman_reduced_model.tuning.identify import identified_config, identify
from coman_reduced_model.tuning.parameters import tune_parameters
from coman_reduced_model.tuning.recording import JoinedBag, motor_side, read_recording

HORIZONS = (0.1, 0.2, 0.4)


@dataclass
class Course:
    """What was predicted by one configuration; n samples, times from the first one."""

    t: Array  # (n,) [s]
    residual: Array  # (n, 3) [m]
    rigid: Array  # (n, 3) [m]
    double: Array  # (n,) whether both feet bear
    soles: Array  # (n, 2) roll and pitch [rad] of the right sole against the left one by the encoders
    ahead: dict[str, dict[str, Array]]  # RMSE (3,) [m] after the first seconds, by horizon and predictor

    def rms(self, values: Array, after: float) -> Array:
        return np.sqrt(np.nanmean(values[self.t >= after] ** 2, axis=0))


def main() -> None:
    """Print the tables, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("config")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--picture", metavar="FILE", type=Path)
    arguments = parser.parse_args()
    bag, after = arguments.bag, arguments.seconds
    sheet = coman.load_config(arguments.config)
    courses = {}
    for name, config in configurations(bag, sheet, after).items():
        courses[name] = follow(bag, config, after)
        adapting = config.replaced({"prediction.adapt": True})
        courses[f"{name}, adapted"] = follow(bag, adapting, after)
        courses[f"{name}, adapted in the first seconds"] = follow(bag, adapting, after, until=after)
    show(courses, after)
    if arguments.picture:
        draw(courses, bag, sheet, arguments.picture, after)


def configurations(bag: Path, sheet: Config, after: float) -> dict[str, Config]:
    """By name; all but the first are made of the first seconds."""
    measured = first_seconds(read_recording(bag, motor_side(sheet)), after)
    sheet = sheet.with_joints_of(measured.robot)
    identified = identified_config(sheet, identify([measured], sheet))
    bare = sheet.replaced({"prediction.horizons": ()})
    walked = first_seconds(read_recording(bag, bare), after)
    tuned = tune_parameters([walked], bare, ["joint_stiffness"]).config
    tuned = tuned.replaced({"prediction.horizons": sheet.prediction.horizons})
    return {"data sheet": sheet, "identified": identified, "tuned": tuned}


def first_seconds(recording: JoinedBag, seconds: float) -> JoinedBag:
    """The part of a recording before `seconds` [s]."""
    begin = recording.samples[0].stamp_ns
    n = sum(sample.stamp_ns - begin < seconds * 1e9 for sample in recording.samples)
    return replace(recording, samples=recording.samples[:n], predictions=recording.predictions[:n])


def follow(bag: Path, config: Config, after: float, until: float = np.inf) -> Course:
    """Predict a recording; adapting, if the configuration says so, until then [s]."""
    rows, early, first_ns = [], None, 0
    with coman.Session(bag, config.replaced({"prediction.horizons": HORIZONS})) as session:
        predictor = coman.Predictor(session.robot, session.config)
        for sample in session.samples():
            first_ns = first_ns or sample.stamp_ns
            t = (sample.stamp_ns - first_ns) * 1e-9
            if predictor.adaptation is not None:
                predictor.adaptation.learning = t < until
            p = predictor.update(sample)
            if early is None and t >= after:
                early = predictor.judge.rmse(), predictor.judge.judged
            R = predictor.link.sole_pose(Foot.LEFT, Foot.RIGHT)[:3, :3]
            soles = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0])
            double = p.support.phase == Phase.DOUBLE
            rows.append([t, *p.residual, *(p.measured_com - p.reference_com), double, *soles])
    assert early is not None, f"{bag}: no longer than {after:g} s"
    columns = np.array(rows)
    ahead = since(early, (predictor.judge.rmse(), predictor.judge.judged))
    return Course(columns[:, 0], columns[:, 1:4], columns[:, 4:7], columns[:, 7] > 0.0, columns[:, 8:], ahead)


def show(courses: dict[str, Course], after: float) -> None:
    """Print the tables."""
    console, plain = Console(width=150, markup=False), next(iter(courses.values()))
    table = Table("free run", "RMS error [mm]", "mean error [mm]")
    table.add_row(
        "rigid robot", mm(plain.rms(plain.rigid, after)), mm(np.nanmean(plain.rigid[plain.t >= after], axis=0))
    )
    for name, course in courses.items():
        mean = np.nanmean(course.residual[course.t >= after], axis=0)
        table.add_row(name, mm(course.rms(course.residual, after)), mm(mean))
    console.print(table)
    table = Table("ahead", "configuration", "published [mm]", "best baseline [mm]", "skill", "skill of the model alone")
    for h in plain.ahead:
        table.add_section()
        rows = {name: ahead_cells(course.ahead[h]) for name, course in courses.items()}
        for name, cells in rows.items() if len(set(rows.values())) > 1 else [("all of them", rows["data sheet"])]:
            table.add_row(f"{h} s", name, *cells)
    console.print(table)
    roll, pitch = np.degrees(np.abs(np.median(plain.soles[plain.double & (plain.t < after)], axis=0)))
    print(f"On both feet the soles differ by {roll:.1f} degrees in roll and {pitch:.1f} in pitch by the encoders.")
    for phase, which in (("two feet", plain.double), ("one foot", ~plain.double)):
        errors = [np.sqrt(np.nanmean(each[which] ** 2, axis=0)) for each in (plain.rigid, plain.residual)]
        print(f"Whole recording, on {phase}: rigid {mm(errors[0])} mm, data sheet {mm(errors[1])} mm.")


def ahead_cells(by: dict[str, Array]) -> tuple[str, ...]:
    """RMSE of what is published and of the best baselines [mm], skill of both."""
    best = np.array([best_baseline({name: rms[axis] for name, rms in by.items()})[0] for axis in range(3)])
    skills = [", ".join(f"{each:.2f}" for each in skill(by, of)) for of in ("published", "model")]
    return mm(by["published"]), mm(best), *skills


def draw(courses: dict[str, Course], bag: Path, config: Config, target: Path, after: float) -> None:
    """Errors over time, and the deflection of the stance hip over its torque: two branches are hysteresis."""
    figure = Figure((9.5, 6.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.7, 1.0))
    axes = left.subplots(3, 1, sharex=True)
    plain = courses["data sheet"]
    for i, (axis, name) in enumerate(zip(axes, "xyz", strict=True)):
        axis.plot(plain.t, 1e3 * plain.rigid[:, i], color="#5b606b", linewidth=0.8, label="rigid robot")
        for title, colour in (("data sheet", "#d55e00"), ("tuned", "#0072b2"), ("tuned, adapted", "#009e73")):
            axis.plot(plain.t, 1e3 * courses[title].residual[:, i], color=colour, linewidth=1.1, label=title)
        axis.fill_between(plain.t, 0, 1, plain.double, color="#d9dce3", transform=axis.get_xaxis_transform())
        axis.axvline(after, color="#1a1c21", linewidth=0.8, linestyle=":")
        axis.set_ylabel(f"error of {name} [mm]")
        axis.grid(color="#d9dce3", linewidth=0.6)
    axes[0].set_ylim(-3.0, 4.0)
    axes[0].legend(ncols=2, fontsize="small")
    axes[2].set_xlabel("time [s]; grey: both feet bear; dotted: the part that is judged begins")
    for axis, joint in zip(right.subplots(2, 1), ("hip_pitch", "ankle_roll"), strict=True):
        draw_spring(axis, bag, config, joint, after)
    figure.savefig(target, dpi=110, metadata={"Software": None})


def draw_spring(axis: object, bag: Path, config: Config, joint: str, after: float) -> None:
    """Link minus motor over the torque of both legs' joints, means of half a second, in the order of time."""
    recording = read_recording(bag, motor_side(config))
    samples = [s for s in recording.samples if s.motor_q is not None and s.tau is not None]
    for side, colour in (("l", "#0072b2"), ("r", "#d55e00")):
        index = recording.robot.joint_names.index(f"{side}_{joint}")
        values = np.array([[s.tau[index], 1e3 * (s.q[index] - s.motor_q[index])] for s in samples])  # type: ignore[index]
        n = 50 * (len(values) // 50)
        torque, deflection = values[:n].reshape(-1, 50, 2).mean(axis=1).T
        axis.plot(torque, deflection, ".-", color=colour, linewidth=0.6, markersize=3, label=f"{side}_{joint}")  # type: ignore[attr-defined]
    axis.set(xlabel="torque [Nm]", ylabel="link - motor [mrad]")  # type: ignore[attr-defined]
    axis.grid(color="#d9dce3", linewidth=0.6)  # type: ignore[attr-defined]
    axis.legend(fontsize="small")  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
