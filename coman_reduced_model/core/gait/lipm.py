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

from ..base.types import Array


def _unrest(times: Array, zmp: Array, omega: float) -> Array:
    """Motion left over at the first and the last knot, (2, m), for m ZMP coordinates at the knots (K, m).

    Outside the plan the ZMP stands still, so the COM is exactly at rest at the ends if and only if both are zero.
    """
    none = np.zeros((1, zmp.shape[1]))
    jump = np.diff(np.diff(zmp, axis=0) / np.diff(times)[:, None], axis=0, prepend=none, append=none)
    return np.exp(-omega * np.stack([times - times[0], times[-1] - times])) @ jump


def rest_at_both_ends(times: Array, zmp: Array, omega: float, free: tuple[int, int]) -> Array:
    """Moves two knots of the ZMP so that the COM starts and ends exactly at rest on the ZMP.

    A pendulum at rest on its ZMP can only set off when the ZMP first moves the other way. The two free knots are
    that counter-movement while standing; the boundary value problem is linear in them.

    Args:
        times: (K,) knots, strictly increasing [s].
        zmp: (K, 3) ZMP at the knots [m].
        omega: sqrt(g / z_c) [rad/s].
        free: the knot to move at the start and the one at the end.

    Returns:
        (K, 3) the ZMP with these two knots moved [m].
    """
    nudge = np.zeros((len(times), 2))
    nudge[list(free), [0, 1]] = 1.0
    return zmp - nudge @ np.linalg.solve(_unrest(times, nudge, omega), _unrest(times, zmp, omega))


class LipmCom:
    """Bounded COM trajectory over a piecewise-linear ZMP; before the first and after the last knot it stands still."""

    def __init__(self, times: Array, zmp: Array, height: float, omega: float):
        """Solves for the COM.

        Args:
            times: (K,) knots, strictly increasing, K >= 2 [s].
            zmp: (K, 3) ZMP at the knots [m], at constant z.
            height: of the COM above the ZMP [m].
            omega: sqrt(g / height) [rad/s].
        """
        span = np.diff(times)
        slope = np.diff(zmp, axis=0) / span[:, None]
        jump = np.diff(slope, axis=0, prepend=np.zeros((1, 3)), append=np.zeros((1, 3))) / (2.0 * omega)
        decay = np.exp(-omega * span)
        # In each interval the exponentials of all knots on its left add up to one, and so do those on its right.
        past, future = np.zeros_like(slope), np.zeros_like(slope)
        past[0], future[-1] = jump[0], jump[-1]
        for i in range(1, len(span)):
            past[i] = jump[i] + past[i - 1] * decay[i - 1]
            future[-1 - i] = jump[-1 - i] + future[-i] * decay[-i]
        still, up = np.zeros_like(slope), np.tile([0.0, 0.0, height], (len(span), 1))
        # What multiplies 1, t, exp(-omega t), exp(omega (t - span)) in each interval.
        quantities = [
            [zmp[:-1] + up, slope, past, future],  # COM
            [slope, still, -omega * past, omega * future],  # its velocity
            [still, still, omega**2 * past, omega**2 * future],  # its acceleration
            [zmp[:-1], slope, still, still],  # ZMP
        ]
        self.times = times
        self._inner, self._edges = times[1:-1], np.stack([times[:-1], times[1:]], axis=1)
        self._rates = np.array([-omega, omega])
        # (K - 1, 4 terms, 4 quantities x 3)
        self._terms = np.array(quantities).transpose(2, 1, 0, 3).reshape(len(span), 4, 12)

    def __call__(self, t: Array) -> Array:
        """COM, its velocity, its acceleration and the ZMP: (n, 4, 3) [m, m/s, m/s^2, m] at the times t (n,) [s]."""
        t = np.minimum(np.maximum(t, self.times[0]), self.times[-1])
        i = self._inner.searchsorted(t, side="right")
        since = t[:, None] - self._edges.take(
            i, axis=0
        )  # since the start, and (negative) since the end of the interval
        basis = np.ones((len(t), 1, 4))
        basis[:, 0, 1] = since[:, 0]
        basis[:, 0, 2:] = np.exp(since * self._rates)
        return (basis @ self._terms.take(i, axis=0)).reshape(-1, 4, 3)
