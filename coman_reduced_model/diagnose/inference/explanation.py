# SPDX-License-Identifier: BSD-3-Clause
"""Explanations of recordings, their features, which mean the same on any robot, and their probabilities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

import numpy as np

from ...core.base.nominal import Nominal
from ...core.base.types import Array
from ..physics.hypotheses import Candidate
from .evidence import Fit
from .floor import law_of

MOST = 8.0  # what a feature counts at most: beyond, it is sure anyway
OF_JOINTS, LEAST_JOINTS = ("spring", "torque"), 6  # laws that each joint has; joints, of which one can stand out
APART = " apart"  # after the name of such a law: how many times what the middle joint leaves the worst one does
UNKNOWN = "unknown"  # something that no effect of the catalogue explains


@dataclass(frozen=True)
class Explanation:
    """One explanation of the recordings beside the effects that were chosen before.

    Attributes:
        option: one more effect; None: nothing more.
        fit: posterior on the training bags.
        gain, confirmed: log evidence against nothing more, of the training and of the selecting bags [nats].
        ways: number of places at which the effect could be.
        leftover: by group of residuals [noise floors].
        pulled: by width, root mean square of the parameters that vary on nominal robots [standard deviations].
        together: of nothing more, how far all of them are pulled, see `pulled_together`.
        at: (P,) deviations around which it is linear.
    """

    option: Candidate | None
    fit: Fit
    gain: float
    confirmed: float
    ways: int
    leftover: Mapping[str, float]
    pulled: Mapping[str, float]
    together: float = 0.0
    at: Array | None = None

    def features(self, nominal: Nominal) -> dict[str, float]:
        """By name: what decides, see decide.py."""
        return features(self.gain, self.confirmed, self.ways, self.leftover, self.pulled, nominal)


def features(
    gain: float,
    confirmed: float,
    ways: int,
    leftover: Mapping[str, float],
    pulled: Mapping[str, float],
    nominal: Nominal,
) -> dict[str, float]:
    """Of the values that an `Explanation` has.

    Training and selecting recordings must both show an effect: the smaller evidence counts.
    """
    laws = by_law(leftover)
    apart = {law: laws.pop(law) for law in list(laws) if law.endswith(APART)}
    return {
        "evidence": compressed(float(np.fmin(gain, confirmed))),
        "ways": -float(np.log(ways)),
        "leftover": min(worst_leftover(laws, nominal), MOST),
        "apart": min(worst_leftover(apart, nominal), MOST),
        "pulled": float(np.clip(np.log(max(pulled.values(), default=1.0)), 0.0, MOST)),
    }


def compressed(nats: float) -> float:
    """Evidence on a scale where much more of it hardly counts."""
    return float(np.arcsinh(0.5 * nats))


def by_law(leftover: Mapping[str, float]) -> dict[str, float]:
    """Of the groups of each law, the one that is left most; and how far the worst joint stands out, see `standing_out`.

    Of values by law, the same again.
    """
    worst: dict[str, float] = {}
    for key, value in leftover.items():
        worst[law_of(key)] = max(worst.get(law_of(key), 0.0), value)
    return worst | {f"{law_of(key)}{APART}": times for key, times in standing_out(leftover).items()}


def standing_out(leftover: Mapping[str, float]) -> dict[str, float]:
    """The worst joint of each law of joints, and how many times what the middle one leaves it does.

    How much all joints leave varies from robot to robot; how much one leaves beside the others of its robot does less.
    """
    groups: dict[str, dict[str, float]] = {}
    for key, value in leftover.items():
        if key.partition("/")[0] in OF_JOINTS:
            groups.setdefault(law_of(key), {})[key] = value
    out = {}
    for group in groups.values():
        middle, worst = median(group.values()), max(group, key=group.__getitem__)
        if len(group) >= LEAST_JOINTS and middle > 0.0:
            out[worst] = group[worst] / middle
    return out


def worst_leftover(values: Mapping[str, float], nominal: Nominal) -> float:
    """How far the worst law leaves more than on nominal robots, in their standard deviations; 0 where none does."""
    worst = 0.0
    for key, value in values.items():
        median, scatter = nominal.leftover.get(law_of(key), (1.0, np.inf))
        worst = max(worst, float(np.log(max(value, 1e-9) / median) / scatter))
    return worst


@dataclass(frozen=True)
class Odds:
    """Probabilities of explanations.

    Attributes:
        none, unknown: that nothing more is missing; that something outside the catalogue is.
        effects: by rival, in the order of the explanations.
        group: indices of the rivals that cannot be distinguished from the best one, itself first.
        alarm: `none` up to which there is one: few nominal robots get there.
        kin: indices of the rivals of the best one's class at its place: a lag and a delay of the drives.
        pulled: whether masses, zeros and all else that varies are pulled together as on hardly any nominal robot.
    """

    none: float
    unknown: float
    effects: tuple[float, ...]
    group: tuple[int, ...]
    alarm: float
    kin: tuple[int, ...] = ()
    pulled: bool = False

    @property
    def named(self) -> float:
        """Probability of the group."""
        return float(sum(self.effects[k] for k in self.group))

    @property
    def names(self) -> bool:
        """Whether the group, with its kin, is at least as likely as not; as all else, where nothing is improbable."""
        named = sum(self.effects[k] for k in {*self.group, *self.kin})
        return named >= 0.5 * (1.0 - self.none if self.improbable else 1.0)

    @property
    def alarms(self) -> bool:
        """Whether hardly any nominal robot gets there."""
        return self.improbable or self.pulled

    @property
    def improbable(self) -> bool:
        """Whether `none` is as improbable as on hardly any nominal robot."""
        return self.none <= self.alarm
