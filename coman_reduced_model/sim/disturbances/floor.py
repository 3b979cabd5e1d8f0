# SPDX-License-Identifier: BSD-3-Clause
"""Floor and contact: soft, sloping, slippery, hit hard; and a constant pull."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from ...core.base.parameter import par
from ...core.base.types import Array
from ..contact import raised
from ..describe import foot_box
from ..robot_table import SIDES, RobotTable
from ..sensors import Signals, cross
from .base import Disturbance, feet, foot_body, take_mass

_RELAXATION = 0.005  # [s] damping over stiffness of what gives way: rubber and foam, not a trampoline
# [kg, kg m^2] against motion between foot and plate, slow while the foot bears and none while it swings: MuJoCo makes
# contacts of light bodies soft, and on a plate of 0.1 kg alone the robot would bounce.
_SLIDE_INERTIA, _HINGE_INERTIA = 1.0, 0.005


def plate_body(foot: int) -> str:
    """Name of the plate below a foot."""
    return f"{SIDES[foot][1]}plate"


def _plate(spec: mujoco.MjSpec, table: RobotTable, foot: int) -> mujoco.MjsBody:
    """A thin plate below a foot that touches the floor in its stead, a fifth of the foot's mass.

    Joints between foot and plate are what lies between the sole of the URDF and the rigid floor.
    """
    name, body = plate_body(foot), spec.body(foot_body(foot))
    if (plate := spec.body(name)) is not None:
        return plate
    sole = next(f.pos for f in body.sites if f.name.endswith("sole"))
    mass = 0.2 * body.mass
    take_mass(body, mass, sole)
    plate = body.add_body(name=name, pos=sole)
    (length, width, height), centre = foot_box(table)
    plate.explicitinertial, plate.mass, plate.ipos = True, mass, [0.0, 0.0, 0.0]
    # Not quite flat: where one inertia is exactly the sum of the others, rounding may make it impossible.
    plate.inertia = mass / 12.0 * np.array([width**2, length**2, 0.999 * (length**2 + width**2)])
    rigid = next(g for g in body.geoms if g.name == foot_body(foot))
    geom = plate.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=rigid.size,
        pos=np.asarray(centre) - sole,
        friction=rigid.friction,
        solref=rigid.solref,
        solimp=rigid.solimp,
        condim=rigid.condim,
    )
    geom.rgba = rigid.rgba
    rigid.contype = rigid.conaffinity = 0
    return plate


@dataclass
class GroundCompliance(Disturbance):
    """Floor or sole gives way under each foot: springs in z and about x and y between foot and rigid floor."""

    name: ClassVar[str] = "ground_compliance"
    vertical: float = par(0.0, "m/N", "of one foot", 0.0, 1e-3)
    rotational: float = par(0.0, "rad/Nm", "of one foot, about x and y", 0.0, 0.1)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        for foot in (0, 1):
            plate = _plate(spec, table, foot)
            for kind, axis, compliance in (
                (slide, [0.0, 0.0, 1.0], self.vertical),
                (hinge, [1.0, 0.0, 0.0], self.rotational),
                (hinge, [0.0, 1.0, 0.0], self.rotational),
            ):
                if compliance > 0.0:
                    joint = plate.add_joint(type=kind, axis=axis)
                    joint.stiffness[0], joint.damping[0] = 1.0 / compliance, _RELAXATION / compliance
                    joint.armature = _SLIDE_INERTIA if kind == slide else _HINGE_INERTIA


@dataclass
class GroundSlope(Disturbance):
    """A plane floor that is not level: Ry(pitch) Rx(roll) turns the level axes into the floor's.

    Downhill ahead for pitch > 0, downhill to the right for roll > 0. The truth's world stays that of the floor; the
    IMU gives the orientation against gravity, as it must.
    """

    name: ClassVar[str] = "ground_slope"
    roll: float = par(0.0, "rad", "about x", -0.3, 0.3)
    pitch: float = par(0.0, "rad", "about y", -0.3, 0.3)

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        turn = Rotation.from_euler("xyz", [self.roll, self.pitch, 0.0])  # two slopes add up
        spec.option.gravity = turn.inv().apply(spec.option.gravity)
        self._quaternion = turn.as_quat().tolist()  # x y z w

    def sense(self, t: float, signals: Signals) -> None:
        """See Disturbance."""
        a, b, c, w = self._quaternion
        x, y, z, v = signals.orientation
        signals.orientation = np.array(
            [w * x + a * v + b * z - c * y, w * y - a * z + b * v + c * x, w * z + a * y - b * x + c * v,
             w * v - a * x - b * y - c * z]
        )  # fmt: skip


@dataclass
class ExternalForce(Disturbance):
    """A constant pull at the trunk's centre of mass, along the axes of the world."""

    name: ClassVar[str] = "external_force"
    x: float = par(0.0, "N", "force", -1e3, 1e3)
    y: float = par(0.0, "N", "force", -1e3, 1e3)

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._trunk = model.body("base_link").id

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        data.xfrc_applied[self._trunk, :2] += self.x, self.y


class _Landings:
    """Where a foot is in its step, by the height of its sole above the floor."""

    HIGH = 0.012  # [m] higher: surely swinging

    def __init__(self, model: mujoco.MjModel, where: str, low: float = 0.002) -> None:
        """Args: model; the feet; below which height the sole has come down [m]."""
        tiles, self._raised = raised(model)
        self._low = low + tiles
        self._soles = {foot: model.site(f"{SIDES[foot][1]}sole").id for foot in feet(where)}
        self.since = dict.fromkeys(self._soles, np.inf)  # [s] time of the last landing; inf: swings, or never swung
        self._high = dict.fromkeys(self._soles, False)

    def __call__(self, t: float, data: mujoco.MjData) -> Iterator[tuple[int, float]]:
        """Each foot, and how long ago it came down [s]; negative while it has not."""
        for foot, sole in self._soles.items():
            x, y, height = data.site_xpos[sole]
            for low, high in self._raised:
                if low[0] < x < high[0] and low[1] < y < high[1]:
                    height -= high[2]
            if height > self.HIGH:
                self._high[foot], self.since[foot] = True, np.inf
            elif self._high[foot] and height < self._low:
                self._high[foot], self.since[foot] = False, t
            yield foot, t - self.since[foot]


_SLIDES = {  # begin, length [s] after landing
    "smooth": (0.05, 0.15),
    "late": (0.12, 0.3),
    "sudden": (0.1, 0.03),
    "creep": (0.0, 0.5),
}


@dataclass
class FootSlip(Disturbance):
    """A foot that bears slides back along its own x axis in each step, from 0.05 to 0.2 s after it came down.

    Its plate on the floor stays, driven against the foot by `distance`, and goes back under the lifted foot. Other
    forms: `late` (0.12 to 0.42 s, slower and slower), `sudden` (0.1 to 0.13 s), `creep` (steadily for 0.5 s).
    """

    name: ClassVar[str] = "foot_slip"
    where: str = par("", "", "left or right foot; empty: both")
    distance: float = par(0.0, "m", "backwards, in each step", -0.1, 0.1)
    form: str = par("smooth", "", "when it slides", choices=tuple(_SLIDES))

    def edit_model(self, spec: mujoco.MjSpec, table: RobotTable) -> None:
        """See Disturbance."""
        for foot in feet(self.where):
            joint = _plate(spec, table, foot).add_joint(
                name=f"{plate_body(foot)}_slip", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0]
            )
            joint.stiffness[0], joint.damping[0], joint.armature = 5e5, 5e3, _SLIDE_INERTIA

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._landings = _Landings(model, self.where)
        self._target = {foot: int(model.joint(f"{plate_body(foot)}_slip").qposadr[0]) for foot in feet(self.where)}
        model.qpos_spring[list(self._target.values())] = 0.0
        self._rate = abs(self.distance) / 0.1 * model.opt.timestep

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        for foot, since in self._landings(t, data):
            at = self._target[foot]
            if since >= 0.0:
                begin, length = _SLIDES[self.form]
                s = min(max((since - begin) / length, 0.0), 1.0)
                model.qpos_spring[at] = self.distance * self._share(s)
            else:
                now = model.qpos_spring[at]
                model.qpos_spring[at] = now - np.clip(now, -self._rate, self._rate)

    def _share(self, s: float) -> float:
        """Of the distance, by the share of the time."""
        if self.form == "late":
            return s * (2.0 - s)
        return s if self.form == "creep" else s * s * (3.0 - 2.0 * s)


@dataclass
class TouchdownImpact(Disturbance):
    """A hard floor: each landing brings `impulse` more than the planned soft one, upwards along the leg.

    A half sine of 10 ms from when the falling sole is 1 mm above the floor; or `decay`: it falls off from the first
    instant, with 8 ms; or `double`: two half sines with a pause, heel and toe. For so short a blow the motors hold the
    leg stiff: the force acts on the trunk at the hip, and the foot's sensor, through which it came, feels it on the
    line from ankle to hip. So forces and moments balance.
    """

    name: ClassVar[str] = "touchdown_impact"
    impulse: float = par(0.0, "Ns", "upwards, at each landing", 0.0, 20.0)
    form: str = par("half_sine", "", "of the force over time", choices=("half_sine", "decay", "double"))
    DURATION: ClassVar[float] = 0.01  # [s] of a half sine

    def start(self, table: RobotTable, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """See Disturbance."""
        self._landings = _Landings(model, "", 0.001)
        self._trunk = model.body("base_link").id
        self._feet = [model.body(foot_body(foot)).id for foot in (0, 1)]
        self._hips = [model.body(f"{SIDES[foot][1]}hip").id for foot in (0, 1)]
        self._soles = [model.site(f"{SIDES[foot][1]}sole").id for foot in (0, 1)]
        self._force = np.zeros((2, 3))

    def apply(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """See Disturbance."""
        self._force[:] = 0.0
        for foot, since in self._landings(t, data):
            if (share := self._share(since)) > 0.0:
                hip = data.xpos[self._hips[foot]]
                leg = hip - data.xpos[self._feet[foot]]
                self._force[foot] = self.impulse * share * leg / np.linalg.norm(leg)
                data.xfrc_applied[self._trunk, :3] += self._force[foot]
                data.xfrc_applied[self._trunk, 3:] += cross(hip - data.xipos[self._trunk], self._force[foot])

    def _share(self, since: float) -> float:
        """Of the impulse, by time [1/s], since the landing [s]."""
        if self.form == "decay":
            return float(np.exp(-since / 0.008) / 0.008) if 0.0 <= since < 0.05 else 0.0
        if self.form == "double":
            return 0.5 * (self._half_sine(since) + self._half_sine(since - 2.0 * self.DURATION))
        return self._half_sine(since)

    def _half_sine(self, since: float) -> float:
        inside = 0.0 <= since < self.DURATION
        return float(np.pi / (2.0 * self.DURATION) * np.sin(np.pi * since / self.DURATION)) if inside else 0.0

    def bear(self, foot: int, data: mujoco.MjData) -> Array:
        """See Disturbance."""
        sole = self._soles[foot]
        moment = cross(data.xpos[self._feet[foot]] - data.site_xpos[sole], self._force[foot])
        R = data.site_xmat[sole].reshape(3, 3)
        return np.concatenate([self._force[foot] @ R, moment @ R])
