# SPDX-License-Identifier: BSD-3-Clause
"""The rotation of the trunk by the estimate, with and without the IMU, beside encoders alone and the IMU alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from bands import counted
from markdown import table
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array, ImuMessage
from coman_reduced_model.core.evaluation.consistency import SETTLED, Consistency, TrueMotion
from coman_reduced_model.core.evaluation.rotation import TrueRotation, TurnedErrors
from coman_reduced_model.core.evaluation.statistics import NINETY
from coman_reduced_model.core.robot.posture import Posture

HEAD = [
    "recording", "roll, pitch [mrad]: with the IMU", "without", "encoders alone", "IMU alone",
    "angular velocity [mrad/s]: with the IMU", "without", "encoders alone",
    "gyro alone", "NEES of roll, pitch: with the IMU", "without",
]  # fmt: skip
SETTINGS = {"prediction.reference": "none", "prediction.horizons": []}


@dataclass
class Turning:
    """Of one recording: errors with and without the IMU, and (n, 2, 3) of the IMU alone, turn and rate."""

    fused: TurnedErrors
    blind: TurnedErrors
    imu: Array


def turned(bag: str, truth: TrueMotion | None, config: str | None) -> Turning | None:
    """Errors of a recording; None: its truth does not know the rotation."""
    if truth is None or truth.rotation is None:
        return None
    found, alone = Turning(TurnedErrors(), TurnedErrors(), np.empty((0, 2, 3))), []
    with coman.Session(bag, coman.load_config(config).replaced(SETTINGS)) as session:
        predictors = [coman.Predictor(session.robot, session.config) for _ in range(2)]
        first = None
        for sample in session.samples():
            first = sample.stamp_ns if first is None else first
            made = predictors[0].update(sample), predictors[1].update(replace(sample, imu=None))
            if (sample.stamp_ns - first) * 1e-9 < SETTLED:
                continue
            known = truth.rotation.at((sample.stamp_ns - truth.first_ns) * 1e-9, made[0].support.support_foot)
            found.fused.add(made[0], *known)
            found.blind.add(made[1], *known)
            if sample.imu is not None and sample.imu.orientation is not None:
                alone.append(imu_alone(sample.imu, predictors[0].link, truth.rotation, known))
    found.imu = np.array(alone).reshape(-1, 2, 3)
    return found


def imu_alone(imu: ImuMessage, link: Posture, truth: TrueRotation, known: tuple[Array, Array]) -> Array:
    """Errors (2, 3) of roll and pitch, yaw being left out, and of the gyro, axes of the trunk."""
    frame = link.robot.sensor_frame(imu.frame_id)  # type: ignore[attr-defined]
    if frame is None or imu.orientation is None:
        return np.full((2, 3), np.nan)
    mount = link.orientation(link.robot.base_id).T @ link.orientation(frame)
    up = mount @ Rotation.from_quat(imu.orientation).as_matrix()[2]
    off = np.cross(up, known[0][2])
    off[2] = np.nan
    return np.array([off, mount @ imu.angular_velocity - known[1]])


def rows(walks: Mapping[str, Turning]) -> str:
    """The table, and what all of them show together."""
    lines = []
    for name, walk in walks.items():
        imu = rms(walk.imu[:, 0, :2]) if len(walk.imu) else ""
        gyro = rms(walk.imu[:, 1]) if len(walk.imu) else ""
        fused = walk.fused.by_imu > 0.5
        lines.append([
            name, rms(walk.fused.errors[:, 0, :2]) if fused else "no IMU", rms(walk.blind.errors[:, 0, :2]),
            rms(walk.fused.errors[:, 1, :2]), imu, rms(walk.fused.errors[:, 2]) if fused else "no IMU",
            rms(walk.blind.errors[:, 2]), rms(walk.blind.errors[:, 3]), gyro,
            nees(walk.fused) if fused else "", nees(walk.blind),
        ])  # fmt: skip
    some = [walk for walk in walks.values() if walk.fused.by_imu > 0.5]
    with_imu, without = [walk.fused for walk in some], [walk.blind for walk in walks.values()]
    said = [sentence("with the IMU", with_imu), sentence("without it", without)]
    return "\n".join([table(HEAD, lines), "", *(each for each in said if each)])


GROUND = [
    "recording", "RMS error of velocity against the ground [mm/s]", "of that by encoders alone", "NEES of it",
]  # fmt: skip


def against_ground(walks: Mapping[str, Consistency]) -> str:
    """The velocity of the COM against the ground."""
    walks = {name: walk for name, walk in walks.items() if len(walk.ground_nees)}
    if not walks:
        return ""
    lines = [
        [name, *(rms(walk.ground_errors[:, k]) for k in range(2)), f"{walk.ground_nees.mean():.1f}"]
        for name, walk in walks.items()
    ]
    median, good, below, above = counted([walk.ground_nees for walk in walks.values()])
    inside = 100.0 * (np.abs(np.concatenate([walk.ground_off for walk in walks.values()])) <= NINETY).mean(axis=0)
    said = (
        f"NEES of velocity against the ground: median {median:.1f} (3 is expected); {good} of {len(walks)} "
        f"walks in the band of their steps, {below} below, {above} above. Within its 90 % interval, x, y, z: "
        f"{', '.join(f'{each:.0f}' for each in inside)} %."
    )
    return f"{table(GROUND, lines)}\n\n{said}"


def rms(errors: Array) -> str:
    """By axis, in thousandths."""
    values = np.sqrt(np.nanmean(errors**2, axis=0)) if len(errors) else []
    return ", ".join(f"{1e3 * each:.1f}" for each in values)


def nees(found: TurnedErrors) -> str:
    """Of the steps of a walk."""
    return f"{found.nees[:, 0].mean():.1f}" if len(found.nees) else ""


def sentence(words: str, walks: list[TurnedErrors]) -> str:
    """NEES and shares within 90 % intervals of all walks."""
    walks = [walk for walk in walks if len(walk.nees)]
    if not walks:
        return ""
    n = len(walks)
    tilt = np.array([walk.nees[:, 0].mean() for walk in walks])
    off = np.concatenate([walk.off for walk in walks])
    inside = 100.0 * (np.abs(off) <= NINETY).mean(axis=0)
    median, good, below, above = counted([walk.nees[:, 1] for walk in walks])
    band = chi2.ppf([0.025, 0.975], 2 * n) / n
    turn, fast = (", ".join(f"{each:.0f}" for each in part) for part in inside)
    return (
        f"Trunk {words}, {n} walks. NEES of roll and pitch, a walk counting once: {tilt.mean():.1f} on average, median "
        f"{np.median(tilt):.1f} (2 is expected, 95 % band of the mean {band[0]:.1f} to {band[1]:.1f}). NEES of angular "
        f"velocity: median {median:.1f} (3 is expected); {good} of {n} walks in the band of their "
        f"steps, {below} below, {above} above. Within their 90 % interval: "
        f"roll, pitch, yaw {turn} %, angular velocity {fast} %."
    )
