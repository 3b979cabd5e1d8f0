# SPDX-License-Identifier: BSD-3-Clause
"""From recordings to a verdict: which effects are missing, how surely, and what is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add

import numpy as np

from ..core.config import Config
from ..core.robot import Robot
from ..core.types import Array
from .balance import Masks, State, World, evaluate, masks
from .evidence import Evidence, Fit, Noise, Problem, Score, assemble, quieter, scores, weigh, weighed
from .hypotheses import Candidate, Figure, candidates, figures
from .recording import Recording

ENOUGH = 6.0  # nats that an effect must add on the training bags
AGREES = 2.0  # nats that it must add on the held-out bags, given what training found
MOST = 3  # effects at once
RIVALS, CLOSE = 4, 0.03  # so many are compared closely, if they explain no less than this share of what the best does
Progress = Callable[[float, str], None]


@dataclass
class Case:
    """One recording under examination."""

    recording: Recording
    where: Masks
    world: World
    state: State
    problem: Problem
    evidence: Evidence
    noise: dict[str, Noise]
    remainder: dict[str, Array]


def prepare(recording: Recording, robot: Robot, config: Config) -> tuple[Recording, World, Masks]:
    world = World.nominal(robot, config)
    return recording, world, masks(recording, world)


def examine(recording: Recording, world: World, where: Masks, known: list[Figure], at: Array) -> Case:
    """Evidence of a recording, linear around deviations `at` (P,) of the figures from nominal."""
    moved, believed = recording, world
    for figure, value in zip(known, at, strict=True):
        if value:
            moved, believed = figure.apply(moved, believed, float(value))
    state = evaluate(moved, believed, where)
    problem = assemble(state, where, known)
    return Case(recording, where, world, state, problem, *weigh(problem, at))


@dataclass
class Found:
    """Effects that training needs, and how they were found."""

    known: list[Figure]
    chosen: list[Candidate] = field(default_factory=list)
    gain: list[float] = field(default_factory=list)
    at: Array = field(default_factory=lambda: np.empty(0))
    fit: Fit | None = None
    first: list[Score] = field(default_factory=list)  # ranking before anything was chosen
    last: list[Score] = field(default_factory=list)  # what else would help, after all is chosen
    cases: list[Case] = field(default_factory=list)

    @property
    def released(self) -> list[int]:
        return [i for candidate in self.chosen for i in candidate.figures]


def search(recordings: Sequence[tuple[Recording, World, Masks]], progress: Progress | None = None) -> Found:
    """Forward selection with a new linearisation after each choice, then backward."""
    known = figures(recordings[0][0], recordings[0][1])
    options = candidates(known)
    found = Found(known, at=np.zeros(len(known)))
    impossible: list[Candidate] = []
    while True:
        found.cases = [examine(*each, known, found.at) for each in recordings]
        evidence = reduce(add, (case.evidence for case in found.cases))
        found.fit = evidence.fit(found.released)
        if found.chosen and _impossible(found):  # it looked possible from afar
            impossible.append(found.chosen.pop())
            found.gain.pop()
            found.at = _values(known, evidence.fit(found.released), found.released)
            continue
        rest = [option for option in _rest(options, found.chosen) if option not in impossible]
        found.last = scores(evidence, rest, found.released)
        found.first = found.first or found.last
        strong = [score for score in found.last if score.physical and score.gain > ENOUGH]
        if len(found.chosen) >= MOST or not strong:
            return found
        rivals = [score for score in strong[:RIVALS] if score.total > CLOSE * strong[0].total]
        best = strong[0]
        if len(rivals) > 1:  # what looks alike from afar is looked at closely
            best = max(rivals, key=_closer(found, recordings, rivals).__getitem__)
        found.chosen.append(best.option)
        found.gain.append(best.gain)
        found.at = _values(known, evidence.fit(found.released), found.released)
        if progress:
            progress(len(found.chosen) / (MOST + 1), f"{best.option.name}: {best.gain:.0f} nats")


def _closer(found: Found, recordings: Sequence[tuple[Recording, World, Masks]], rivals: Sequence[Score]) -> dict[Score, float]:
    """Log evidence of each rival, linear around its own values, all with the same noise: what the best of them leaves."""
    trials = {}
    for rival in rivals:
        released = [*found.released, *rival.option.figures]
        at = _values(found.known, reduce(add, (case.evidence for case in found.cases)).fit(released), released)
        trials[rival] = at, released, [examine(*each, found.known, at) for each in recordings]
    noises = [reduce(quieter, (trial[2][k].noise for trial in trials.values())) for k in range(len(recordings))]
    out = {}
    for rival, (at, released, cases) in trials.items():
        evidence = reduce(add, (weighed(case.problem, at, noise) for case, noise in zip(cases, noises, strict=True)))
        out[rival] = evidence.fit(released).log
    return out


def _values(known: Sequence[Figure], fit: Fit, released: Sequence[int]) -> Array:
    """Deviations (P,) to linearise around: those of the released figures, as far as they are possible."""
    at = np.zeros(len(known))
    for i in released:
        at[i] = max(fit.x[i], known[i].low)
    return at


def _impossible(found: Found) -> bool:
    assert found.fit is not None
    return any(found.fit.x[i] < found.known[i].low for i in found.chosen[-1].figures)


def _rest(options: Sequence[Candidate], chosen: Sequence[Candidate]) -> list[Candidate]:
    taken = {i for candidate in chosen for i in candidate.figures}
    return [option for option in options if not taken.intersection(option.figures)]
