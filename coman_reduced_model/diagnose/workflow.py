# SPDX-License-Identifier: BSD-3-Clause
"""`coman diagnose` in five steps: read, check, search, predict, result."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ..core.base.nominal import load_nominal, of_another_robot
from ..core.config.schema import Config
from ..progress import Progress, between
from ..topics import TopicNames
from .data.reading import read_bags, refuse_repeated
from .inference.check import check_recordings, parse_assumed
from .inference.effects import with_structure
from .inference.predicted_com import free_runs_here, free_runs_in_helper
from .inference.prediction import predict_com
from .inference.verdict import find_effects
from .report.contents import build_diagnosis
from .result import Diagnosis

READ, SEARCHED = 0.15, 0.8  # fractions of the work that are done after reading and after the search


def diagnose(
    train: Sequence[str | Path],
    hold: Sequence[str | Path],
    config: Config,
    *,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    assume: Sequence[str] = (),
    baseline: str | Path = "",
    second_process: bool = True,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find the missing effects.

    A held-out bag that hardly stands steadily is left out, which `not_checked` of the result mentions.

    Args:
        train: bags that the values are fitted to.
        hold: other bags: the last one confirms and is opened once, at the end; those before it help to choose.
        config: nominal robot and model.
        urdf, names: the robot, if not as configured or recorded; the topics.
        baseline: file of nominal variability (`coman baseline`); default: the shipped population.
        second_process: whether to predict in another process beside this one, which halves the time of the last step.
        assume: effects (`NAME` or `NAME:where=PLACE`) whose parameters are fitted instead of a search.
        progress: called with the fraction done and the current work.
        notice: called before the search, with each stream whose clock is apart: what is found then hangs on it.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used.
    """
    began = time.perf_counter()
    nominal = load_nominal(baseline)
    report = progress or (lambda fraction, what: None)
    given, config = config, config.replaced({"prediction.adapt": False})  # what it would learn is to be found
    config, assumed, paths = with_structure(config), [parse_assumed(text) for text in assume], [*train, *hold]
    refuse_repeated(paths)
    free_runs_of = free_runs_in_helper if second_process else free_runs_here
    with free_runs_of(urdf, names) as free_runs:
        free_runs.start(paths, config)  # the nominal prediction, in another process

        readings = read_bags(paths, config, urdf, names, between(report, 0.0, READ))
        checked = check_recordings(readings, len(train), config, assumed, nominal=nominal)
        for line in checked.clocks_apart:
            if notice:
                notice(line)
        robot = checked.train[0][1].robot
        checked.not_checked.extend(of_another_robot(nominal, robot.mass))
        found = find_effects(checked, assumed, nominal, between(report, READ, SEARCHED))
        report(SEARCHED, "predicting the COM")
        predicted = predict_com(found.finding, checked, config, free_runs)
    diagnosis = build_diagnosis(checked, found, predicted, config, began)
    diagnosis.model = diagnosis.model.replaced({"prediction.adapt": given.prediction.adapt}).with_urdf(urdf)
    return diagnosis
