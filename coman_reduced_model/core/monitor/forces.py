# SPDX-License-Identifier: BSD-3-Clause
"""What pushes a robot that its feet do not tell of: the force balance of the whole of it over a window of time.

Mass times the acceleration of the COM is the sum of all forces. Weighed by a window w(t) that vanishes with its slope
at both ends, integration by parts leaves the residual `int w F dt + m int w' dc` of feet and weight F and the way c of
the COM: nothing measured is differentiated. (1 - s^2)^2 is the window that white noise of positions disturbs least.

The way of the COM is that against the point of the ground under the centre of pressure, which is at rest even while the
foot rocks on its edge; both feet count by the load they bear. The base is turned as the IMU says, while there is one
that can be believed; else as these soles do, which then are taken to lie flat.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..base.compiled import apply, compiled
from ..base.types import Array, Foot

if TYPE_CHECKING:
    from ..robot.robot import Posture

_ROWS = 256  # looks that are remembered
WINDOW_NS = 300_000_000  # over which forces are weighed at least: below that, noise has the better of them
_GAP_S = 0.05  # between looks, after which nothing is known of the way in between
_BEARS, _STANDS = 0.01, 0.05  # of the weight, below which a foot has no centre of pressure, and both are in the air
# An IMU counts once it has been there for so long at every look, until it was not for so long [ns].
_THERE_NS, _GONE_NS = 1_000_000_000, 10_000_000_000
_UPRIGHT = 0.9  # cosine of up to the support sole's: below, an IMU sits otherwise than told, or the robot falls
# Rows: the middle of two looks and the time between them [s], the force [N], the way [m] then.
_MIDDLE, _DT, _FORCE, _WAY, _COLUMNS = 0, 1, slice(2, 5), slice(5, 8), 8
# Of a look, by foot: COM against the sole's origin (3,) and the sole's axes (3, 3), both level, the centre of pressure
# in it (2,) and its share of the load; then the force (3,), in a row of the same length.
_FOOT = 15
_NOT_THERE = np.full((3, 3), np.nan)


class Forces:
    """The last looks at one robot.

    Attributes:
        by_imu: an IMU tells how the base is turned.
        heading: of the axes in which what was seen is kept, as seen in the support sole [rad].
    """

    def __init__(self, mass: float, gravity: float, soles: Array) -> None:
        """`soles` (2, 4) edges of the left and the right sole [m]."""
        self._mass, self._gravity, self._soles = mass, gravity, soles
        self._rows, self._last = np.zeros((_ROWS, _COLUMNS)), np.zeros((3, _FOOT))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._n = self._stamp = self._since = self._seen = 0  # stamps of the last look, the first and last by IMU [ns]
        self._foot, self.heading, self.by_imu = Foot.LEFT, 0.0, False

    def look(self, stamp: int, foot: Foot, posture: Posture, left: Array, right: Array, turned: Array) -> None:
        """Take a look.

        Args:
            stamp: [ns].
            foot: that supports.
            posture: of the base and the soles.
            left, right: wrenches (6,) of the soles, in their axes [N, Nm].
            turned: (3, 3) the base's rotation against the ground by an IMU, or NaN.
        """
        R, p = posture.R, posture.p
        dt, self._stamp = (stamp - self._stamp) * 1e-9, stamp
        known = 0.0 < dt < _GAP_S
        there = bool(turned[2] @ R[foot][:, 2] > _UPRIGHT)
        self._since = self._since if there and known and self._since else stamp * there
        self._seen = stamp if there else self._seen
        by_imu = stamp - self._seen < _GONE_NS if self.by_imu else there and stamp - self._since >= _THERE_NS
        if not known or by_imu != self.by_imu:
            self._n, self.heading, self._foot, self.by_imu = 0, 0.0, foot, by_imu
        if foot is not self._foot:
            self.heading, self._foot = _carried(self.heading, R[self._foot], R[foot]), foot
        row = self._rows[self._n % _ROWS]
        self.heading = _look(
            row, self._last, self.heading, R[foot], R[Foot.LEFT], p[Foot.LEFT], R[Foot.RIGHT], p[Foot.RIGHT],
            posture.com, left, right, turned if there else _NOT_THERE, by_imu, self._soles, self._mass * self._gravity,
        )  # fmt: skip
        row[_MIDDLE], row[_DT] = stamp * 1e-9 - 0.5 * dt, dt
        if not self._n:
            row[:] = np.nan
        self._n += 1

    def over(self, start: int, end: int) -> Array:
        """Force (3,) [N] of which feet and weight have too much between two stamps [ns]; level, x along that sole.

        What pushes the robot beside them is the opposite. NaN where the looks do not tell.
        """
        return _over(self._rows, min(self._n, _ROWS), start * 1e-9, end * 1e-9, self._mass, self.heading)


def _carried(heading: float, R: Array, R_new: Array) -> float:
    """The heading (by R) as seen by another foot."""
    x = R @ [np.cos(heading), np.sin(heading), 0.0]
    return float(np.arctan2(R_new[:, 1] @ x, R_new[:, 0] @ x))


@compiled
def _look(
    row: Array, last: Array, heading: float, R: Array, R_l: Array, p_l: Array, R_r: Array, p_r: Array, com: Array,
    left: Array, right: Array, turned: Array, by_imu: bool, soles: Array, weight: float,
) -> float:  # fmt: skip
    """Force and way since the `last` look into a row; feet as in `laws._look`, R that of the support foot.

    Returns the heading.
    """
    load_l, load_r = max(left[2], 0.0), max(right[2], 0.0)
    share = load_l / (load_l + load_r) if load_l + load_r > _STANDS * weight else np.nan
    level = turned.copy()
    if by_imu:
        heading = np.arctan2((R[:, 1] * level[0]).sum(), (R[:, 0] * level[0]).sum())
    else:
        z = share * R_l[:, 2] + (1.0 - share) * R_r[:, 2]
        z /= np.sqrt((z * z).sum())
        x = np.cos(heading) * R[:, 0] + np.sin(heading) * R[:, 1]
        x -= (x * z).sum() * z
        x /= np.sqrt((x * x).sum())
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            level[0, k], level[1, k], level[2, k] = x[k], z[a] * x[b] - z[b] * x[a], z[k]
    row[_WAY] = 0.0
    force = apply(level, apply(R_l, left[:3]) + apply(R_r, right[:3]))
    force[2] -= weight
    for foot in range(2):
        here, there = np.zeros(_FOOT), last[foot].copy()
        wrench, axes, p, edges = (left, R_l, p_l, soles[0]) if foot == 0 else (right, R_r, p_r, soles[1])
        here[:3] = apply(level, com - p)
        for k in range(3):
            here[3 + 3 * k : 6 + 3 * k] = apply(level, axes[:, k].copy())
        load = max(wrench[2], _BEARS * weight)
        here[12] = min(max(-wrench[4] / load, edges[0]), edges[1])
        here[13] = min(max(wrench[3] / load, edges[2]), edges[3])
        here[14] = share if foot == 0 else 1.0 - share
        way = here[:3] - there[:3]
        for k in range(2):  # less that of the sole at the centre of pressure
            way -= (here[3 + 3 * k : 6 + 3 * k] - there[3 + 3 * k : 6 + 3 * k]) * 0.5 * (here[12 + k] + there[12 + k])
        row[_WAY] += 0.5 * (here[14] + there[14]) * way
        last[foot] = here
    row[_FORCE] = 0.5 * (force + last[2, :3])
    last[2, :3] = force
    return float(heading)


@compiled
def _over(rows: Array, n: int, start: float, end: float, mass: float, heading: float) -> Array:
    """`Forces.over` of n rows, times in s."""
    half, covered, force = 0.5 * (end - start), 0.0, np.zeros(3)
    for i in range(n):
        s = (rows[i, _MIDDLE] - start) / half - 1.0
        if abs(s) < 1.0:
            w, slope = 0.9375 * (1.0 - s * s) ** 2 / half, -3.75 * s * (1.0 - s * s) / half**2
            covered += rows[i, _DT]
            for k in range(3):
                force[k] += w * rows[i, _DT] * rows[i, 2 + k] + mass * slope * rows[i, 5 + k]
    if not covered > 1.8 * half:
        return np.full(3, np.nan)
    return about_vertical(force, heading)


@compiled
def about_vertical(v: Array, angle: float) -> Array:
    """A vector (3,) turned by an angle [rad] about z."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * v[0] - sin * v[1], sin * v[0] + cos * v[1], v[2]])
