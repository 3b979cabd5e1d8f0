# SPDX-License-Identifier: BSD-3-Clause
"""Joint springs and dampers: stiffness from loads (7), damping from them where it shows, or from free oscillations.

*Load* bags: tau = k x + d x' + tau_0 with the deflection x = motor - link, over changing torques: slow ones, or a walk.
*Decay* bags: the robot stands on one leg of which one joint is soft, the others locked, and swings free after pushes:
an inverted pendulum about that joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import periodogram

from ..core.base.types import Array, Foot, Phase
from ..core.config.schema import Config
from ..core.robot.robot import Robot
from ..errors import BagError
from .recording import JoinedBag
from .statistics import hac_covariance, quantile

_EDGE = 0.015  # [s] to either side of the edges of blocks: means over it
_BLOCK = 0.1  # [s] means over it: quantisation and noise average out, quasi-static loads do not change
_LATE = 0.0005  # [s] by which torques and encoders may be apart in time: it looks like k times as much damping
_LOOSE = 0.2  # an interval wider than this share of its value to either side says: not excited
_COUNTS = 20  # a link encoder that passes fewer counts shows its steps, not the spring
_SHOWN = "damping from"
_QUIET = 0.15
_PAUSE = 1.0  # [s] from which on the time between samples is none in which springs are watched
_STANDING = 0.9  # of the time on one foot makes a bag a decay bag


@dataclass(frozen=True)
class Estimate:
    """A figure with its interval (95 %)."""

    value: float
    low: float
    high: float

    @property
    def loose(self) -> bool:
        """Whether the interval is too wide for the value to mean anything."""
        width = max(self.high - self.value, self.value - self.low)
        return not (self.low > 0.0 and width <= _LOOSE * abs(self.value))


@dataclass(frozen=True)
class Joint:
    """What is known of one joint; None: not excited, and `note` says why."""

    name: str
    stiffness: Estimate | None = None  # [Nm/rad]
    damping: Estimate | None = None  # [Nms/rad]
    note: str = ""


def identify(recordings: Sequence[JoinedBag], config: Config) -> list[Joint]:
    """Stiffness and damping of the leg joints, hip to ankle, left leg first.

    Args:
        recordings: load and decay bags of one robot, in any order; what a bag is follows from the feet that carry.
        config: of the robot; its stiffness is that of joints without a load bag.

    Raises:
        BagError: a bag shows nothing of the springs, and why.
    """
    decays = [(r, foot) for r in recordings for foot in [_standing_on(r)] if foot != Foot.NONE]
    loads = [r for r in recordings if all(r is not decay for decay, _ in decays)]
    for recording in recordings:
        if recording.samples[0].motor_q is None and all(s.motor_q is None for s in recording.samples):
            raise BagError(f"{recording.bag}: no motor-side positions: the deflection of the springs is not known")
    legs = config.robot.left.joints + config.robot.right.joints
    joints = {name: Joint(name, note="no load bag") for name in legs}
    if loads:
        joints = {name: _stiffness(name, loads) for name in legs}
    shown: dict[str, Estimate] = {}
    for recording, foot in decays:
        joint = _damping(recording, foot, joints)
        found, best = joint.damping if joint.note.startswith(_SHOWN) else None, shown.get(joint.name)
        if best is not None and (found is None or best.high - best.low <= found.high - found.low):
            continue  # another bag shows it better
        joints[joint.name] = joint
        if found is not None:
            shown[joint.name] = found
    return list(joints.values())


def identified_config(config: Config, joints: Sequence[Joint]) -> Config:
    """The configuration with what was identified; the other constants stay."""
    found = {joint.name: joint for joint in joints}
    changes: dict[str, Any] = {}
    for side, leg in (("left", config.robot.left), ("right", config.robot.right)):
        for kind in ("stiffness", "damping"):
            known = [getattr(found[name], kind) for name in leg.joints]
            old = getattr(leg, kind)
            values = [
                nominal if estimate is None else estimate.value for estimate, nominal in zip(known, old, strict=True)
            ]
            changes[f"robot.{side}.{kind}"] = [float(f"{value:.6g}") for value in values]
    return config.replaced(changes, "identified")


def _standing_on(recording: JoinedBag) -> Foot:
    if not recording.samples:
        raise BagError(f"{recording.bag}: no usable sample")
    phases = np.array([p.support.phase for p in recording.predictions])
    for foot, phase in ((Foot.LEFT, Phase.LEFT), (Foot.RIGHT, Phase.RIGHT)):
        if np.mean(phases == phase) > _STANDING:
            return foot
    return Foot.NONE


def _spring(recording: JoinedBag, index: int) -> tuple[Array, Array, Array, Array]:
    """Time [s], link position, deflection [rad] and torque [Nm] of a joint, where all are known; torque may be NaN."""
    samples = [s for s in recording.samples if s.motor_q is not None]
    steps = np.diff([s.stamp_ns for s in samples]) * 1e-9
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    # A pause, or a clock that is set, takes as long as any other step.
    t = np.concatenate(([0.0], np.cumsum(np.where((steps > 0.0) & (steps < _PAUSE), steps, usual))))
    q = np.array([s.q[index] for s in samples])
    motor = np.array([s.motor_q[index] for s in samples])  # type: ignore[index]
    tau = np.array([np.nan if s.tau is None else s.tau[index] for s in samples])
    return t, q, motor - q, tau


def _stiffness(name: str, loads: Sequence[JoinedBag]) -> Joint:
    """(7) by least squares over means of blocks, deflection on torque; damping where its interval is narrow enough.

    Torque on deflection would come out too soft: the noise of the encoder, which is a large part of a stiff joint's
    deflection, would be taken for deflection. The rate of the deflection is fitted beside it, for no load is quite
    static. Every bag has its own offset.
    """
    columns, deflections, groups, without = [], [], [], []
    counts = 0.0
    for number, recording in enumerate(loads):
        t, q, deflection, tau = _spring(recording, recording.robot.joint_names.index(name))
        known = np.isfinite(tau)
        if known.sum() < 50:
            without.append(recording.bag.name)
            continue
        t, q, deflection, tau = t[known], q[known], deflection[known], tau[known]
        steps = np.abs(np.diff(q))
        counts = max(counts, np.ptp(q) / max(steps[steps > 1e-9].min(initial=np.inf), 1e-9))
        dt = float(np.median(np.diff(t)))
        begin = t[0] - 0.5 * dt  # a sample stands for the time from half a period before to half a period after
        block = ((t - begin) / _BLOCK).astype(int)
        size = np.bincount(block)
        full = size > 0.5 * np.median(size)
        mean = [np.bincount(block, values)[full] / size[full] for values in (deflection, tau)]
        # From edge to edge of a block: like the means, this loses nothing of what changes within it.
        smooth = uniform_filter1d(deflection, 1 + 2 * round(_EDGE / dt))
        rate = (np.diff(np.interp(begin + _BLOCK * np.arange(len(size) + 1), t, smooth)) / _BLOCK)[full]
        columns.append(np.column_stack([_centred(mean[1]), _centred(rate)]))
        deflections.append(_centred(mean[0]))
        groups.append(np.full(len(rate), number))
    if not groups:
        return Joint(name, note=f"no torque in {', '.join(without)}")
    if counts < _COUNTS:
        return Joint(name, note=f"not excited: its link encoder passed {counts:.0f} counts, {_COUNTS} needed")
    A, y = np.concatenate(columns), np.concatenate(deflections)
    x, *_ = np.linalg.lstsq(A, y, rcond=None)
    lags = int(np.ceil(1.5 * len(y) ** (1.0 / 3.0)))
    covariance, wide = hac_covariance(A, y - A @ x, lags, np.concatenate(groups)), quantile(len(y) / lags)
    half = wide * np.sqrt(covariance[0, 0])
    if not x[0] - half > 0.0:
        return Joint(name, note="not excited: the torque hardly changes")
    stiffness = Estimate(1.0 / x[0], 1.0 / (x[0] + half), 1.0 / (x[0] - half))
    if stiffness.loose:
        return Joint(name, note=f"not excited: {stiffness.low:.0f} to {stiffness.high:.0f} Nm/rad is all that is known")
    # x = (1 / k, -d / k)
    value, by_x = -x[1] / x[0], np.array([x[1] / x[0], -1.0]) / x[0]
    half = wide * np.sqrt(by_x @ covariance @ by_x) + _LATE * stiffness.value
    damping = Estimate(value, value - half, value + half)
    return Joint(name, stiffness, None if damping.loose else damping)


def _centred(values: Array) -> Array:
    return values - values.mean()


def _damping(recording: JoinedBag, foot: Foot, joints: dict[str, Joint]) -> Joint:
    """Decay of the pendulum I q'' + d q' + (k + G) q = 0 about the joint of the support leg that swings most.

    I and G (inertia and the stiffness of gravity, negative for an inverted pendulum) come from the URDF. The floor
    and the other joints yield a little, so that the spring seems softer than a load bag says, by a factor c. If what
    yields carries the inertia, d seems smaller by c; if it is in series with the spring (k + i omega d), by c^2. The
    value is midway, and the interval of the mean over the pushes is widened to both.
    """
    robot = recording.robot
    leg = [robot.joint_names[i] for i in robot.legs[foot]]
    series = {name: _spring(recording, robot.joint_names.index(name)) for name in leg}
    name = max(leg, key=lambda n: float(np.std(series[n][2])))
    t, _, deflection, _ = series[name]
    decays = np.array([fit_decay(*part) for part in free_oscillations(t, deflection)]).reshape(-1, 2)
    if len(decays) < 3:
        return replace(joints[name], note=f"damping: {len(decays)} free oscillations in {recording.bag.name}, 3 needed")
    inertia, gravity = pendulum(robot, recording, foot, name)
    stiffness = inertia * (decays**2).sum(axis=1) - gravity
    damping = 2.0 * decays[:, 0] * inertia
    known, correction = joints[name].stiffness, 1.0
    if known is not None:
        correction = known.value / float(np.mean(stiffness))
    scale = correction**1.5
    value = scale * float(np.mean(damping))
    half = scale * quantile(len(damping) - 1) * float(np.std(damping, ddof=1)) / np.sqrt(len(damping))
    half += abs(np.sqrt(correction) - 1.0) * value
    estimate = Estimate(value, value - half, value + half)
    note = f"{_SHOWN} {len(decays)} oscillations, "
    note += f"{100.0 * (scale - 1.0):+.1f} % for floor and other joints" if known else "inertia of the URDF"
    if estimate.loose:
        return replace(joints[name], note=f"damping not excited: {estimate.low:.2f} to {estimate.high:.2f} Nms/rad")
    return replace(joints[name], damping=estimate, note=note)


def free_oscillations(t: Array, x: Array) -> list[tuple[Array, Array]]:
    """Times (n,) [s] and values (n,) of stretches in which something swings free, from a half period after a push."""
    dt = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], dt)
    x = np.interp(grid, t, x)
    x = x - np.median(x)
    frequency, power = periodogram(x, 1.0 / dt)
    use = (frequency > 0.3) & (frequency < 15.0)
    if not use.any():
        return []
    period = 1.0 / float(frequency[use][np.argmax(power[use])])
    n = max(int(period / dt), 2)
    envelope = np.array([np.abs(x[max(0, i - n // 2) : i + n // 2 + 1]).max() for i in range(len(x))])
    level = 0.35 * np.percentile(envelope, 99.0)
    # A push: the largest value within two periods before and after that stands out.
    reach = 2 * n
    peaks = [
        i
        for i in range(len(x))
        if abs(x[i]) >= level and abs(x[i]) == np.abs(x[max(0, i - reach) : i + reach + 1]).max()
    ]
    peaks = [i for k, i in enumerate(peaks) if k == 0 or i - peaks[k - 1] > reach]
    found = []
    for k, peak in enumerate(peaks):
        first = peak + n // 2
        last = (peaks[k + 1] if k + 1 < len(peaks) else len(x) + n) - n
        quiet = np.flatnonzero(envelope[first:last] < _QUIET * abs(x[peak]))
        if len(quiet):
            last = first + max(int(quiet[0]), 2 * n)
        if last - first >= 2 * n and envelope[min(last, len(x)) - 1] < 0.5 * envelope[first]:
            found.append((grid[first : min(last, len(x))], x[first : min(last, len(x))]))
    return found


def fit_decay(t: Array, x: Array) -> tuple[float, float]:
    """sigma, omega [rad/s] of x = e^(-sigma t) (A cos omega t + B sin omega t) + C by variable projection."""
    t = t - t[0]

    def residual(p: Array) -> Array:
        fall = np.exp(-p[0] * t)
        A = np.column_stack([fall * np.cos(p[1] * t), fall * np.sin(p[1] * t), np.ones_like(t)])
        return A @ np.linalg.lstsq(A, x, rcond=None)[0] - x

    # The error has a valley at every wrong frequency: start in the deepest one.
    starts = [(sigma, omega) for omega in np.geomspace(2.0, 60.0, 60) for sigma in (0.1 * omega, 0.25 * omega)]
    start = min(starts, key=lambda p: float(np.sum(residual(np.array(p)) ** 2)))
    found = least_squares(residual, start, x_scale=(0.1 * start[1], start[1]))
    return float(found.x[0]), float(found.x[1])


def pendulum(robot: Robot, recording: JoinedBag, foot: Foot, joint: str) -> tuple[float, float]:
    """Inertia [kg m^2] about a joint of all that a standing leg carries, and gravity's stiffness [Nm/rad] there."""
    q = pin.neutral(robot.model)
    data = robot.model.createData()
    mean = np.mean([s.q for s in recording.samples], axis=0)
    robot.scatter(mean, q)
    index = robot.joint_names.index(joint)
    v = np.zeros(robot.model.nv)
    v[robot.idx_v[index]] = 1.0
    # The trunk moves so that the sole stands still.
    J = pin.computeFrameJacobian(robot.model, data, q, robot.sole_ids[foot], pin.LOCAL)
    v[:6] = -np.linalg.solve(J[:, :6], J[:, robot.idx_v[index]])
    inertia = 2.0 * pin.computeKineticEnergy(robot.model, data, q, v)
    posture, step = robot.posture(), 1e-3
    heights = []
    for offset in (-step, 0.0, step):
        turned = mean.copy()
        turned[index] += offset
        posture.update(turned, np.zeros_like(turned))
        heights.append(float(posture.com_in_sole(foot)[0][2]))
    curvature = (heights[0] - 2.0 * heights[1] + heights[2]) / step**2
    return float(inertia), float(robot.mass * robot.config.gravity * curvature)
