# SPDX-License-Identifier: BSD-3-Clause
"""COM of the linear inverted pendulum for a piecewise-linear ZMP, in closed form: equations (18), (19).

x_zmp = x - x'' / omega^2 with omega^2 = g / z_c has one solution that stays bounded. For a ZMP p(t) whose slope jumps
by s_k at the knots t_k it is the ZMP plus one decaying exponential to each side of every knot:

    x(t) = p(t) + sum_k s_k / (2 omega) exp(-omega |t - t_k|)

because exp(-omega |t|) / (2 omega) is the bounded Green's function of y - y''/omega^2 = p''/omega^2. No exponential
ever grows, so that an hour of standing neither overflows nor drifts.
"""

from __future__ import annotations

import numpy as np

from coman_reduced_model.core.types import Array


def _knot_weights(times: Array, omega: float) -> Array:
    """Rows c0, c1 (2, K) with c @ zmp = the motion left over at the first and the last knot.

    Outside the plan the ZMP stands still, so the COM is exactly at rest at the ends if and only if both are zero.
    """
    slope = np.zeros((len(times) + 1, len(times)))  # slope before, between and after the knots, from the knot values
    span = np.diff(times)
    rows = np.arange(len(span))
    slope[rows + 1, rows], slope[rows + 1, rows + 1] = -1.0 / span, 1.0 / span
    decay = np.exp(-omega * np.stack([times - times[0], times[-1] - times]))
    return decay @ np.diff(slope, axis=0)


def rest_at_both_ends(times: Array, zmp: Array, omega: float, free: tuple[int, int]) -> Array:
    """Moves two knots of the ZMP so that the COM starts and ends exactly at rest on the ZMP.

    A pendulum at rest on its ZMP can only set off when the ZMP first moves the other way. The two free knots are
    that counter-movement while standing; the boundary value problem is linear in them.

    Args:
        times: (K,) knots, strictly increasing [s].
        zmp: (K, 2) ZMP at the knots [m].
        omega: sqrt(g / z_c) [rad/s].
        free: the knot to move at the start and the one at the end.

    Returns:
        (K, 2) the ZMP with these two knots moved [m].
    """
    weights = _knot_weights(times, omega)
    moved = zmp.copy()
    moved[list(free)] -= np.linalg.solve(weights[:, list(free)], weights @ zmp)
    return moved


class LipmCom:
    """Bounded COM trajectory over a piecewise-linear ZMP; before the first and after the last knot it stands still."""

    def __init__(self, times: Array, zmp: Array, omega: float):
        """Args: times (K,) strictly increasing [s], K >= 2; zmp (K, 2) [m]; omega [rad/s]."""
        span = np.diff(times)
        slope = np.diff(zmp, axis=0) / span[:, None]
        jump = np.diff(slope, axis=0, prepend=np.zeros((1, 2)), append=np.zeros((1, 2))) / (2.0 * omega)
        decay = np.exp(-omega * span)
        # In each interval the exponentials of all knots on its left add up to one, and so do those on its right.
        past, future = np.zeros_like(slope), np.zeros_like(slope)
        left, right = np.zeros(2), np.zeros(2)
        for i in range(len(span)):
            left = jump[i] + (left * decay[i - 1] if i else 0.0)
            past[i] = left
        for i in reversed(range(len(span))):
            right = jump[i + 1] + (right * decay[i + 1] if i + 1 < len(span) else 0.0)
            future[i] = right
        self.times, self.omega = times, omega
        # One gather a call: start value, slope, past and future amplitude of each interval, (K-1, 4, 2).
        self._table = np.stack([zmp[:-1], slope, past, future], axis=1)

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """COM position [m], velocity [m/s] and ZMP [m], each (n, 2), at the times t (n,) [s].

        The acceleration is omega^2 (com - zmp).
        """
        t = np.minimum(np.maximum(t, self.times[0]), self.times[-1])
        i = np.minimum(self.times.searchsorted(t, side="right"), len(self.times) - 1) - 1
        start, slope, past, future = self._table[i].swapaxes(0, 1)
        since = (t - self.times[i])[:, None]
        past = past * np.exp(-self.omega * since)
        future = future * np.exp(self.omega * (t - self.times[i + 1]))[:, None]
        zmp = start + slope * since
        return zmp + (past + future), slope + self.omega * (future - past), zmp
