# SPDX-License-Identifier: BSD-3-Clause
"""Shifts in time, of a size: about nominal, all that shift the same stream have the same derivative, a delay and a lag.

What distinguishes them is of second order. What a shift of some size does, divided by that size, shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ...core.base.types import Array
from ...core.effects.unknown import Unknown
from ..physics.balance import evaluate
from ..physics.hypotheses import Candidate
from .case import Case
from .evidence import weighed
from .isolability import SIZE
from .reference import CLOCKS


def at_share(cases: Sequence[Case], size: float = SIZE) -> list[Case]:
    """The same cases, with shifts in time of a share `size` of their reach in place of their derivatives."""
    return [_at(case, lambda unknown: size * unknown.reach) for case in cases]


def at_values(cases: Sequence[Case], option: Candidate, values: Array) -> Sequence[Case]:
    """For one effect whose parameters deviate by `values` (P,): if it shifts a stream, with all shifts as large as its.

    Args:
        cases: as `at_share` returns them, and as they stay for any other effect.
    """
    if option.effect not in CLOCKS:
        return cases
    shift = max(abs(float(values[i])) for i in option.unknowns)
    return [_at(case, lambda unknown: max(shift, unknown.step)) for case in cases]


def _at(case: Case, size: Callable[[Unknown], float]) -> Case:
    """Along the motion without the sensors' noise, which a shift in time would only move."""
    known = case.problem.unknowns
    timed = [i for i, unknown in enumerate(known) if unknown.effect in CLOCKS]
    if not timed:
        return case
    quiet, columns = case.reference.quiet, {key: column.copy() for key, column in case.problem.columns.items()}
    for i in timed:
        by = size(known[i])
        moved = evaluate(*known[i].apply(quiet.recording, quiet.world, by), case.where, quiet).residuals
        for key, times in case.problem.times.items():
            channel = key.partition("|")[0]
            columns[key][:, i] = (quiet.residuals[channel][times] - moved[channel][times]) / by
    problem = replace(case.problem, columns=columns)
    return replace(case, problem=problem, evidence=weighed(problem, case.evidence.at, case.noise))
