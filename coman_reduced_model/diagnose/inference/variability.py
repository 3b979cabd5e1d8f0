# SPDX-License-Identifier: BSD-3-Clause
"""How much robots vary: of one robot by its own recordings, and of a population or one robot over recordings.

Every parameter has a width by name; all parameters of a width (the play of each joint, the zeros of both feet) vary
alike. What a robot shows of them in the median says how much it varies, and one joint that stands out does not change
that. The foot sensors of a robot, and all else, are as on most robots or precise (evidence.py); which are is learnt
with the widths of both. By how much a controller leaves its plan says nothing of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...core.base.nominal import Nominal
from ...core.base.types import Array
from ...core.effects.unknown import PLAN, Unknown
from .evidence import Evidence, Fit, pooled
from .prior import Kind, kinds_of, prior_variance, spread_of

MEMBERS = 4  # of a width, from which on their median says how much a robot varies
MEDIAN = 0.455  # of the square of a standard normal value
LEAST = 0.4  # of the width of the population, that a robot varies at least
TAILS = 2.0  # degrees of freedom of what no effect explains: in one robot of some it may be far off (an IMU's mounting)
OUTLIER = 2.0  # widths, as which a robot that varies more counts: few whose sensors are off must not blind all others
POPULATION = 1.0  # recordings that the population is worth, for how much one robot varies
ROUNDS, POPULATION_ROUNDS = 4, 8
ANCHOR = 4.0  # robots that the width of the data sheets is worth
PRECISE = 0.3  # of other widths, where those of what is precise begin; of the data sheets', what they shrink to
OF_CONTROLLERS = ("sag.spread", "lead.spread")
HARDLY_SHOWN = ("mass.spread",)  # a width of precise robots would stay near that from which it begins


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
    return _squares(evidences, pooled(evidences).fit())


def _squares(evidences: Sequence[Evidence], fit: Fit) -> tuple[Array, Array]:
    own = np.array([unknown.own for unknown in evidences[0].unknowns])
    fits = with_own(evidences, fit)
    square = np.where(own, np.mean([each.x**2 for each in fits], axis=0), fit.x**2)
    variances = [np.diag(each.covariance) for each in (*fits, fit)]
    return square, np.where(own, np.mean(variances[:-1], axis=0), variances[-1])


def with_own(evidences: Sequence[Evidence], fit: Fit) -> list[Fit]:
    """Of each recording, its own parameters, with all others as a fit of what recordings share has them."""
    known = evidences[0].unknowns
    own = np.array([unknown.own for unknown in known])
    prior = np.where(own, prior_variance(known, precise=fit.precise), np.diag(fit.covariance) + 1e-18)
    return [each.posterior(np.where(own, 0.0, fit.x), prior) for each in evidences]


def adapted(evidences: Sequence[Evidence], nominal: Nominal) -> list[Unknown]:
    """The parameters with the spreads that this robot shows: less or more than the population, as far as plausible.

    Args:
        evidences: of all recordings, with the spreads of the population.
        nominal: the population.
    """
    population = evidences[0].unknowns
    every = kinds_of(population)
    kinds = [
        _adapted(evidences, with_kind(population, k), nominal, bool(k)) for k in dict.fromkeys((every[0], every[-1]))
    ]
    return [
        replace(each, precise=None if one.precise is None else precise.spread)
        for one, each, precise in zip(population, kinds[0], kinds[-1], strict=True)
    ]


def with_kind(known: Sequence[Unknown], precise: Kind) -> list[Unknown]:
    """The parameters of one kind of robots, with its spreads."""
    return [replace(each, spread=spread_of(each, precise), precise=None) for each in known]


def _adapted(evidences: Sequence[Evidence], known: list[Unknown], nominal: Nominal, precise: bool) -> list[Unknown]:
    """`adapted` for robots of one kind; precise ones vary by less, not by more."""
    groups, rare = _alike(known), _heavy_tailed(known, nominal)
    start = np.array([unknown.spread for unknown in known])
    for _ in range(ROUNDS):
        square, variance = squares([replace(each, unknowns=known) for each in evidences])
        for members in groups.values():
            relative = square[members] / MEDIAN + variance[members]
            factor = float(np.sqrt(np.median(relative / start[members] ** 2)))
            for i in members:
                name = known[i].widths["spread"]
                most = 1.0 if precise else nominal.most.get(name, np.inf) / nominal.widths[name]
                known[i] = replace(known[i], spread=float(start[i]) * float(np.clip(factor, LEAST, max(most, 1.0))))
        for members in () if precise else rare.values():
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


def learn_widths(robots: Sequence[Sequence[Evidence]], nominal: Nominal) -> Nominal:
    """The same record with the widths of a population, and of what is precise, by the recordings of its robots.

    Both are shrunk towards those of `nominal`. Expectation maximisation; a robot that varies by more than OUTLIER
    widths counts as one that varies by OUTLIER. Widths of what is precise begin at a share of those of all robots.
    """
    part_of = {name: part for robot in robots for name, part in _parts_of(robot[0].unknowns).items()}
    anchors = dict(nominal.widths), {name: PRECISE * nominal.widths[name] for name in part_of}
    learnt = nominal
    for _ in range(POPULATION_ROUNDS):
        learnt = _improved(robots, learnt, anchors, {})
    learnt = replace(learnt, precise={name: PRECISE * learnt.widths[name] for name in part_of})
    for _ in range(POPULATION_ROUNDS):
        learnt = _improved(robots, learnt, anchors, part_of)
    return learnt


def _improved(
    robots: Sequence[Sequence[Evidence]],
    known: Nominal,
    anchors: Sequence[Mapping[str, float]],
    part_of: Mapping[str, str],
) -> Nominal:
    """One round: the mean square of each parameter, by how probable it is that its part of a robot is precise."""
    values: tuple[dict[str, list[tuple[float, float]]], ...] = {}, {}
    for evidences in robots:
        for kind, (share, found) in of_kinds(evidences, known).items():
            for name, square in found.items():
                precise = part_of.get(name) in kind
                width = (known.precise if precise else known.widths)[name]
                values[precise].setdefault(name, []).append((share, min(square, (OUTLIER * width) ** 2)))
    out = dict(known.widths), dict(known.precise)
    for each, widths, anchor in zip(values, out, anchors, strict=True):
        for name, pairs in each.items():
            share, square = np.array(pairs).T
            mean = (ANCHOR * anchor[name] ** 2 + float(share @ square)) / (ANCHOR + float(share.sum()))
            widths[name] = min(float(np.sqrt(mean)), known.most.get(name, np.inf))
    out[1].update({name: min(width, out[0][name]) for name, width in out[1].items()})
    return replace(known, widths=out[0], precise=out[1])


def means_of(robots: Sequence[Sequence[Evidence]], nominal: Nominal) -> dict[str, float]:
    """By width, the mean over robots of the parameters that robots have some of anyway (`usual`), beyond it.

    Shrunk towards none as widths are.
    """
    values: dict[str, list[float]] = {}
    for evidences in robots:
        known = with_both(evidences[0].unknowns, nominal)
        several = [replace(each, unknowns=known) for each in evidences]
        fit = pooled(several).fit()
        own = np.mean([each.x for each in with_own(several, fit)], axis=0)
        for unknown, value in zip(known, np.where([each.own for each in known], own, fit.x), strict=True):
            if "usual" in unknown.widths:
                values.setdefault(unknown.widths["usual"], []).append(float(value) / unknown.relative)
    return {name: sum(each) / (ANCHOR + len(each)) for name, each in values.items()}


def _parts_of(known: Sequence[Unknown]) -> dict[str, str]:
    """By width, the part of the robot whose parameters have it; none for what is of a recording or of a controller.

    Nor for what recordings hardly show: that is as on any robot.
    """
    return {
        name: known[members[0]].part
        for name, members in widths_of(known).items()
        if not any(known[i].own or known[i].where == PLAN for i in members)
        and name not in (*OF_CONTROLLERS, *HARDLY_SHOWN)
    }


def of_kinds(evidences: Sequence[Evidence], nominal: Nominal) -> dict[Kind, tuple[float, dict[str, float]]]:
    """By kind of robot: how probable it is by its recordings, and by width, the mean square of its parameters."""
    known = with_both(evidences[0].unknowns, nominal)
    logs, out = [], []
    for kind in kinds_of(known):
        of_kind = with_kind(known, kind)
        several = [replace(each, unknowns=of_kind) for each in evidences]
        fit = pooled(several).fit()
        square, variance = _squares(several, fit)
        found = {}
        for name, members in widths_of(known).items():
            scale = np.array([known[i].relative for i in members])
            found[name] = float(np.mean((square[members] + variance[members]) / scale**2))
        logs.append(fit.log)
        out.append(found)
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs)).tolist()
    return dict(zip(kinds_of(known), zip(shares, out, strict=True), strict=True))


def widths_of_robot(evidences: Sequence[Evidence], nominal: Nominal) -> tuple[Kind, dict[str, float]]:
    """The most probable kind of a robot, and the widths of that kind."""
    found, parts = of_kinds(evidences, nominal), _parts_of(evidences[0].unknowns)
    kind = max(found, key=lambda each: found[each][0])
    return kind, {
        name: nominal.precise[name] if parts.get(name) in kind and name in nominal.precise else width
        for name, width in nominal.widths.items()
    }


def with_both(known: Sequence[Unknown], nominal: Nominal) -> list[Unknown]:
    """The parameters with the spreads of `nominal`, on most robots and precise."""
    out = []
    for each in with_widths(known, nominal.widths):
        precise = nominal.precise.get(each.widths.get("spread", ""))
        out.append(each if precise is None else replace(each, precise=precise * each.relative))
    return out


def with_widths(known: Sequence[Unknown], widths: Mapping[str, float]) -> list[Unknown]:
    """The parameters with other spreads, of one kind of robots."""
    return [
        replace(unknown, spread=widths[unknown.widths["spread"]] * unknown.relative, precise=None)
        if "spread" in unknown.widths
        else unknown
        for unknown in known
    ]
