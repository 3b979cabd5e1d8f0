# SPDX-License-Identifier: BSD-3-Clause
"""How much the robot weighs beyond its URDF, by its forces and its motion, whatever a baseline takes for usual.

Each link of nominal robots is off by some percent on its own, so that all together are hardly off: these priors would
halve an error that all links share. So the factor of all masses is an unknown of its own here, as wide as the effect
`body_mass`. All else is what the population has. Only the balance of forces speaks, and what the sensors read in the
air: where springs or soles are not as believed, other laws would make a weight of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.base.nominal import Nominal, load_nominal
from ...core.base.types import Array
from ...core.effects.unknown import Unknown
from ..data.recording import lifts_a_foot
from .case import Case
from .evidence import Evidence, pooled
from .variability import adapted, with_both

LOADS = {"payload", "body_mass"}  # effects that change what a robot weighs
SURE = 3.0  # standard deviations beyond which a weight is off
FORCES = ("force/", "unloaded/")  # laws that speak of it


@dataclass(frozen=True)
class Weight:
    """By how much a robot weighs more than its URDF says.

    Attributes:
        share: of the weight by the URDF; NaN where the robot only stands, as it shows its sensors' gains as little, and
            where the mean vertical force says otherwise: then other laws that fit badly make it.
        deviation: its standard deviation.
        allowed: what data sheets allow masses to be off by.
    """

    share: float
    deviation: float
    allowed: float

    @property
    def off(self) -> bool:
        """Whether it surely is beyond what data sheets allow."""
        return abs(self.share) > max(self.allowed, SURE * self.deviation)


def weight(cases: Sequence[Case], released: Sequence[int] = ()) -> Weight:
    """Of the robot of some recordings.

    Args:
        cases: of recordings, around the same values of the parameters.
        released: indices of the parameters of chosen effects.
    """
    population = load_nominal()
    allowed = population.most["mass.spread"]
    computed = any(case.recording.computed for case in cases)  # such wrenches bear the weight that the URDF says
    if computed or not any(lifts_a_foot(case.recording.phase) for case in cases):
        return Weight(np.nan, np.nan, allowed)
    known, model = cases[0].evidence.unknowns, cases[0].state.world.robot.model
    total = sum(inertia.mass for inertia in model.inertias)
    shares, masses = np.zeros(len(known)), np.zeros(len(known))
    for i, unknown in enumerate(known):
        masses[i] = not unknown.effect and unknown.key == "mass"
        if masses[i] or unknown.effect == "body_mass":
            shares[i] = model.inertias[model.getJointId(unknown.where)].mass / total
        elif (unknown.effect, unknown.key) == ("payload", "mass"):
            shares[i] = 1.0 / total
    evidences = [_with_common(case.said_by(FORCES), masses, population) for case in cases]
    everything = adapted(evidences, population)
    # Gains of foot sensors that are taken to be precise would make a weight of their errors.
    fit = pooled(replace(each, unknowns=everything) for each in evidences).fit_of_kind(released)
    shares = np.append(shares, shares @ masses)
    share, deviation = float(shares @ fit.x), float(np.sqrt(shares @ fit.covariance @ shares))
    carried = float(np.mean([_carried(case, total) for case in cases])) - 1.0
    if not abs(share - carried) <= allowed + deviation:
        return Weight(np.nan, np.nan, allowed)
    return Weight(share, deviation, allowed)


def _carried(case: Case, mass: float) -> float:
    """Mean vertical force on both feet over the weight of a mass [kg]."""
    forces = sum(wrench[:, 2] for wrench in case.recording.wrench.values())
    return float(np.nanmean(forces)) / (mass * case.state.world.gravity)


def _with_common(evidence: Evidence, masses: Array, population: Nominal) -> Evidence:
    """Evidence about what the population has, not what is usual for this robot, with a factor of all masses at the end.

    Args:
        masses: (P,) 1 for the unknowns of nominal scatter that are a mass.
    """
    known = [replace(each, usual=_usual(each, population)) for each in with_both(evidence.unknowns, population)]
    at = evidence.at + [before.usual - now.usual for before, now in zip(evidence.unknowns, known, strict=True)]
    width = population.widths["body_mass.scale.reach"]
    common = Unknown("", "", "mass of all", "1", lambda r, w, x: (r, w), reach=width, spread=width)
    J = np.column_stack([np.eye(len(at)), masses])
    moment = evidence.moment + evidence.gram @ at
    energy = evidence.energy + float(at @ (evidence.moment + moment))
    unknowns, nothing = [*known, common], np.zeros(len(known) + 1)
    return Evidence(unknowns, nothing, J.T @ evidence.gram @ J, J.T @ moment, energy)


def _usual(unknown: Unknown, population: Nominal) -> float:
    return population.widths[unknown.widths["usual"]] * unknown.relative if "usual" in unknown.widths else 0.0
