# SPDX-License-Identifier: BSD-3-Clause
"""Cases of the recordings under examination, computed once for each value of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from ...core.base.nominal import Nominal, load_nominal
from ...core.base.types import Array
from ..physics.hypotheses import unknowns
from .case import Case, Prepared, examine, with_known
from .variability import adapted


class CaseCache:
    """Prepared recordings, and their cases by the values of the parameters.

    Attributes:
        train, hold: recordings as `prepare` returns them; those of `hold` help to select.
        nominal: how nominal robots vary.
        known: all parameters of these recordings, P of them, with the spreads that this robot shows.
        converged: by starting point, the case whose derivatives count, and released and held parameters, the values
            (P,) where Gauss-Newton ended.
    """

    def __init__(
        self, train: Sequence[Prepared], hold: Sequence[Prepared] = (), nominal: Nominal | None = None
    ) -> None:
        self.train, self.hold, self.nominal = train, hold, nominal or load_nominal()
        population = unknowns(train[0][0], train[0][1], self.nominal)
        prepared = [*train, *hold]
        first = [examine(each, population, np.zeros(len(population)), nominal=self.nominal) for each in prepared]
        self.known = adapted([case.evidence for case in first], self.nominal)
        cases = [with_known(case, self.known) for case in first]
        self.converged: dict[tuple[Any, ...], Array] = {}
        self._cases: dict[tuple[str, bytes], list[Case]] = {}
        self._first = {"train": cases[: len(train)], "hold": cases[len(train) :]}
        for which, several in self._first.items():
            self._cases[which, np.zeros(len(population)).tobytes()] = several

    def at(self, at: Array, which: Literal["train", "hold"]) -> list[Case]:
        """Cases of the training or held-out recordings, linear around deviations `at` (P,) from nominal."""
        key = which, at.tobytes()
        if key not in self._cases:
            first = self._first[which]
            pairs = zip(getattr(self, which), first, strict=True)
            self._cases[key] = [examine(each, self.known, at, case) for each, case in pairs]
        return self._cases[key]

    def has(self, at: Array) -> bool:
        """Whether all derivatives of the training recordings have been computed there."""
        return ("train", at.tobytes()) in self._cases

    def near(self, at: Array, like: Sequence[Case], changed: Sequence[int]) -> list[Case]:
        """Cases of the training recordings, with new derivatives for the parameters `changed` only.

        Takes a quarter of the time of `at`, for gains of foot sensors more; the other derivatives are those of `like`.
        """
        return [examine(each, self.known, at, case, changed) for each, case in zip(self.train, like, strict=True)]
