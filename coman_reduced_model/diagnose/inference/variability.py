# SPDX-License-Identifier: BSD-3-Clause
"""How much robots vary: of one robot by its own recordings, and of a population or one robot over recordings.

Every parameter has a width by name; all parameters of a width (the play of each joint, the zeros of both feet) vary
alike. What a robot shows of them in the median says how much it varies, and one joint that stands out does not change
that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...core.base.nominal import Nominal
from ...core.base.types import Array
from ...core.effects.unknown import Unknown
from .evidence import Evidence, pooled, prior_variance

MEMBERS = 4  # of a width, from which on their median says how much a robot varies
MEDIAN = 0.455  # of the square of a standard normal value
LEAST = 0.4  # of the width of the population, that a robot varies at least
TAILS = 2.0  # degrees of freedom of what no effect explains: in one robot of some it may be far off (an IMU's mounting)
OUTLIER = 2.0  # widths, as which a robot that varies more counts: few whose sensors are off must not blind all others
POPULATION = 1.0  # recordings that the population is worth, for how much one robot varies
ROUNDS, POPULATION_ROUNDS = 4, 15
ANCHOR = 4.0  # robots that the width of the data sheets is worth


def spread(values: Sequence[Array] | Array, mean: Array | float, population: Array | float) -> Array:
    """Variance from recording to recording (the first axis), shrunk towards the population's."""
    squares = np.sum((np.asarray(values) - mean) ** 2, axis=0)
    return np.asarray((squares + POPULATION * population) / (len(values) - 1.0 + POPULATION))


def widths_of(known: Sequence[Unknown]) -> dict[str, list[int]]:
    """Indices of parameters by the name of their spread."""
    out: dict[str, list[int]] = {}
    for i, unknown in enumerate(known):
        if "spread" in unknown.widths:
            out.setdefault(unknown.widths["spread"], []).append(i)
    return out


def squares(evidences: Sequence[Evidence]) -> tuple[Array, Array]:
    """Squared posterior means and variances (P,), of each recording's own parameters in the mean over recordings."""
    known = evidences[0].unknowns
    own = np.array([unknown.own for unknown in known])
    fit = pooled(evidences).fit()
    square, variance = fit.x**2, np.diag(fit.covariance).copy()
    if own.any():
        prior = np.where(own, prior_variance(known), variance + 1e-18)
        fits = [each.posterior(np.where(own, 0.0, fit.x), prior) for each in evidences]
        square[own] = np.mean([each.x**2 for each in fits], axis=0)[own]
        variance[own] = np.mean([np.diag(each.covariance) for each in fits], axis=0)[own]
    return square, variance


def adapted(evidences: Sequence[Evidence], nominal: Nominal) -> list[Unknown]:
    """The parameters with the spreads that this robot shows: less or more than the population, as far as plausible.

    Args:
        evidences: of all recordings, with the spreads of the population.
        nominal: the population.
    """
    known = list(evidences[0].unknowns)
    groups, rare = _alike(known), _heavy_tailed(known, nominal)
    start = np.array([unknown.spread for unknown in known])
    for _ in range(ROUNDS):
        square, variance = squares([replace(each, unknowns=known) for each in evidences])
        for members in groups.values():
            relative = square[members] / MEDIAN + variance[members]
            factor = float(np.sqrt(np.median(relative / start[members] ** 2)))
            for i in members:
                name = known[i].widths["spread"]
                most = nominal.most.get(name, np.inf) / nominal.widths[name]
                known[i] = replace(known[i], spread=float(start[i]) * float(np.clip(factor, LEAST, max(most, 1.0))))
        for members in rare.values():
            total = float(np.sum((square[members] + variance[members]) / start[members] ** 2))
            factor = float(np.sqrt((TAILS + total) / (TAILS + len(members))))
            for i in members:
                known[i] = replace(known[i], spread=float(start[i]) * max(factor, 1.0))
    return known


def _alike(known: Sequence[Unknown]) -> dict[str, list[int]]:
    """Indices of at least MEMBERS parameters that vary alike: of one width, or zeros of foot sensors."""
    groups: dict[str, list[int]] = {}
    for name, members in widths_of(known).items():
        groups.setdefault("zero" if name.startswith("zero_") else name, []).extend(members)
    return {name: members for name, members in groups.items() if len(members) >= MEMBERS}


def _heavy_tailed(known: Sequence[Unknown], nominal: Nominal) -> dict[str, list[int]]:
    """Indices of the few parameters of a width that no effect has, and to which data sheets set no bound."""
    return {
        name: members
        for name, members in widths_of(known).items()
        if len(members) < MEMBERS
        and name not in nominal.most
        and not name.startswith("zero_")
        and not any(known[i].effect for i in members)
    }


def learn_widths(robots: Sequence[Sequence[Evidence]], nominal: Nominal) -> dict[str, float]:
    """Widths of a population by the recordings of its robots, shrunk towards those of `nominal`.

    Expectation maximisation; a robot that varies by more than OUTLIER widths counts as one that varies by OUTLIER.
    """
    widths, anchor = dict(nominal.widths), dict(nominal.widths)
    for _ in range(POPULATION_ROUNDS):
        values: dict[str, list[float]] = {}
        for evidences in robots:
            known = with_widths(evidences[0].unknowns, widths)
            square, variance = squares([replace(each, unknowns=known) for each in evidences])
            for name, members in widths_of(known).items():
                scale = np.array([known[i].relative for i in members])
                mean = float(np.mean((square[members] + variance[members]) / scale**2))
                values.setdefault(name, []).append(min(mean, (OUTLIER * widths[name]) ** 2))
        for name, each in values.items():
            found = (ANCHOR * anchor[name] ** 2 + float(np.sum(each))) / (ANCHOR + len(each))
            widths[name] = min(float(np.sqrt(found)), nominal.most.get(name, np.inf))
    return widths


def with_widths(known: Sequence[Unknown], widths: Mapping[str, float]) -> list[Unknown]:
    """The parameters with other spreads."""
    return [
        replace(unknown, spread=widths[unknown.widths["spread"]] * unknown.relative)
        if "spread" in unknown.widths
        else unknown
        for unknown in known
    ]
