# SPDX-License-Identifier: BSD-3-Clause
"""The report on what `coman predict` wrote: `report.html` and `plots/*.png` beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.base.limits import DIVERGED, TOPPLED
from ..core.base.types import Foot
from ..core.config.schema import OPTIONS, config_from_flat
from ..core.evaluation.run import Run
from ..core.evaluation.statistics import AXES
from ..errors import BagError, OutputError
from ..progress import Progress
from ..schemas import read_result
from . import figures
from .ahead import ahead_section
from .configuration import configuration_section
from .draw import PHASE_NAMES
from .estimate import estimate_section
from .page import Notice, Part, Section, Table, Text, page, picture
from .run import load_run
from .verdict import millimetres, percent, sentence

REPORT_FILE, PLOTS_FOLDER = "report.html", "plots"
_SUMMARY_FILE, _PREDICTIONS_BAG = "summary.json", "predictions"
_FLAGS = {
    "NO_REFERENCE": "no reference of the configured source: neither reference nor prediction",
    "STALE_WRENCH": "a foot wrench is missing or too old: the phase is held",
    "NOT_INITIALISED": "the free run has not started",
    "NO_SUPPORT": "in the air, or the phase is not known yet",
    "NEAR_SINGULAR": "the support leg is close to a singular posture: its stiffness was limited",
    "RESET": "the free run was initialised from the measurement",
    "UNKNOWN_GROUND": "neither IMU nor plan knows the slope, and forces show one or are computed; or a foot is aslant",
    "COMPUTED_WRENCH": "the foot wrenches are computed (streams.wrench_source), not measured",
    "SIMPLER_AHEAD": "ahead, simpler predictions were better than the model on some axis, and (partly) published",
    "INCONSISTENT": "the innovations of the estimate are far larger than its covariance says",
    "REJECTED_STATE": "the free run diverged and was restarted, or a prediction ahead was beyond physics",
}


def write_report(directory: str | Path, progress: Progress | None = None) -> Path:
    """Make the page and its plots from an output folder of `coman predict`, replacing those of an earlier call.

    Returns:
        The path of the page.

    Raises:
        BagError: the folder holds no results, or they cannot be read.
        OutputError: the page cannot be written.
    """
    directory = Path(directory)
    report = progress or (lambda fraction, text: None)
    summary = read_summary(directory)
    bag = directory / _PREDICTIONS_BAG
    if not bag.exists():
        raise BagError(f"{directory}: has {_SUMMARY_FILE} but no {_PREDICTIONS_BAG}/: run coman predict again")
    run = load_run(bag, lambda fraction, text: report(0.3 * fraction, text))
    plots, target = directory / PLOTS_FOLDER, directory / REPORT_FILE
    temporary = target.with_suffix(".html.part")
    try:
        plots.mkdir(exist_ok=True)
        html = prediction_page(summary, run, plots, lambda fraction, text: report(0.3 + 0.7 * fraction, text))
        temporary.write_text(html, encoding="utf-8")
        temporary.replace(target)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written: {error.strerror or error}") from None
    report(1.0, str(target))
    return target


def read_summary(directory: Path) -> dict[str, Any]:
    """`summary.json` of an output folder.

    Raises:
        BagError: there is none, or it is not what `coman predict` writes.
    """
    path = directory / _SUMMARY_FILE
    try:
        inside = path.exists()
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not directory.is_dir():
        raise BagError(f"{directory}: no such folder")
    if not inside:
        raise BagError(f"{directory}: no {_SUMMARY_FILE} in it: not a folder that coman predict wrote")
    summary = read_result(path)
    if "samples" not in summary or not isinstance(summary.get("rmse_m"), dict):
        raise BagError(f"{path}: not a summary of coman predict: no 'samples' or 'rmse_m' in it")
    return summary


def prediction_page(
    summary: Mapping[str, Any], run: Run, plots: Path | None = None, progress: Progress | None = None
) -> str:
    """The HTML of the report; PNG files into the folder `plots` if one is given.

    Figures show what is possible for the robot; the page says what is left out.
    """
    report = progress or (lambda fraction, text: None)
    shown = run.possible()
    left_out = _left_out(summary, run, shown)
    robot = (summary.get("robot") or {}).get("name") or "robot"
    recording = Path(summary.get("bag") or "?").name
    sections: list[Section] = []
    parts = (
        _walk,
        _errors,
        _deflection,
        ahead_section,
        estimate_section,
        _left,
        _support,
        _inputs,
        configuration_section,
    )
    for number, make in enumerate(parts):
        report(number / len(parts), f"after {sections[-1].title}" if sections else "drawing")
        sections.append(make(summary, shown, plots))
    warnings = [Notice(text, "warn") for text in summary.get("warnings") or []]
    sections[0] = replace(sections[0], parts=[*left_out, *warnings, *sections[0].parts])
    title = f"COM of {robot}, predicted and measured: {recording}"
    return page(title, sentence(summary), sections, _facts(summary))


def _left_out(summary: Mapping[str, Any], run: Run, shown: Run) -> list[Part]:
    """What is beyond physics, and so neither drawn nor judged."""
    parts: list[Part] = []
    diverged, limit = int(run.diverged.sum()), f"{DIVERGED:g} m"
    if diverged:
        parts.append(
            Notice(
                f"In {diverged} samples ({percent(diverged / len(run))}) the free run diverged: it came more than "
                f"{limit} or {TOPPLED:g} rad from the measured robot, which is beyond physics. It was "
                "restarted from the measurement. Neither the errors nor the figures hold these samples.",
                "warn",
            )
        )
    far = {
        name: int(np.isnan(after[~run.diverged]).any(axis=1).sum() - np.isnan(before[~run.diverged]).any(axis=1).sum())
        for name, before, after in (
            ("predicted", run.predicted, shown.predicted),
            ("reference", run.reference, shown.reference),
        )
    }
    for name, count in far.items():
        if count:
            parts.append(
                Notice(
                    f"In {count} samples ({percent(count / len(run))}) the {name} COM is more than {limit} from the "
                    "measured one, which is beyond physics: the figures leave it out.",
                    "warn",
                )
            )
    ahead = ((summary.get("flags") or {}).get("REJECTED_STATE") or 0) - diverged
    if ahead > 0:
        parts.append(
            Notice(
                f"In {ahead} samples ({percent(ahead / len(run))}) a prediction ahead was beyond physics: its errors "
                "do not hold it.",
                "warn",
            )
        )
    return parts


def _facts(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    config, robot = summary.get("config") or {}, summary.get("robot") or {}
    facts: list[tuple[str, str]] = []
    if robot.get("name"):
        facts.append(
            ("robot", f"{robot['name']}, {robot['mass_kg']:.1f} kg" if robot.get("mass_kg") else robot["name"])
        )
    if summary.get("duration_s") is not None:
        facts.append(("length", f"{summary['duration_s']:.1f} s, {summary['samples']} samples"))
    if config:
        settings = config_from_flat(config, "summary.json")
        facts.append(("reference", str(config.get("prediction.reference", "?"))))
        choice = f"stiffness {config.get('model.stiffness')}, double support {config.get('model.double_support')}"
        options = [option for option in OPTIONS if settings.uses(option)]
        kind = [] if settings.turning else [choice]
        facts.append(("model", ", ".join([*kind, *options, *settings.active])))
    if summary.get("realtime_factor"):
        facts.append(("speed", f"{summary['realtime_factor']:.2g} x real time"))
    return facts


def _errors(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    rows = [("all", summary, summary.get("judged_samples"))]
    names = {phase.name: name for phase, name in PHASE_NAMES.items()}
    for phase, by in (summary.get("by_phase") or {}).items():
        rows.append((names.get(phase, phase), by, by.get("samples")))
    head = ["phase", "samples", *["predicted", "rigid"] * len(AXES)]
    cells = [
        [name, str(count or 0)]
        + [
            millimetres((by.get(kind) or {}).get(axis)).removesuffix(" mm")
            for axis in AXES
            for kind in ("rmse_m", "rmse_rigid_m")
        ]
        for name, by, count in rows
    ]
    parts: list[Part] = [
        Table(
            head,
            cells,
            "RMS of measured minus predicted COM, in the axes of the support sole. Predicted: the free run, started "
            "from the measurement; until the next restart its inputs are plan or motors, support phase and switching "
            "times. Rigid: as if the COM were its reference. A dash: not known.",
            strong=(0,),
            groups=[("", 2), *((f"{figures.DIRECTIONS[axis]} [mm]", 2) for axis in AXES)],
        )
    ]
    config = summary.get("config") or {}
    sideways = config_from_flat(config, "summary.json").uses("lateral_compliance")
    if config and not sideways and config.get("prediction.reference") != "none":
        parts.append(
            Text("y is not modelled here: sideways, the predicted COM is the reference (model.lateral_compliance).")
        )
    return Section("Errors", parts, "errors")


def _walk(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    found = run.consecutive_steps()
    when = f"from {run.time[found[0]]:.1f} to {run.time[found[1] - 1]:.1f} s" if found else ""
    parts = [
        picture(
            "three_steps",
            lambda: figures.three_steps(run),
            f"COM over three consecutive steps {when}: measured, predicted and reference, forward and up.",
            f"Three steps in the middle of the recording, {when} (chosen by place, not by fit). Left in the odometry "
            "frame, right as the difference from the reference, where a rigid robot is the line at zero. A dot marks "
            "where the prediction starts from the measurement.",
            plots,
        ),
        picture(
            "com",
            lambda: figures.com_over_time(run),
            "COM forward, left and up over the whole recording: measured, predicted and reference.",
            "The COM in the odometry frame, which starts at the first support sole.",
            plots,
        ),
        picture(
            "top_view",
            lambda: figures.top_view(run, _soles(summary)),
            "Path of the COM seen from above, with the soles of both feet.",
            "From above, as wide as the measured COM and the soles: the COM, and the soles where they carried (green "
            "left, yellow right).",
            plots,
        ),
    ]
    return Section("COM", parts, "com")


def _soles(summary: Mapping[str, Any]) -> dict[Foot, Sequence[float]]:
    """Edges of the soles [m]; of a demo or an earlier version by length and width of the configuration."""
    config, known = summary.get("config") or {}, (summary.get("robot") or {}).get("soles_m") or {}
    x, y = 0.5 * config.get("robot.foot_length", 0.2), 0.5 * config.get("robot.foot_width", 0.1)
    return {foot: known.get(foot.name.lower(), (-x, x, -y, y)) for foot in (Foot.LEFT, Foot.RIGHT)}


def _deflection(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    made = picture(
        "deflection",
        lambda: figures.deflection(run),
        "Difference of measured and predicted COM from the reference, forward, left and up, over the recording. "
        + sentence(summary),
        "What the springs do: the COM against its reference, in the support sole. A perfect model lies on the measured "
        "line, a rigid robot is the line at zero. Lines are broken where the support sole changes, a "
        "dot marks where the prediction starts from the measurement.",
        plots,
    )
    return Section("Deflection from the reference", [made], "deflection")


def _left(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    cycle = picture(
        "by_cycle",
        lambda: figures.by_cycle(run),
        "Errors of this model and of the rigid robot over the course of a step, per axis and support foot.",
        "All steps laid on each other, from touchdown (0 %) to the next touchdown: median, and the band that holds "
        "80 % of them. A narrow band away from zero is physics that the model lacks; a wide one is noise, or changes "
        "from step to step. Where left and right differ, look for the cause on one side.",
        plots,
    )
    spectrum = picture(
        "spectrum",
        lambda: figures.spectrum(run),
        "Amplitude spectral density of the errors of this model and of the rigid robot, per axis.",
        "Where in frequency the errors are. Peaks at the step rate and its multiples belong to the gait; others are "
        "resonances or noise.",
        plots,
    )
    return Section("What is left unexplained", [cycle, spectrum], "left")


def _support(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    seconds = summary.get("phases_s") or {}
    names = {phase.name: name for phase, name in PHASE_NAMES.items()}
    seconds_text = ", ".join(f"{names.get(phase, phase)} {value:.1f} s" for phase, value in seconds.items() if value)
    made = picture(
        "load",
        lambda: figures.load_share(run),
        f"Share of the vertical force on the left foot over time, with the support phases: {seconds_text}.",
        f"Vertical load and the phases found from it: {seconds_text}. {len(run.steps())} complete steps.",
        plots,
    )
    return Section("Support", [made], "support")


def _inputs(summary: Mapping[str, Any], run: Run, plots: Path | None) -> Section:
    parts: list[Part] = []
    streams = summary.get("streams") or {}
    if streams:
        rows = [
            [
                name,
                str(s.get("received", "–")),
                str(s.get("accepted", "–")),
                str(s.get("late", "–")),
                _rate(s.get("rate_hz")),
                str(s.get("incomplete", 0)),
            ]
            for name, s in streams.items()
            if s.get("received") or s.get("expected")
        ]
        parts.append(Table(["stream", "messages", "accepted", "late", "rate [Hz]", "samples without it"], rows))
    elif summary.get("incomplete"):
        rows = [[name, str(count)] for name, count in summary["incomplete"].items()]
        parts.append(Table(["stream", "samples without it"], rows, "Samples that went without a value of a stream."))
    rejected, last = summary.get("rejected") or {}, summary.get("last_rejection") or {}
    if any(rejected.values()):
        rows = [[name, last.get(name, ""), str(count)] for name, count in rejected.items() if count]
        parts.append(Table(["rejected: stream/reason", "the last one", "messages"], rows, words=2))
    else:
        parts.append(Text("No message was rejected."))
    flags, samples = summary.get("flags") or {}, max(summary.get("samples") or 0, 1)
    if flags:
        rows = [[_FLAGS.get(name, name), str(n), percent(n / samples)] for name, n in flags.items()]
        parts.append(Table(["state of the prediction", "samples", "share"], rows))
    notes = []
    if summary.get("restarts"):
        notes.append(
            f"The joint states broke off or went back {summary['restarts']} times; the prediction started again."
        )
    if summary.get("unlisted_joints"):
        notes.append(f"Held at zero, for no message names them: {', '.join(summary['unlisted_joints'])}.")
    if summary.get("extra_joints"):
        notes.append(f"Ignored, for the robot description lacks them: {', '.join(summary['extra_joints'])}.")
    return Section("Inputs", [*parts, *map(Text, notes)], "inputs")


def _rate(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.1f}"
