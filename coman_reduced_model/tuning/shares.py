# SPDX-License-Identifier: BSD-3-Clause
"""How the legs share the force in double support (Fig. 9), from the wrenches of a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.base.types import Array, Foot, Phase
from ..core.config.schema import Config
from .recording import JoinedBag
from .statistics import quantile

_LEAST = 3  # double supports, fewer say nothing
_TIGHT = 0.1  # a share whose interval is wider to either side is not taken over


@dataclass(frozen=True)
class Share:
    """The share of one leg along one axis, in the double support before or after its own single support."""

    axis: str  # x or z
    when: str  # before: the leg has just landed in front; after: it is the one behind
    whole: float  # over the whole double support, as in Fig. 9
    interval: tuple[float, float]
    leading: float  # over the samples in which it is the support leg: what (22), (23) divide by
    leading_interval: tuple[float, float]
    double_supports: int

    @property
    def usable(self) -> bool:
        """Whether the model can divide by it."""
        low, high = self.leading_interval
        return 0.05 <= self.leading <= 1.0 and high - low <= 2.0 * _TIGHT


def measure_shares(recordings: Sequence[JoinedBag]) -> list[Share]:
    """Shares per axis, before and after single support; empty if there are too few double supports.

    The share is the ratio of the leg's force to the sum that explains it best in the least squares sense, for the
    horizontal forces pass through zero; each double support counts once, which the interval over them respects.
    """
    parts = [part for recording in recordings for part in _double_supports(recording)]
    if len(parts) < _LEAST:
        return []
    shares = []
    for column, axis in ((0, "x"), (2, "z")):
        for number, when in enumerate(("before", "after")):
            whole = _ratio([(part.force[number][:, column], part.total[:, column]) for part in parts])
            led = [(part.leads == (number == 0), part) for part in parts]
            leading = _ratio([(p.force[number][use, column], p.total[use, column]) for use, p in led if use.any()])
            if whole is not None and leading is not None:
                shares.append(Share(axis, when, *whole, *leading, len(parts)))
    return shares


def with_shares(config: Config, shares: Sequence[Share]) -> Config:
    """The configuration with the shares that are known well enough, if its model divides by constants."""
    if config.model.shares != "constant" or config.turning:
        return config
    usable = {f"model.share_{s.axis}_{s.when}": float(round(s.leading, 4)) for s in shares if s.usable}
    return config.replaced(usable)


@dataclass(frozen=True)
class _DoubleSupport:
    force: tuple[Array, Array]  # (n, 3) of the leg that has just landed, of the leg that will lift [N]
    total: Array  # (n, 3)
    leads: Array  # (n,) whether the landed leg is the support leg


def _double_supports(recording: JoinedBag) -> list[_DoubleSupport]:
    """Double supports between two single supports of different legs; forces in the axes of the soles."""
    phases = np.array([p.support.phase for p in recording.predictions])
    edges = [0, *(np.flatnonzero(np.diff(phases)) + 1).tolist(), len(phases)]
    stretches = [(a, b, phases[a]) for a, b in zip(edges, edges[1:], strict=False)]
    found = []
    for before, now, after in zip(stretches, stretches[1:], stretches[2:], strict=False):
        if now[2] != Phase.DOUBLE or {before[2], after[2]} != {Phase.LEFT, Phase.RIGHT}:
            continue
        landed = Foot.LEFT if after[2] == Phase.LEFT else Foot.RIGHT
        use = [
            i
            for i in range(now[0], now[1])
            if recording.samples[i].left_wrench is not None and recording.samples[i].right_wrench is not None
        ]
        if not use:
            continue
        left = np.array([recording.samples[i].left_wrench[:3] for i in use])  # type: ignore[index]
        right = np.array([recording.samples[i].right_wrench[:3] for i in use])  # type: ignore[index]
        pair = (left, right) if landed == Foot.LEFT else (right, left)
        leads = np.array([recording.predictions[i].support.support_foot == landed for i in use])
        found.append(_DoubleSupport(pair, left + right, leads))
    return found


def _ratio(pairs: Sequence[tuple[Array, Array]]) -> tuple[float, tuple[float, float]] | None:
    """Part over whole by least squares, and its interval: pairs, one a double support, are independent."""
    n = len(pairs)
    squares = np.array([float(whole @ whole) for _, whole in pairs])
    products = np.array([float(part @ whole) for part, whole in pairs])
    if n < _LEAST or not squares.sum() > 0.0:
        return None
    value = float(products.sum() / squares.sum())
    error = float(np.sqrt(((products - value * squares) ** 2).sum() * n / (n - 1.0)) / squares.sum())
    half = quantile(n - 1) * error
    return value, (value - half, value + half)
