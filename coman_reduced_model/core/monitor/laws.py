# SPDX-License-Identifier: BSD-3-Clause
"""Laws that hold on any robot, averaged over a support phase: what core/monitor/monitor.py watches.

Averaging over a phase does what a filter would do offline: the mean of a rate is the difference of the ends over the
duration, so that dampers and momentum are accounted for and nothing is differentiated; and one value a phase is nearly
white. Channels are named as in diagnose/physics/balance.py:

`spring/JOINT`    motor - link - torque / k + (d / k) rate; the torque as measured, else as ground and weight ask [rad]
`stiffness/JOINT`  the same along how far the measured torque bends the spring in the course of a phase [rad]
`torque/JOINT`    measured torque against ground and weight [Nm]
`drag/JOINT`      the same along the way of the joint: friction, or what else is missing where it goes one way [Nm]
`late/FOOT`       by how much the foot's sensor is behind the joints' torques, less where these hardly change [s]
`force/AXIS`      foot forces against weight and the COM's motion (monitor/forces.py), level, along the support sole [N]
`moment/AXIS`     foot forces about the COM, along the support sole [Nm]
`feet/z, roll, pitch`  the right sole in the frame of the left one while both stand, zero on a floor [m, rad]
`feet/slide_x, slide_y`  by how much that changes in a double support [m]
`tilt/roll, pitch`  about the axes of the support sole, taken as level: by the IMU against kinematics [rad]
`landing/z`       by how much the force of a foot's first touch goes beyond what it then bears: a blow's impulse [Ns]
`unloaded/FOOT/..`  what the sensor of a foot in the air reads [N, Nm]
`plan/x, y`       where the motors carry the COM against where com/reference plans it (`reference: motor`) [m]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..base.compiled import apply, compiled
from ..base.types import Array, Foot, Prediction, Sample
from ..config.schema import Config
from ..effects.catalogue import CATALOGUE, Effect
from .forces import WINDOW_NS, Forces

if TYPE_CHECKING:
    from ..robot.robot import Posture, Robot

# [s] after a landing until a blow is felt, then until the load is felt that the foot bears: between samples at 200 Hz.
BLOW_S, BORNE_S = 0.0125, 0.0325
RISING = 0.75  # of that load, which a force that only rises has been until then at most, in the mean
KINDS = ("left", "right", "double support after left", "double support after right", "standing")
_SPRINGS, _USUALLY = 0.05, 0.03  # shares by which springs of healthy robots differ from the data sheet
# By law: unit; usual standard deviation of a mean from phase to phase, on one foot and on both; the same from one
# healthy robot to the next (0: not known); by how much the mean usually wanders from one phase of a kind to the next,
# as a share of the first two (sensors of forces and tilt drift, gaits sway themselves in). Forces in weights, torques
# and moments in weight times COM height, impulses in mass times m/s.
_USUAL = {
    "spring": ("rad", 0.00015, 0.0003, 0.001, 0.0),
    "stiffness": ("rad", 0.0001, 0.0001, 0.0, 0.0),
    "torque": ("Nm", 0.0015, 0.0025, 0.0, 1.0),
    "force/x": ("N", 0.002, 0.01, 0.0, 1.0),
    "force/y": ("N", 0.002, 0.01, 0.0, 1.0),
    "force/z": ("N", 0.003, 0.006, 0.03, 1.0),
    "moment": ("Nm", 0.002, 0.0035, 0.0, 0.5),
    "feet/z": ("m", 0.0003, 0.0003, 0.0015, 2.0),
    "feet/roll": ("rad", 0.0007, 0.0007, 0.003, 2.0),
    "feet/pitch": ("rad", 0.0007, 0.0007, 0.003, 2.0),
    "feet": ("m", 0.0007, 0.0007, 0.0, 0.0),
    "tilt": ("rad", 0.001, 0.001, 0.0, 0.5),
    "landing": ("Ns", 0.0025, 0.0025, 0.006, 0.0),
    "unloaded/f": ("N", 0.003, 0.003, 0.015, 0.0),
    "unloaded/t": ("Nm", 0.0005, 0.0005, 0.002, 0.0),
    "plan": ("m", 0.0001, 0.0002, 0.0, 0.0),
    "drag": ("Nm", 0.0025, 0.005, 0.0, 0.0),
    "late": ("s", 0.001, 0.0015, 0.003, 0.0),
}
_WAY = 0.015  # [rad] that a joint goes in a phase, both ways together, for a drag to show
_FEWEST_LOOKS = 8  # looks at least for a stiffness or a delay to show
_RATE = 0.3  # [1/s] of weight times COM height, change of torque at which a delay counts half
_FOLLOWS = 0.5  # of the variance of what is asked of a leg: torques that are off it by more tell nothing of delays
# Bends [rad] and their rates [rad/s] of which the usual spread of a stiffness is a share: beyond that, it grows with
# them, by gains and clocks that are not perfect.
_BENT, _BENDING = 0.004, 0.05
_EDGE = 0.004  # [m] from the edge of a sole: the centre of pressure is at the edge
_FLAT = ("torque", "drag", "force", "moment", "feet", "tilt")  # laws that hold while the stance sole lies flat
_LOCAL = ("spring", "stiffness")  # laws of one spring, which another gait does not change
_GAP_S = 0.05  # between looks, after which a spring's past is not known
_NAN3 = np.full(3, np.nan)
_NAN4 = np.full(4, np.nan)
_NOT_THERE = np.full((3, 3), np.nan)
_LONGEST_NS = 2_000_000_000  # of a phase, over which forces are weighed
_NO_POSE = np.eye(4)


class Laws:
    """The mean residuals of the phase under way.

    Attributes:
        names, units: of the n channels; units are rad, m, s, N, Nm or Ns.
        noise: (kinds, n) usual standard deviation from phase to phase.
        drift: (kinds, n) by how much they usually wander from one phase of a kind to the next, standard deviation.
        any_gait: (n,) whether values of the last phase can be compared with those of another gait.
        looks: taken since `begin`.
        tipping: the last single support was on the edge of the sole: flat-sole laws say nothing until the next.
    """

    def __init__(self, robot: Robot, config: Config) -> None:
        self._robot, self._gravity, self._mass = robot, config.robot.gravity, robot.mass
        self._motors = config.prediction.reference == "motor"  # else the reference COM is the plan itself
        self._joints = np.concatenate([robot.legs[Foot.LEFT], robot.legs[Foot.RIGHT]])
        self._columns: Array = robot.idx_v  # type: ignore[assignment]
        self._split = len(robot.legs[Foot.LEFT])
        self._k = np.array(config.robot.left.stiffness + config.robot.right.stiffness)
        self._lag = np.array(config.robot.left.damping + config.robot.right.damping) / self._k
        nl = len(self._joints)
        joints = [robot.joint_names[j] for j in self._joints]
        feet = [f"unloaded/{foot}/{kind}{axis}" for foot in ("left", "right") for kind in "ft" for axis in "xyz"]
        self.names = (
            *(f"{law}/{joint}" for law in ("spring", "torque") for joint in joints),
            *(f"{law}/{axis}" for law in ("force", "moment") for axis in "xyz"),
            *("feet/z", "feet/roll", "feet/pitch", "feet/slide_x", "feet/slide_y", "tilt/roll", "tilt/pitch"),
            *(*feet, "plan/x", "plan/y", "landing/z"),
            *(f"{law}/{joint}" for law in ("drag", "stiffness") for joint in joints),
            *("late/left", "late/right"),
        )
        laws = [_usual(name) for name in self.names]
        self.units = tuple(unit for unit, *_ in laws)
        weight = self._mass * self._gravity
        scale = {"N": weight, "Nm": weight * float(robot.posture().com_in_sole(Foot.LEFT)[0][2])}
        scale["Ns"] = self._mass
        self._changing = (_RATE * scale["Nm"]) ** 2
        figures = np.array([[scale.get(unit, 1.0) * x for x in rest] for unit, *rest, _ in laws]).T
        self.noise = figures[[0, 0, 1, 1, 1]]
        self.drift = self.noise * [wander for *_, wander in laws]
        self._healthy = figures[2] ** 2
        bent = [e for e in config.effects if CATALOGUE[e.name].springs is not Effect.springs]
        at = {name: i for i, name in enumerate(self.names)}
        self._blow = at["landing/z"]
        self._force = slice(at["force/x"], at["moment/x"])
        self._local = np.array([name.split("/")[0] in _LOCAL for name in self.names])
        self.any_gait = np.zeros(len(laws), dtype=bool)
        # What an effect describes is watched for changes alone.
        if bent:
            self._healthy[:nl] = 0.0
        if any(effect.name == "touchdown_impact" for effect in config.effects):
            self._healthy[self._blow] = 0.0
        self._shows = np.ones((len(KINDS), len(laws)), dtype=bool)
        self._shows[:2, at["feet/z"] : at["tilt/roll"]] = False
        self._shows[[0, 2, 3, 4], at["unloaded/left/fx"] : at["unloaded/right/fx"]] = False
        self._shows[1:, at["unloaded/right/fx"] : at["plan/x"]] = False
        self._shows[[0, 1, 4], self._blow] = False
        self._shows[2:4, self._force] = False  # the single supports tell
        self._first_slope = at["drag/" + joints[-1]] + 1
        self._shows[4, self._first_slope :] = False
        self._shows[[1, 0], [at["late/left"], at["late/right"]]] = False
        self._flat = np.array([name.split("/")[0] in _FLAT for name in self.names])
        self._soles = np.array([robot.soles[Foot.LEFT], robot.soles[Foot.RIGHT]])
        self.forces = Forces(self._mass, self._gravity, self._soles)
        self._past, self._dragged = np.zeros((5, nl)), np.zeros((2, nl))
        self._spring, self._bent, self._behind = np.zeros((2, nl)), np.zeros((6, nl)), np.zeros((8, nl))
        self._first = self._looked = 0  # stamps of the first look of the phase, of the last one [ns]
        self._dt = 0.0  # from the look before it [s]
        self.tipping = False
        self._slide = slice(at["feet/slide_x"], at["tilt/roll"])
        rows = len(laws) + 2 * nl  # then how far torques bend springs, and where the joints are
        self._now, self._sums, self._ends = np.zeros(rows), np.zeros(rows), np.zeros((2, rows))
        self._none = np.full(len(robot.joint_names), np.nan)
        self._imu: tuple[str, int | None] = ("", robot.base_id)  # its frame: name and index
        self.begin()

    def begin(self) -> None:
        """A phase begins."""
        self.looks = 0
        self._sums[:] = self._dragged[:] = self._bent[:] = self._behind[:] = 0.0
        self._at_edge = 0  # looks at which the stance foot stood on its edge
        self._landing = np.zeros((2, 2))  # impulse [Ns] and duration [s], while a blow is felt and after it

    def look(self, sample: Sample, link: Posture, prediction: Prediction) -> None:
        """Take a look at a sample with both wrenches, the posture and the prediction made of it."""
        robot, foot, left, right = self._robot, prediction.support.support_foot, sample.left_wrench, sample.right_wrench
        assert left is not None and right is not None
        motor = self._none if sample.motor_q is None else sample.motor_q
        tau = self._none if sample.tau is None else sample.tau
        plan, sole, imu, frame = _NAN3, _NO_POSE, _NAN4, ""
        if self._motors and sample.reference is not None and sample.motor_q is not None:
            plan = sample.reference.com
            sole = sample.reference.T_odom_left if foot == Foot.LEFT else sample.reference.T_odom_right
        if sample.imu is not None and sample.imu.orientation is not None:
            imu, frame = sample.imu.orientation, sample.imu.frame_id
        if frame != self._imu[0]:
            self._imu = frame, robot.sensor_frame(frame.lstrip("/"))
        turned = _NOT_THERE if self._imu[1] is None else _turned(imu, link.orientation(self._imu[1]))
        self.forces.look(sample.stamp_ns, foot, link, left, right, turned)
        dt, before, self._looked = (sample.stamp_ns - self._looked) * 1e-9, self._dt, sample.stamp_ns
        self._first = self._first if self.looks else sample.stamp_ns
        dt = self._dt = dt if 0.0 < dt < _GAP_S else 0.0
        self._at_edge += _look(
            self._now, self._ends, self._sums, self._past, self._dragged, self._spring, self._bent,
            self._behind, self.looks, dt, before, self._soles, self._joints, self._columns, self._split,
            self._k, self._lag, sample.q, motor, tau, link.R[Foot.LEFT], link.p[Foot.LEFT], link.R[Foot.RIGHT],
            link.p[Foot.RIGHT], link.J, left, right, foot == Foot.LEFT, link.com,
            link.J_com, self._mass, self._gravity, turned[2], prediction.reference_com, plan, sole,
        )  # fmt: skip
        self.looks += 1

    def land(self, since: float, dt: float, force: float) -> None:
        """The force [N] against gravity on a foot that landed so long ago [s], below BORNE_S; dt [s] from the last."""
        self._landing[int(since > BLOW_S)] += (force * dt, dt) if dt < BLOW_S else np.nan

    def mean(self, kind: int) -> tuple[Array, Array, Array, Array]:
        """Of the looks since `begin`, in a phase of a kind.

        Returns:
            Residuals (n,), NaN where they say nothing; their variance (n,) over healthy robots, 0 where not known; what
            healthy robots' (n,) usually owe to how they are loaded, with its sign; and posture and motion of the
            joints (2 nl,) [rad], by which phases are known to be alike.
        """
        n, nl = len(self.names), len(self._joints)
        mean, way = self._sums / self.looks, self._ends[1] - self._ends[0]
        values = mean[:n].copy()
        values[:nl] += way[:nl] / (1e-9 * max(1, self._looked - self._first))
        start = min(max(self._first, self._looked - _LONGEST_NS), self._looked - WINDOW_NS)
        values[self._force] = self.forces.over(start, self._looked)
        values[self._slide] = way[self._slide]
        drag, gone = self._dragged
        first = self._first_slope
        values[first - nl : first] = np.where(gone > _WAY, drag / np.maximum(gone, _WAY), np.nan)
        values[first:] = np.nan
        if self.looks >= _FEWEST_LOOKS:
            values[first : first + nl], values[first + nl :] = self._along_the_bend(), self._delays()
        values[self._blow] = np.nan
        if self._landing[:, 1].all():
            (felt, lasted), (borne, bore) = self._landing
            values[self._blow] = max(felt - RISING * borne / bore * lasted, 0.0)
        # Without torques, what ground and weight ask for is no law for any gait; soles rock in each its own way.
        self.any_gait = self._local & np.isfinite(values[nl : 2 * nl]).all()
        self.any_gait[self._force] = self.forces.by_imu
        values[~self._shows[kind]] = np.nan
        if kind in (0, 1, 4):
            self.tipping = kind != 4 and self._at_edge > 0.5 * self.looks
        if self.tipping:
            force = values[self._force].copy()
            values[self._flat] = np.nan
            if self.forces.by_imu:
                values[self._force] = force
        healthy, loaded = self._healthy.copy(), np.zeros(n)
        loaded[:nl] = _USUALLY * mean[n : n + nl]
        if np.isfinite(values[nl : 2 * nl]).all():
            healthy[:nl] += (healthy[:nl] > 0.0) * (_SPRINGS * mean[n : n + nl]) ** 2
        else:  # what ground and weight ask for leaves out the inertia of the legs
            healthy[:nl] = 0.0
        return values, healthy, loaded, np.append(mean[n + nl :], way[n + nl :])

    def _along_the_bend(self) -> Array:
        """(nl,) [rad] of the spring law's residual as far as it goes with the bend, less where that is far or fast."""
        bend, bend_2, off, product, rate, rate_2 = self._bent / self.looks
        spread_2, rates_2 = np.maximum(bend_2 - bend**2, 1e-16), np.maximum(rate_2 - rate**2, 0.0)
        more = 1.0 + spread_2 / _BENT**2 + rates_2 / _BENDING**2
        return np.asarray((product - off * bend) / np.sqrt(spread_2 * more))

    def _delays(self) -> Array:
        """(2,) [s] by which what the foot's sensor asks of a leg is behind measured torques; less where it rests."""
        _, off, off_2, rate, rate_2, product, need, need_2 = self._behind / max(1.0, self._behind[0, 0])
        together, left, rates_2, asked = product - off * rate, off_2 - off**2, rate_2 - rate**2, need_2 - need**2
        out = np.full(2, np.nan)
        for side, leg in enumerate((slice(0, self._split), slice(self._split, None))):
            known = np.isfinite(together[leg])
            if left[leg][known].sum() < _FOLLOWS * asked[leg][known].sum():
                out[side] = together[leg][known].sum() / (rates_2[leg][known].sum() + self._changing)
        return out


def _usual(name: str) -> tuple[str, float, float, float, float]:
    law = name.split("/")[0]
    return _USUAL.get(name) or _USUAL[f"unloaded/{name[-2]}" if law == "unloaded" else law]


def _turned(imu: Array, R_imu: Array) -> Array:
    """(3, 3) of the base against the ground, by the quaternion x y z w of an IMU that sits in it as R_imu (3, 3)."""
    return np.asarray(pin.Quaternion(imu).toRotationMatrix() @ R_imu.T)


@compiled
def _look(
    x: Array, ends: Array, sums: Array, past: Array, dragged: Array, spring: Array, bent: Array, behind: Array,
    looks: int, dt: float, before: float, soles: Array, joints: Array, columns: Array, split: int,
    stiffness: Array, lag: Array, q: Array, motor: Array, tau: Array, R_l: Array, p_l: Array, R_r: Array, p_r: Array,
    J: Array, left: Array, right: Array, on_left: bool, com: Array, J_com: Array, mass: float, gravity: float,
    up: Array, moved: Array, plan: Array, sole: Array,
) -> bool:  # fmt: skip
    """Residuals now into x, what is differentiated into the row of `ends`, both into `sums`; rows as in `Laws`.

    `past` (5, nl): torque residual at the last look, joint and needed torque at the last two. `dragged` (2, nl): what
    of that residual is along the way of the joint, and how far it goes. `spring` (2, nl): what the torque alone would
    bend the spring by, and how far it is bent by it and its damper, at the last look, `dt` [s] ago (0: not known).
    `bent` (6, nl): sums of the bend, its square, the residual, its product with the bend, the bend's rate, its square.
    `behind` (8, nl): looks, and sums of the torque residual, its square, the rate of the needed torque, its square, the
    product of both, the needed torque, its square; `before` is the `dt` of the last look. `soles` (2, 4) edges of both.
    Returns whether the stance foot stands on its edge.

    Feet by rotation and position in the base frame, their wrenches in their own; J and J_com of `Posture`; `up` in the
    base frame by the IMU, or NaN; `moved` the COM by the motors in the support sole, `plan` that of com/reference in
    odom, where the sole is `sole`.
    """
    nl, n = joints.shape[0], x.shape[0] - 2 * joints.shape[0]
    end = ends[1]
    R = R_l if on_left else R_r
    f_l, t_l = apply(R_l, left[:3]), apply(R_l, left[3:])
    f_r, t_r = apply(R_r, right[:3]), apply(R_r, right[3:])
    for k in range(3):  # moments about the base origin
        a, b = (k + 1) % 3, (k + 2) % 3
        t_l[k] += p_l[a] * f_l[b] - p_l[b] * f_l[a]
        t_r[k] += p_r[a] * f_r[b] - p_r[b] * f_r[a]
    measured = False  # some drivers fill the field with zeros for lack of a sensor
    for i in range(nl):
        measured |= tau[joints[i]] != 0.0
    for i in range(nl):
        j, c = joints[i], columns[joints[i]]
        need = 0.0
        for k in range(3):
            need += mass * gravity * R[k, 2] * J_com[k, c]
            if i < split:
                need -= J[k, c] * f_l[k] + J[3 + k, c] * t_l[k]
            else:
                need -= J[k, c] * f_r[k] + J[3 + k, c] * t_r[k]
        torque, stretch = tau[j] if measured else np.nan, motor[j] - q[j]
        x[nl + i] = torque - need
        if looks > 1:
            way = 0.5 * (q[j] - past[2, i])  # around the last look
            dragged[0, i] += past[0, i] * way
            dragged[1, i] += abs(way)
            if dt > 0.0 and before > 0.0:
                change = (need - past[4, i]) / (dt + before)  # around the last look: its noise is not in it
                behind[0, i] += 1.0
                behind[1, i] += past[0, i]
                behind[2, i] += past[0, i] * past[0, i]
                behind[3, i] += change
                behind[4, i] += change * change
                behind[5, i] += past[0, i] * change
                behind[6, i] += past[3, i]
                behind[7, i] += past[3, i] * past[3, i]
        past[0, i], past[2, i], past[1, i] = x[nl + i], past[1, i], q[j]
        past[4, i], past[3, i] = past[3, i], need
        x[n + i] = (need if np.isnan(torque) else torque) / stiffness[i]
        x[i] = stretch - x[n + i]
        alone = torque / stiffness[i]
        bend, rate = alone, 0.0
        if dt > 0.0 and not np.isnan(spring[1, i]):  # exact for torques that are linear between looks
            kept = np.exp(-dt / lag[i]) if lag[i] > 0.0 else 0.0
            late = lag[i] * (1.0 - kept) / dt
            bend = kept * spring[1, i] + (1.0 - late) * alone + (late - kept) * spring[0, i]
            rate = (bend - spring[1, i]) / dt
        spring[0, i], spring[1, i], off = alone, bend, stretch - bend
        bent[0, i] += bend
        bent[1, i] += bend * bend
        bent[2, i] += off
        bent[3, i] += bend * off
        bent[4, i] += rate
        bent[5, i] += rate * rate
        end[i] = lag[i] * stretch
        x[n + nl + i] = end[n + nl + i] = q[j] if np.isnan(motor[j]) else motor[j]
    m = 2 * nl
    force, moment = f_l + f_r, t_l + t_r
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        moment[k] -= com[a] * force[b] - com[b] * force[a]
    gap = apply(R_l.T, p_r - p_l)
    moment = apply(R.T, moment)
    for k in range(3):
        x[m + 3 + k] = moment[k]
    r = apply(R_r.T, R_l[:, 2])
    x[m + 6], x[m + 7], x[m + 8] = gap[2], np.arctan2(r[1], r[2]), -np.arcsin(min(1.0, max(-1.0, r[0])))
    for k in range(2):
        x[m + 9 + k], end[m + 9 + k] = 0.0, gap[k]
    x[m + 11], x[m + 12] = (R[:, 1] * up).sum(), -(R[:, 0] * up).sum()
    for k in range(6):
        x[m + 13 + k], x[m + 19 + k] = left[k], right[k]
    for k in range(2):
        planned = 0.0
        for i in range(3):
            planned += sole[i, k] * (plan[i] - sole[i, 3])
        x[m + 25 + k] = moved[k] - planned
    for i in range(x.shape[0]):
        sums[i] += x[i]
        if looks == 0:
            ends[0, i] = end[i]
    stance, edges = (left, soles[0]) if on_left else (right, soles[1])
    load = max(stance[2], 0.01 * mass * gravity)
    at_x, at_y = -stance[4] / load, stance[3] / load
    inside_x = edges[0] + _EDGE <= at_x <= edges[1] - _EDGE
    return not (inside_x and edges[2] + _EDGE <= at_y <= edges[3] - _EDGE)
