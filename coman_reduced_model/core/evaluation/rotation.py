# SPDX-License-Identifier: BSD-3-Clause
"""Errors of the estimated rotation of the trunk, and whether they are as large as its covariance says."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ..base.pose import matrix
from ..base.types import Array, Foot, Phase, Prediction
from ..observer.rotation import rotation_vector
from .statistics import NINETY, beside, by_axis


@dataclass(frozen=True)
class TrueRotation:
    """Rotation of the trunk of a virtual robot over time, its trunk being the root link.

    Attributes:
        time: (n,) [s].
        R: by foot (n, 3, 3), trunk to the level frame of the sole: z against gravity, x above that of the sole.
        rate: (n, 3) angular velocity in the axes of the trunk [rad/s].
    """

    time: Array
    R: dict[Foot, Array]
    rate: Array

    @classmethod
    def of(cls, time: Array, orientation: Array, gravity: Array, ahead: dict[Foot, Array]) -> TrueRotation:
        """From quaternions (n, 4) x y z w, gravity (3,) and, by foot, x (n, 3) of the soles, all in the world."""
        world = np.array([matrix(0.0, 0.0, 0.0, *each)[:3, :3] for each in orientation.astype(float).tolist()])
        up = -gravity.astype(float) / np.linalg.norm(gravity)
        turned = {}
        for foot, direction in ahead.items():
            level = direction - np.outer(direction @ up, up)
            level /= np.linalg.norm(level, axis=1)[:, None]
            axes = np.stack([level, np.cross(up, level), np.broadcast_to(up, level.shape)], axis=1)
            turned[foot] = axes @ world
        change = np.gradient(world, time, axis=0)
        skew = np.einsum("nji,njk->nik", world, change)
        rate = 0.5 * np.stack([skew[:, i, j] - skew[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
        return cls(time, turned, rate)

    def at(self, t: float, foot: Foot) -> tuple[Array, Array]:
        """R (3, 3) and the angular velocity (3,) at a time, of the samples beside it; R of small turns between them."""
        k, share = beside(self.time, t)
        rate = (1.0 - share) * self.rate[k - 1] + share * self.rate[k]
        if foot == Foot.NONE:
            return np.full((3, 3), np.nan), rate
        R = (1.0 - share) * self.R[foot][k - 1] + share * self.R[foot][k]
        return R, rate


class TurnedErrors:
    """Errors of one recording; the middle of each single support counts for NEES and intervals.

    Attributes:
        errors: (n, 4, 3) at all samples: turn of the estimate and by encoders alone [rad], angular velocity of the
            estimate and by encoders alone [rad/s].
        off: (m, 2, 3) turn and angular velocity in their standard deviations, at the middles of steps.
        nees: (m, 2) of roll and pitch, and of the angular velocity: 2 and 3 are expected.
        by_imu: share of the samples with roll and pitch by the IMU.
    """

    def __init__(self) -> None:
        self._errors: list[Array] = []
        self._phase: list[tuple[Phase, Array, Array]] = []  # errors (2, 3) and covariance (6, 6) of one single support
        self._off: list[Array] = []
        self._nees: list[list[float]] = []
        self._by_imu = 0

    def add(self, prediction: Prediction, R: Array, rate: Array) -> None:
        """Take in a prediction and the truth."""
        trunk, phase = prediction.estimate.trunk, prediction.support.phase
        if self._phase and self._phase[-1][0] != phase:
            self._close()
        if not isfinite(trunk.R[0, 0]) or not isfinite(R[0, 0]):
            return
        encoders = rotation_vector(R, prediction.base_in_sole[:3])
        turn, fast = rotation_vector(R, trunk.R), trunk.angular_velocity - rate
        self._errors.append(np.array([turn, encoders, fast, prediction.base_in_sole[5] - rate]))
        self._by_imu += trunk.by_imu
        if phase in (Phase.LEFT, Phase.RIGHT):
            self._phase.append((phase, np.array([turn, fast]), trunk.covariance))

    def _close(self) -> None:
        if not self._phase:
            return
        _, off, P = self._phase[len(self._phase) // 2]
        self._phase = []
        self._off.append(off / np.sqrt(np.diag(P)).reshape(2, 3))
        parts = (off[0, :2], P[:2, :2]), (off[1], P[3:, 3:])
        self._nees.append([float(e @ np.linalg.solve(C, e)) for e, C in parts])

    @property
    def errors(self) -> Array:
        return np.array(self._errors).reshape(-1, 4, 3)

    @property
    def off(self) -> Array:
        self._close()
        return np.array(self._off).reshape(-1, 2, 3)

    @property
    def nees(self) -> Array:
        self._close()
        return np.array(self._nees).reshape(-1, 2)

    @property
    def by_imu(self) -> float:
        return self._by_imu / len(self._errors) if self._errors else float("nan")

    def summary(self) -> dict[str, Any]:
        """The part of `summary.json` that this knows."""
        if not self._errors:
            return {}
        rms = np.sqrt(np.nanmean(self.errors**2, axis=0))
        found: dict[str, Any] = {
            "rmse_turn_rad": by_axis(rms[0]),
            "rmse_encoder_turn_rad": by_axis(rms[1]),
            "rmse_angular_velocity_rad_s": by_axis(rms[2]),
            "rmse_encoder_angular_velocity_rad_s": by_axis(rms[3]),
        }
        if len(off := self.off):
            inside = (np.abs(off) <= NINETY).mean(axis=0)
            found["nees_tilt"], found["nees_angular_velocity"] = self.nees.mean(axis=0).tolist()
            found["turn_within_90"] = {
                name: by_axis(shares) for name, shares in zip(("turn", "angular_velocity"), inside, strict=True)
            }
        return found
