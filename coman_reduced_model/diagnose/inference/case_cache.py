# SPDX-License-Identifier: BSD-3-Clause
"""Cases of the recordings under examination, computed once for each value of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar, cast

from ...core.base.types import Array
from ..physics.hypotheses import Candidate, unknowns
from .case import Case, Prepared, examine
from .finding import Finding

_Answer = TypeVar("_Answer")


class CaseCache:
    """Prepared recordings, and their cases by the values of the parameters.

    Attributes:
        train, hold: recordings as `prepare` returns them.
        known: all parameters of these recordings, P of them.
        converged: by starting point and released parameters, the values (P,) where Gauss-Newton ended.
    """

    def __init__(self, train: Sequence[Prepared], hold: Sequence[Prepared] = ()) -> None:
        self.train, self.hold = train, hold
        self.known = unknowns(train[0][0], train[0][1])
        self.converged: dict[tuple[Any, ...], Array] = {}
        self._cases: dict[tuple[str, bytes], list[Case]] = {}
        self._answers: dict[tuple[Any, ...], Any] = {}

    def at(self, at: Array, which: Literal["train", "hold"]) -> list[Case]:
        """Cases of the training or held-out recordings, linear around deviations `at` (P,) from nominal."""
        key = which, at.tobytes()
        if key not in self._cases:
            self._cases[key] = [examine(each, self.known, at) for each in getattr(self, which)]
        return self._cases[key]

    def forget(self, *kept: Array) -> None:
        """Drop the cases at other values than `kept`: those of long recordings would fill the memory."""
        values = {at.tobytes() for at in kept}
        self._cases = {key: cases for key, cases in self._cases.items() if key[1] in values}

    def memoize(self, function: Callable[..., _Answer], finding: Finding, *options: Candidate) -> _Answer:
        """The value of `function(finding, cache, *options)`, computed once for each set of chosen effects and options.

        A second search with another threshold asks for the same values.
        """
        key = (function, finding.at.tobytes(), *finding.released, *options)
        if key not in self._answers:
            self._answers[key] = function(finding, self, *options)
        return cast(_Answer, self._answers[key])

    def near(self, at: Array, like: Sequence[Case], changed: Sequence[int]) -> list[Case]:
        """Cases of the training recordings, with new derivatives for the parameters `changed` only.

        Takes a quarter of the time of `at`; the other derivatives are those of the cases `like`.
        """
        return [examine(each, self.known, at, case, changed) for each, case in zip(self.train, like, strict=True)]
