# SPDX-License-Identifier: BSD-3-Clause
"""How much the unknowns vary on nominal robots, by kind of robot: which of its parts are precise."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ...core.base.types import Array
from ...core.effects.unknown import Unknown

Kind = tuple[str, ...]  # the parts of a robot that are precise
ABSENT = 1e-4  # spread, as a share of reach, of an unknown that nominal robots do not have


def spread_of(unknown: Unknown, precise: Kind) -> float:
    """On robots of a kind."""
    return unknown.spread if unknown.precise is None or unknown.part not in precise else unknown.precise


def kinds_of(known: Sequence[Unknown]) -> list[Kind]:
    """All kinds of robots, as most are first."""
    parts = sorted({unknown.part for unknown in known if unknown.precise is not None})
    return [kind for n in range(len(parts) + 1) for kind in combinations(parts, n)]


def prior_variance(known: Sequence[Unknown], released: Sequence[int] = (), precise: Kind = ()) -> Array:
    """(P,) of nominal robots, with the unknowns `released` at their reach; of those that have `precise` parts."""
    spread = np.array([max(spread_of(unknown, precise), ABSENT * unknown.reach) for unknown in known])
    for i in released:
        spread[i] = max(known[i].reach, spread[i])
    return np.asarray(spread**2)
