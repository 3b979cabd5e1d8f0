# SPDX-License-Identifier: BSD-3-Clause
"""Whether the covariances of the estimate are as large as its errors.

By the innovations (NIS), which need no truth, and by the truth of a virtual robot (NEES), that a file beside its bag
holds. Both are 3 on average if all is as assumed. Errors of consecutive samples are alike, so that one sample a step
enters NEES, and the NIS that has a band: the middle of each single support. The error of the position is nearly the
same at each of them, by zeros of encoders and masses, so that a walk counts once for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ..base.types import Array, Estimate, Flags, Foot, Integers, Phase, Prediction
from .rotation import TrueRotation, TurnedErrors
from .statistics import LEVELS, NINETY, QUANTILES, beside, by_axis

SETTLED = 2.0  # [s] that are left out at the beginning


@dataclass(frozen=True)
class TrueMotion:
    """COM of a virtual robot over time, by support foot, in the frame of its sole, which moves with the foot.

    Attributes:
        first_ns: stamp at time 0.
        time: (n,) [s].
        com, com_vel: by foot (n, 3) [m], and its derivative [m/s].
        ground_vel: by foot (n, 3) velocity against the ground, in the axes of the sole [m/s].
        rotation: of the root link; None: not known.
    """

    first_ns: int
    time: Array
    com: dict[Foot, Array]
    com_vel: dict[Foot, Array]
    ground_vel: dict[Foot, Array]
    rotation: TrueRotation | None = None

    @classmethod
    def of(
        cls, stamp_ns: Integers, com: Array, poses: dict[Foot, Array], trunk: tuple[Array, Array] | None = None
    ) -> TrueMotion:
        """From the COM (n, 3) [m] and the poses (n, 4, 4) of both soles in the world.

        trunk: orientations (n, 4) x y z w of the root link in the world, and gravity (3,) in it [m/s^2].
        """
        t = (stamp_ns - stamp_ns[0]) * 1e-9
        places = {
            foot: np.einsum("nji,nj->ni", T[:, :3, :3].astype(float), com.astype(float) - T[:, :3, 3])
            for foot, T in poses.items()
        }
        speeds = {foot: np.gradient(place, t, axis=0) for foot, place in places.items()}
        in_world = np.gradient(com.astype(float), t, axis=0)
        ground = {foot: np.einsum("nji,nj->ni", T[:, :3, :3].astype(float), in_world) for foot, T in poses.items()}
        turned = None
        if trunk is not None:
            turned = TrueRotation.of(t, *trunk, {foot: T[:, :3, 0] for foot, T in poses.items()})
        return cls(int(stamp_ns[0]), t, places, speeds, ground, turned)

    def at(self, stamp_ns: int, foot: Foot) -> tuple[Array, Array]:
        """COM (3,) [m] and its velocity (3,) [m/s] at a stamp."""
        com, vel = self._between(stamp_ns, foot, (self.com, self.com_vel))
        return com, vel

    def ground_vel_at(self, stamp_ns: int, foot: Foot) -> Array:
        """Velocity (3,) [m/s] against the ground at a stamp."""
        return self._between(stamp_ns, foot, (self.ground_vel,))[0]

    def _between(self, stamp_ns: int, foot: Foot, parts: tuple[dict[Foot, Array], ...]) -> list[Array]:
        k, w = beside(self.time, (stamp_ns - self.first_ns) * 1e-9)
        return [(1.0 - w) * values[foot][k - 1] + w * values[foot][k] for values in parts]


class Consistency:
    """NIS of a run and, where its truth is known, NEES and how often errors are within intervals.

    Attributes:
        off: (n, 2, 3) errors of position and velocity in their standard deviations, at the middles of steps.
        nees: (n, 2) of position and velocity, there.
        nis: (n,) there; also without a truth.
        errors: (n, 2, 3) [m/s] of the velocity: of the estimate, and of encoders alone, at all samples.
        ground_errors: (n, 2, 3) [m/s] the same of the velocity against the ground.
        ground_off, ground_nees: (n, 3), (n,) of that velocity, at the middles of steps.
        position_errors: (n, 2, 3) [m] the same of the position.
        turned: errors of the trunk's rotation; None: its truth is not known.
    """

    def __init__(self, truth: TrueMotion | None = None) -> None:
        self._truth = truth
        self.turned = TurnedErrors() if truth is not None and truth.rotation is not None else None
        self._first: int | None = None
        self._sum_of_nis, self._samples, self._lost = 0.0, 0, 0
        self._trunks, self._by_imu = 0, 0
        self._phase = Phase.FLIGHT
        self._single: list[Prediction] = []  # of one single support; without a truth only their NIS
        self._nis_of_single: list[float] = []
        self._off: list[Array] = []
        self._nees: list[list[float]] = []
        self._nis: list[float] = []
        self._errors: list[list[Array]] = []
        self._position_errors: list[list[Array]] = []
        self._ground_errors: list[list[Array]] = []
        self._ground: list[tuple[Array, float]] = []

    def add(self, prediction: Prediction) -> None:
        """Take in the next one."""
        if self._first is None:
            self._first = prediction.stamp_ns
        estimate = prediction.estimate
        if (prediction.stamp_ns - self._first) * 1e-9 < SETTLED:
            return
        if self.turned is not None and self._truth is not None and self._truth.rotation is not None:
            t = (prediction.stamp_ns - self._truth.first_ns) * 1e-9
            self.turned.add(prediction, *self._truth.rotation.at(t, prediction.support.support_foot))
        if isfinite(estimate.trunk.R[0, 0]):
            self._trunks += 1
            self._by_imu += estimate.trunk.by_imu
        if not isfinite(estimate.nis):
            return
        self._sum_of_nis += estimate.nis
        self._samples += 1
        self._lost += bool(prediction.flags & Flags.INCONSISTENT)
        if self._truth is not None:
            com, velocity = self._truth.at(prediction.stamp_ns, prediction.support.support_foot)
            self._position_errors.append([estimate.com - com, prediction.measured_com - com])
            if isfinite(estimate.ground_vel[0]):
                ground = self._truth.ground_vel_at(prediction.stamp_ns, prediction.support.support_foot)
                self._ground_errors.append([estimate.ground_vel - ground, prediction.measured_com_vel - ground])
            self._errors.append([estimate.com_vel - velocity, prediction.measured_com_vel - velocity])
        if self._phase != prediction.support.phase:
            self._close()
        self._phase = prediction.support.phase
        if self._phase in (Phase.LEFT, Phase.RIGHT):
            self._nis_of_single.append(estimate.nis)
            if self._truth is not None:
                self._single.append(prediction)

    def _close(self) -> None:
        """The phase has ended: its middle counts."""
        single, nis = self._single, self._nis_of_single
        self._single, self._nis_of_single = [], []
        if nis:
            self._nis.append(nis[len(nis) // 2])
        if not single or self._truth is None:
            return
        middle = single[len(single) // 2]
        estimate = middle.estimate
        off = errors_of(estimate, *self._truth.at(middle.stamp_ns, middle.support.support_foot))
        P, C = estimate.covariance, estimate.ground_vel_covariance
        if isfinite(estimate.ground_vel[0]):
            ground = estimate.ground_vel - self._truth.ground_vel_at(middle.stamp_ns, middle.support.support_foot)
            self._ground.append((ground / np.sqrt(np.diag(C)), float(ground @ np.linalg.solve(C, ground))))
        self._nees.append([float(e @ np.linalg.solve(P[s, s], e)) for e, s in zip(off, PARTS, strict=True)])
        self._off.append(off / np.sqrt(np.diag(P)).reshape(2, 3))

    @property
    def off(self) -> Array:
        return np.array(self._off).reshape(-1, 2, 3)

    @property
    def nees(self) -> Array:
        return np.array(self._nees).reshape(-1, 2)

    @property
    def nis(self) -> Array:
        self._close()
        return np.array(self._nis)

    @property
    def errors(self) -> Array:
        return np.array(self._errors).reshape(-1, 2, 3)

    @property
    def ground_errors(self) -> Array:
        return np.array(self._ground_errors).reshape(-1, 2, 3)

    @property
    def ground_off(self) -> Array:
        self._close()
        return np.array([off for off, _ in self._ground]).reshape(-1, 3)

    @property
    def ground_nees(self) -> Array:
        self._close()
        return np.array([nees for _, nees in self._ground])

    @property
    def position_errors(self) -> Array:
        return np.array(self._position_errors).reshape(-1, 2, 3)

    def summary(self) -> dict[str, Any]:
        """The part of `summary.json` that this knows; NaN where nothing was judged."""
        self._close()
        samples = self._samples or np.nan
        found: dict[str, Any] = {"nis": self._sum_of_nis / samples, "inconsistent": self._lost / samples}
        if self._trunks:
            found["tilt_by_imu"] = self._by_imu / self._trunks
        if self.turned is not None:
            found |= self.turned.summary()
        if self._truth is None or not self._off:
            return found
        position, velocity = self.nees.mean(axis=0).tolist()
        rms = np.sqrt((self.errors**2).mean(axis=0))
        if self._ground:
            ground = np.sqrt((self.ground_errors**2).mean(axis=0))
            found |= {
                "nees_ground_velocity": float(self.ground_nees.mean()),
                "ground_velocity_within_90": by_axis((np.abs(self.ground_off) <= NINETY).mean(axis=0)),
                "rmse_ground_velocity_m_s": by_axis(ground[0]),
                "rmse_encoder_ground_velocity_m_s": by_axis(ground[1]),
            }
        return {
            **found,
            "steps": len(self._off),
            "nees_position": position,
            "nees_velocity": velocity,
            "within_90": dict(zip(("position", "velocity"), map(by_axis, within(self.off)), strict=True)),
            "rmse_velocity_m_s": by_axis(rms[0]),
            "rmse_encoder_velocity_m_s": by_axis(rms[1]),
            "reliability": {
                name: dict(zip(map(str, LEVELS), reliability(self.off[:, k]), strict=True))
                for k, name in enumerate(("position", "velocity"))
            },
        }


PARTS = slice(0, 3), slice(3, 6)  # position and velocity in a covariance


def errors_of(estimate: Estimate, com: Array, com_vel: Array) -> Array:
    """Errors (2, 3) of position [m] and velocity [m/s]."""
    return np.array([estimate.com - com, estimate.com_vel - com_vel])


def within(off: Array) -> Array:
    """Shares (2, 3) of errors (n, 2, 3), in standard deviations, that are within their 90 % interval."""
    shares: Array = (np.abs(off) <= NINETY).mean(axis=0)
    return shares


def reliability(off: Array) -> list[float]:
    """By `LEVELS`, the share of errors (n, 3), in standard deviations, that are within the interval of that level."""
    return [float((np.abs(off) <= each).mean()) for each in QUANTILES]
