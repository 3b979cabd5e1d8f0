# SPDX-License-Identifier: BSD-3-Clause
"""`coman baseline`: what is usual for one robot, by recordings of it when nothing was wrong.

The record of the population is the prior; what the recordings say of each parameter, and how much it varies from one
to the next, replaces it. Of what has a limit (`most` in nominal.yaml: masses, stiffness, gains, zeros of encoders and
torques), what is beyond it stays out, and is reported: a baseline must not hide that a robot weighs more than its URDF.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.base.nominal import Nominal, load_nominal
from ..core.base.types import Array
from ..core.config.schema import Config
from ..core.effects.unknown import Unknown
from ..errors import BagError, ComanError, ConfigError
from ..progress import Progress, between
from ..topics import TopicNames
from .data.reading import read_bags, refuse_repeated
from .inference.case import Case, examine, repeats_of, with_known
from .inference.check import check_recordings
from .inference.compare import pulls
from .inference.effects import with_structure
from .inference.evidence import pooled
from .inference.explanation import by_law
from .inference.finding import leftover
from .inference.prior import prior_variance
from .inference.variability import POPULATION, adapted, spread, with_own
from .inference.weight import Weight, weight
from .monitor_rows import rows_of_robot, watch
from .physics.hypotheses import unknowns

LEAST_BAGS = 2
PLAUSIBLE = 2.0  # standard deviations of the population, by which a parameter is taken over at most
PULLED = 2.0  # the same, from which on it is reported
OF_FLOOR = ("ground_slope", "external_force")  # in axes of a recording's first sole: the next may begin otherwise
SCATTER = 0.5  # of the population's scatter of what laws leave, that a robot has at least
READ, EXAMINED = 0.5, 0.4  # of the work


@dataclass(frozen=True)
class Baseline:
    """What is usual for one robot.

    Attributes:
        nominal: to be written to a file.
        bags: number of recordings.
        weight: of the robot by its recordings, whatever becomes usual.
        pulled: by kind of parameter, how far it is from what the description of the robot says [standard deviations].
        not_monitored: why the monitor learnt nothing; empty: it did.
        not_checked: what these recordings cannot show, and what looks wrong in them.
    """

    nominal: Nominal
    bags: int
    weight: Weight
    pulled: Mapping[str, float]
    not_monitored: str = ""
    not_checked: tuple[str, ...] = ()


def baseline(
    bags: Sequence[str | Path],
    config: Config,
    *,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    population: Nominal | None = None,
    progress: Progress | None = None,
) -> Baseline:
    """Learn what is usual for a robot.

    Args:
        bags: recordings of one robot when nothing was wrong, two or more.
        config: nominal robot and model.
        urdf, names: the robot, if not as configured or recorded; the topics.
        population: of robots, which the recordings change; default: the shipped one.
        progress: called with the fraction done and the current work.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used, or there are too few bags.
    """
    if len(bags) < LEAST_BAGS:
        raise BagError(f"{len(bags)} recording: at least {LEAST_BAGS} are needed to see what varies between them")
    refuse_repeated(bags)
    if (source := config.streams.wrench_source) != "sensors":
        raise ConfigError(
            f"streams.wrench_source: {source}: a baseline needs measured foot wrenches (allowed: sensors)"
        )
    report = progress or (lambda fraction, what: None)
    given, config, population = config, with_structure(config), population or load_nominal()
    readings = read_bags(bags, config, urdf, names, between(report, 0.0, READ))
    checked = check_recordings(readings, len(bags), config, [], whole=True, nominal=population)
    known = unknowns(checked.train[0][0], checked.train[0][1], population)
    nothing = np.zeros(len(known))
    cases = []
    for i, each in enumerate(checked.train):
        report(READ + EXAMINED * i / len(bags), f"learning from {each[0].name}")
        cases.append(examine(each, known, nothing, nominal=population))
    report(READ + EXAMINED, "watching the walks again, as the monitor does")
    learnt = replace(of_cases(cases, population), not_checked=tuple(checked.not_checked))
    return _with_monitor(learnt, bags, given, urdf, names)


def _with_monitor(
    learnt: Baseline, bags: Sequence[str | Path], config: Config, urdf: str | Path | None, names: TopicNames | None
) -> Baseline:
    """The same with rows for the monitor, as far as it can follow these recordings."""
    try:
        rows = rows_of_robot([watch(bag, config, urdf, names) for bag in bags], learnt.nominal.monitor)
    except ComanError as error:
        return replace(learnt, not_monitored=str(error))
    nothing = "" if set(rows) - set(learnt.nominal.monitor) else "no two recordings show a channel in a few strides"
    return replace(learnt, nominal=replace(learnt.nominal, monitor=rows), not_monitored=nothing)


def of_cases(cases: Sequence[Case], population: Nominal) -> Baseline:
    """The baseline of examined recordings of one robot, linear about nominal."""
    weighs = weight(cases)
    known = adapted([case.evidence for case in cases], population)
    cases = [with_known(case, known) for case in cases]
    evidences = [case.evidence for case in cases]
    fit = pooled(evidences).fit()
    own = np.array([unknown.own for unknown in known])
    prior = prior_variance(known, precise=fit.precise)
    each = with_own(evidences, fit)
    alone = [evidence.fit_of_kind(precise=fit.precise) for evidence in evidences]
    mean = np.where(own, np.mean([one.x for one in each], axis=0), fit.x)
    variance = np.where(own, np.mean([np.diag(one.covariance) for one in each], axis=0), np.diag(fit.covariance))
    between_bags = np.where(
        own,
        spread([one.x for one in each], mean, prior),
        np.maximum(np.var([one.x for one in alone], axis=0, ddof=1) - _mean_variance(alone), 0.0),
    )
    parameters = {}
    for i, unknown in enumerate(known):
        if "spread" in unknown.widths:
            usual = _plausible(float(mean[i]), unknown, population)
            own_spread = min(float(np.sqrt(variance[i] + between_bags[i])), float(np.sqrt(prior[i])))
            if unknown.effect in OF_FLOOR:
                usual, own_spread = 0.0, float(np.sqrt(prior[i]))
            parameters[unknown.name] = unknown.usual + usual, own_spread
    left = [leftover([case], fit, []) for case in cases]
    pulled = {name.removesuffix(".spread"): value for name, value in pulls(known, fit, []).items() if value > PULLED}
    robot = cases[0].state.world.robot
    source = {"recordings": len(cases), "robot": robot.config.name, "mass_kg": robot.mass}
    learnt = replace(
        population, source=source, precise={}, sheets={}, with_baseline={},
        parameters=parameters, leftover=_leftover(left, population),
        repeats=_repeats(repeats_of(cases), len(cases), population), **population.with_baseline,
    )  # fmt: skip
    return Baseline(learnt, len(cases), weighs, pulled)


def _mean_variance(fits: Sequence[object]) -> Array:
    return np.asarray(np.mean([np.diag(fit.covariance) for fit in fits], axis=0))  # type: ignore[attr-defined]


def _plausible(value: float, unknown: Unknown, population: Nominal) -> float:
    """A deviation, no larger than is plausible where data sheets set a bound."""
    name = unknown.widths["spread"]
    if name not in population.most:
        return value
    most = PLAUSIBLE * population.most[name] * unknown.relative
    return float(np.clip(value, -most, most))


def _repeats(own: Mapping[str, float], count: int, population: Nominal) -> dict[str, float]:
    """By law, what this robot leaves that repeats with each stride, by `count` recordings; shrunk likewise.

    Of laws that its recordings lack, what the population leaves.
    """
    usual = population.repeats
    return dict(usual) | {
        law: float(np.sqrt((count * value**2 + POPULATION * usual.get(law, value) ** 2) / (count + POPULATION)))
        for law, value in own.items()
    }


def _leftover(each: Sequence[Mapping[str, float]], population: Nominal) -> dict[str, tuple[float, float]]:
    """By law, what it leaves on this robot; its scatter is shrunk towards the population's."""
    out = dict(population.leftover)
    values: dict[str, list[float]] = {}
    for groups in each:
        for law, value in by_law(groups).items():
            values.setdefault(law, []).append(float(np.log(max(value, 1e-3))))
    for law, logs in values.items():
        if law in population.leftover:
            _, scatter = population.leftover[law]
            own = float(np.sqrt(spread(np.array(logs), float(np.mean(logs)), scatter**2)))
            out[law] = float(np.exp(np.mean(logs))), max(own, SCATTER * scatter)
    return out
