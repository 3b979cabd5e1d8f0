# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of explanations, by weights that were learnt from robots whose faults are known.

The score of an explanation is linear in its features, that of `unknown` is constant, and probabilities are

    p_k = exp(s_k) / sum over none, unknown and the rivals

The weights are data (`decision` in config/nominal.yaml), learnt by judge/learn.py. So is `alarm`, the probability of
`none`, before anything was chosen, up to which something is said to be missing at all: about one nominal robot in a
hundred gets there. Where none was learnt, it is NO_ALARM. So is `together`: an alarm as well is what pulls all that
varies on nominal robots further than it is on them (`pulled_together`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...core.base.nominal import Nominal
from ...core.effects.catalogue import CATALOGUE
from .explanation import UNKNOWN, Explanation, Odds

NO_ALARM = 0.5  # in its place, where none was learnt
ALIKE = 3.0  # nats within which explanations cannot be distinguished
EFFECT = ("one", "evidence", "ways")  # weights of an effect; its bias first
ALL = ("leftover", "apart", "pulled")  # weights of every explanation of the catalogue, and of `none`


def score(features: Mapping[str, float], weights: Mapping[str, float], effect: bool) -> float:
    """Of one explanation."""
    s = -sum(weights.get(name, 0.0) * features[name] for name in ALL)  # a file of an earlier version lacks some
    if effect:
        s += sum(weights[name] * features.get(name, 1.0) for name in EFFECT)
    return float(s)


def odds(explanations: Sequence[Explanation], nominal: Nominal) -> Odds:
    """Of nothing more (the first explanation) and its rivals."""
    nothing, *rivals = explanations
    weights = _weights(nothing, nominal)
    scores = [score(nothing.features(nominal), weights, False), weights[UNKNOWN]]
    scores += [score(rival.features(nominal), _weights(rival, nominal), True) for rival in rivals]
    none, unknown, *effects = probabilities(scores)
    group = group_of(rivals, effects)
    alarm, pulled = weights.get("alarm", NO_ALARM), nothing.together > weights.get("together", np.inf)
    return Odds(none, unknown, tuple(effects), group, alarm, kin_of(rivals, group), bool(pulled))


def nats_for_alarm(nominal: Nominal, ways: int, selected: bool) -> float:
    """Evidence [nats] of one effect that raises an alarm, if it leaves and pulls no more than is usual.

    Args:
        ways: number of places at which it could be.
        selected: in selecting recordings it has as much again.
    """
    weights = nominal.decision["selected" if selected else "alone"]
    odds_of_it = 1.0 / weights.get("alarm", NO_ALARM) - 1.0 - np.exp(weights[UNKNOWN])
    wanted = float(np.log(max(odds_of_it, 1e-9))) - weights["one"] + weights["ways"] * float(np.log(ways))
    return 2.0 * float(np.sinh(max(wanted, 0.0) / max(weights["evidence"], 1e-9)))


def probabilities(scores: Sequence[float]) -> list[float]:
    """By score, p = exp(s) / sum."""
    p = np.exp(np.array(scores) - max(scores))
    return [float(each) for each in p / p.sum()]


def _weights(explanation: Explanation, nominal: Nominal) -> Mapping[str, float]:
    """With selecting recordings that could show the effect, or without."""
    return nominal.decision["alone" if np.isnan(explanation.confirmed) else "selected"]


def kin_of(rivals: Sequence[Explanation], group: Sequence[int]) -> tuple[int, ...]:
    """Rivals of the class of a group's first one, at its place: the weights were learnt for classes."""
    best = rivals[group[0]].option if group else None
    ambiguity = CATALOGUE[best.effect].ambiguity if best else None
    if best is None or ambiguity is None:
        return ()
    return tuple(
        k
        for k, rival in enumerate(rivals)
        if rival.option and rival.option.place == best.place and CATALOGUE[rival.option.effect].ambiguity == ambiguity
    )


def group_of(rivals: Sequence[Explanation], effects: Sequence[float]) -> tuple[int, ...]:
    """The most probable rival, and those whose evidence is within ALIKE of its, both ways.

    By selecting recordings too, if they show both.
    """
    if not rivals:
        return ()
    order = sorted(range(len(rivals)), key=lambda k: -effects[k])
    best = rivals[order[0]]

    def apart(one: Explanation) -> float:
        return float(np.nansum([best.gain - one.gain, best.confirmed - one.confirmed]))

    return tuple(k for k in order if abs(apart(rivals[k])) < ALIKE)
