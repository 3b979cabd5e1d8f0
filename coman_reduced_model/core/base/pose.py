# SPDX-License-Identifier: BSD-3-Clause
"""Poses as matrices and as positions with quaternions."""

from __future__ import annotations

import math

import numpy as np

from .types import Array

LEVEL = np.array([0.0, 0.0, -1.0])  # direction of gravity in odom on level ground


def matrix(px: float, py: float, pz: float, x: float, y: float, z: float, w: float) -> Array:
    """(4, 4) of a position [m] and a quaternion; NaN where the quaternion is zero or not finite."""
    norm = x * x + y * y + z * z + w * w
    s = 2.0 / norm if norm > 1e-12 else math.nan
    return np.array(
        (
            (1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), px),
            (s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w), py),
            (s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y), pz),
            (0.0, 0.0, 0.0, 1.0),
        )
    )


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Unit quaternion x, y, z, w with w >= 0 of a rotation (3, 3), by its largest component (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    if not math.isfinite(a + e + i):
        return (math.nan,) * 4
    # Four times the products of the components with the largest one.
    rows = (
        (1.0 + a - e - i, b + d, c + g, h - f),
        (b + d, 1.0 - a + e - i, f + h, c - g),
        (c + g, f + h, 1.0 - a - e + i, d - b),
        (h - f, c - g, d - b, 1.0 + a + e + i),
    )
    row = max(zip((rows[0][0], rows[1][1], rows[2][2], rows[3][3]), rows, strict=True))[1]
    norm = math.copysign(math.sqrt(sum(v * v for v in row)), row[3])
    return (row[0] / norm, row[1] / norm, row[2] / norm, row[3] / norm)
