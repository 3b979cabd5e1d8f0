# SPDX-License-Identifier: BSD-3-Clause
"""External force on the robot, from the balance of forces over a time window.

The residual force is foot forces + weight - m a; an external force is its negative. Weighted with a window w(t) that
vanishes with its slope at both ends, integration by parts gives `int w F dt + m int w' dc` of foot forces and weight F
and the displacement c of the COM, so no measurement is differentiated. (1 - s^2)^2 is the window that amplifies white
position noise least. Forces count at each sample, as those of a robot that shakes change from one to the next; the
posture does at each look.

The displacement of the COM is taken against the point of the ground under the centre of pressure, which is at rest even
while the foot rocks on its edge; the two feet are weighted by their loads. The inclination of the base comes from an
IMU that has proved reliable; otherwise the loaded soles are taken as level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.compiled import Record, Records, apply, compiled
from ..base.types import Array, Foot

_CAPACITY = 256  # looks in memory
WINDOW_NS = 300_000_000  # shortest window: noise dominates over a shorter one
_GAP_S = 0.05  # longest time between two looks over which a displacement is known
_MIN_LOAD = 0.01  # of the weight: smallest load in the quotient for a centre of pressure
_MIN_TOTAL = 0.05  # of the weight: with less on both feet, the robot is in the air
# Time that an IMU must be there at every look before it is used, and be missing before it is dropped [ns].
_ACCEPT_NS, _DROP_NS = 1_000_000_000, 10_000_000_000
_UPRIGHT = 0.9  # cosine of the sole's inclination by the IMU: below it, mounting is wrong or the robot falls


class Feet(NamedTuple):
    """Both soles and the COM in the base frame, and the wrenches on the soles in sole axes, about the sole origins."""

    R_left: Array  # (3, 3)
    p_left: Array  # (3,) [m]
    R_right: Array
    p_right: Array
    com: Array  # (3,) [m]
    left: Array  # (6,) [N, Nm]
    right: Array


# A step from one look to the next.
STEP = np.dtype(
    [
        ("middle", np.float64),  # middle of the interval [s]
        ("dt", np.float64),  # [s]
        ("force", np.float64, 3),  # mean foot force + weight, level axes [N]
        ("displacement", np.float64, 3),  # of the COM against the ground, level axes [m]
    ]
)
# One foot at a look, level axes.
FOOT = np.dtype(
    [
        ("com", np.float64, 3),  # COM against the origin of the sole [m]
        ("axes", np.float64, (3, 3)),  # axes of the sole, one a row
        ("cop", np.float64, 2),  # centre of pressure in the sole frame [m]
        ("share", np.float64),  # of the load
    ]
)


BALANCE = np.dtype(
    [
        ("count", np.int64),  # of the looks in a row
        ("last_ns", np.int64),  # of the last look
        ("imu_since_ns", np.int64),  # first look of those in a row with an IMU
        ("imu_last_ns", np.int64),  # last look with it
        ("heading", np.float64),  # of the x axis of the stored vectors, in the support sole frame [rad]
        ("felt_ns", np.int64),  # of the last sample
        ("felt", np.float64, (2, 3)),  # force on each foot then, sole axes [N]
        ("impulse", np.float64, (2, 3)),  # on each foot since the last look [Ns]
        ("on_left", np.bool_),  # the support foot at the last look
        ("uses_imu", np.bool_),
    ],
    align=True,
)


class BalanceMemory(NamedTuple):
    """What the balance of forces remembers."""

    state: Records  # (1,) of BALANCE
    steps: Records  # of STEP, a ring
    feet: Records  # (2,) of FOOT at the last look
    soles: Array  # (2, 4) edges of the left and the right sole [m]
    weight: float  # of the robot [N]


class ForceBalance:
    """Residual force of a robot over the last seconds.

    Attributes:
        memory: for `take_wrenches` and `take_forces`, which compiled code may call in place of `feel` and `look`.
    """

    def __init__(self, mass: float, gravity: float, soles: Array) -> None:
        """Mass [kg], gravity [m/s^2], and edges (2, 4) of the left and the right sole [m]."""
        self._mass = mass
        state, steps, feet = np.zeros(1, dtype=BALANCE), np.zeros(_CAPACITY, dtype=STEP), np.zeros(2, dtype=FOOT)
        self.memory = BalanceMemory(state, steps, feet, soles, mass * gravity)
        self._state = state[0]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        state = self._state
        for field in ("count", "last_ns", "imu_since_ns", "imu_last_ns", "heading", "felt_ns", "impulse"):
            state[field] = 0
        state["on_left"], state["uses_imu"] = True, False

    @property
    def uses_imu(self) -> bool:
        """Whether the inclination of the base comes from an IMU."""
        return bool(self._state["uses_imu"])

    @property
    def heading(self) -> float:
        """Direction of the x axis of the stored vectors, in the support sole frame [rad]."""
        return float(self._state["heading"])

    def feel(self, stamp_ns: int, left: Array, right: Array) -> None:
        """Take the wrenches (6,) on both feet, as in `Feet`, of a sample between two looks."""
        take_wrenches(self.memory, stamp_ns, left, right)

    def look(self, stamp_ns: int, foot: Foot, feet: Feet, R_ground_base: Array) -> None:
        """Take one sample.

        Args:
            stamp_ns: its stamp.
            foot: the support foot.
            feet: posture and wrenches.
            R_ground_base: (3, 3) rotation of the base against the ground by an IMU, or NaN.
        """
        take_forces(self.memory, stamp_ns, foot == Foot.LEFT, feet, R_ground_base)

    def residual(self, start_ns: int, end_ns: int) -> Array:
        """Residual force (3,) [N] between two stamps: z up, x along that of the support sole.

        An external force is its negative. NaN where the looks do not cover the window.
        """
        count = min(int(self._state["count"]), _CAPACITY)
        steps, start, end = self.memory.steps, start_ns * 1e-9, end_ns * 1e-9
        return _weighted_residual(steps, count, start, end, self._mass, self.heading)


@compiled
def take_wrenches(memory: BalanceMemory, stamp: int, left: Array, right: Array) -> None:
    """`ForceBalance.feel`; stamp in ns."""
    state = memory.state[0]
    dt = (stamp - state.felt_ns) * 1e-9
    state.felt_ns = stamp
    for k in range(3):
        for foot in range(2):
            now = left[k] if foot == 0 else right[k]
            if 0.0 < dt < _GAP_S:
                state.impulse[foot, k] += 0.5 * (state.felt[foot, k] + now) * dt
            state.felt[foot, k] = now


@compiled
def take_forces(memory: BalanceMemory, stamp: int, on_left: bool, feet: Feet, R_ground_base: Array) -> None:
    """`ForceBalance.look`; stamp in ns."""
    state = memory.state[0]
    take_wrenches(memory, stamp, feet.left, feet.right)
    dt = (stamp - state.last_ns) * 1e-9
    state.last_ns = stamp
    continuous = 0.0 < dt < _GAP_S
    R = feet.R_left if on_left else feet.R_right
    usable = bool((R_ground_base[2] * R[:, 2]).sum() > _UPRIGHT)
    uses_imu = _choose_imu(state, stamp, usable, continuous)
    if not continuous or uses_imu != state.uses_imu:
        state.count, state.heading, state.on_left, state.uses_imu = 0, 0.0, on_left, uses_imu
    if on_left != state.on_left:
        state.heading = _heading_in(state.heading, feet.R_left if state.on_left else feet.R_right, R)
        state.on_left = on_left
    level = np.full((3, 3), np.nan)
    if usable:
        level[:] = R_ground_base
    at = state.count % _CAPACITY
    step = memory.steps[at : at + 1]
    mean = np.empty((2, 3))
    for foot in range(2):
        for k in range(3):
            mean[foot, k] = state.impulse[foot, k] / dt if continuous else state.felt[foot, k]
            state.impulse[foot, k] = 0.0
    state.heading = _add_step(
        step, memory.feet, mean, state.heading, R, feet, level, uses_imu, memory.soles, memory.weight
    )
    step[0].middle, step[0].dt = stamp * 1e-9 - 0.5 * dt, dt
    if state.count == 0:  # no look before it
        step[0].middle = step[0].dt = np.nan
    state.count += 1


@compiled
def _choose_imu(state: Record, stamp: int, usable: bool, continuous: bool) -> bool:
    """Whether to use the IMU from now on."""
    if not (usable and continuous and state.imu_since_ns != 0):
        state.imu_since_ns = stamp if usable else 0
    if usable:
        state.imu_last_ns = stamp
    if state.uses_imu:
        return bool(stamp - state.imu_last_ns < _DROP_NS)
    return bool(usable and stamp - state.imu_since_ns >= _ACCEPT_NS)


@compiled
def _heading_in(heading: float, R_before: Array, R: Array) -> float:
    """A heading in the frame of one sole, expressed in that of another."""
    x = np.cos(heading) * R_before[:, 0] + np.sin(heading) * R_before[:, 1]
    return float(np.arctan2((R[:, 1] * x).sum(), (R[:, 0] * x).sum()))


@compiled
def _add_step(
    step: Records,
    feet_before: Records,
    mean: Array,
    heading: float,
    R: Array,
    feet: Feet,
    R_ground_base: Array,
    uses_imu: bool,
    soles: Array,
    weight: float,
) -> float:
    """Write mean force and displacement since the last look into `step` (1,), and this look into `feet_before`.

    Mean (2, 3) [N]: force on each foot since then, sole axes. R is that of the support sole.

    Returns:
        The heading.
    """
    load_left, load_right = max(feet.left[2], 0.0), max(feet.right[2], 0.0)
    total = load_left + load_right
    share = load_left / total if total > _MIN_TOTAL * weight else np.nan
    if uses_imu:
        level = R_ground_base
        heading = np.arctan2((R[:, 1] * level[0]).sum(), (R[:, 0] * level[0]).sum())
    else:
        level = _level_by_soles(share * feet.R_left[:, 2] + (1.0 - share) * feet.R_right[:, 2], R, heading)
    force = apply(level, apply(feet.R_left, mean[0]) + apply(feet.R_right, mean[1]))
    force[2] -= weight
    from_left, from_right = feet.com - feet.p_left, feet.com - feet.p_right
    left = _foot_displacement(feet_before[0], level, from_left, feet.R_left, feet.left, soles[0], weight, share)
    right = _foot_displacement(
        feet_before[1], level, from_right, feet.R_right, feet.right, soles[1], weight, 1.0 - share
    )
    for k in range(3):
        step[0].force[k] = force[k]
        step[0].displacement[k] = left[k] + right[k]
    return float(heading)


@compiled
def _level_by_soles(up: Array, R: Array, heading: float) -> Array:
    """Level axes (3, 3), one a row, in the base frame: z along `up`, x along the heading in the sole R."""
    level = np.empty((3, 3))
    z = up / np.sqrt((up * up).sum())
    x = np.cos(heading) * R[:, 0] + np.sin(heading) * R[:, 1]
    x -= (x * z).sum() * z
    x /= np.sqrt((x * x).sum())
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        level[0, k], level[1, k], level[2, k] = x[k], z[a] * x[b] - z[b] * x[a], z[k]
    return level


@compiled
def _foot_displacement(
    before: Record,
    level: Array,
    com: Array,
    R: Array,
    wrench: Array,
    edges: Array,
    weight: float,
    share: float,
) -> Array:
    """Displacement (3,) of the COM against the ground under one foot, times the share of the load; updates `before`.

    Args:
        before: `FOOT` at the last look.
        level: (3, 3) level axes in the base frame, one a row.
        com: (3,) against the origin of the sole, base frame [m].
        R: (3, 3) orientation of the sole in the base frame.
        wrench: (6,) on the sole [N, Nm].
        edges: (4,) of the sole [m].
        weight: of the robot [N].
        share: of the load.
    """
    load = max(wrench[2], _MIN_LOAD * weight)
    cop = np.empty(2)
    cop[0] = min(max(-wrench[4] / load, edges[0]), edges[1])
    cop[1] = min(max(wrench[3] / load, edges[2]), edges[3])
    displacement = np.empty(3)
    for i in range(3):
        now = level[i, 0] * com[0] + level[i, 1] * com[1] + level[i, 2] * com[2]
        displacement[i], before.com[i] = now - before.com[i], now
        for k in range(3):
            axis = level[i, 0] * R[0, k] + level[i, 1] * R[1, k] + level[i, 2] * R[2, k]
            if k < 2:  # less the displacement of the sole at the centre of pressure
                displacement[i] -= (axis - before.axes[k, i]) * 0.5 * (cop[k] + before.cop[k])
            before.axes[k, i] = axis
        displacement[i] *= 0.5 * (share + before.share)
    before.cop[0], before.cop[1], before.share = cop[0], cop[1], share
    return displacement


@compiled
def _weighted_residual(steps: Records, count: int, start: float, end: float, mass: float, heading: float) -> Array:
    """`ForceBalance.residual` of the first `count` steps; times in s."""
    half, covered, force = 0.5 * (end - start), 0.0, np.zeros(3)
    for i in range(count):
        step = steps[i]
        s = (step.middle - start) / half - 1.0
        if abs(s) < 1.0:
            w, slope = 0.9375 * (1.0 - s * s) ** 2 / half, -3.75 * s * (1.0 - s * s) / half**2
            covered += step.dt
            for k in range(3):
                force[k] += w * step.dt * step.force[k] + mass * slope * step.displacement[k]
    if not covered > 1.8 * half:
        return np.full(3, np.nan)
    return about_vertical(force, heading)


@compiled
def about_vertical(v: Array, angle: float) -> Array:
    """A vector (3,) turned by an angle [rad] about z."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * v[0] - sin * v[1], sin * v[0] + cos * v[1], v[2]])
