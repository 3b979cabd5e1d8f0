# SPDX-License-Identifier: BSD-3-Clause
"""What a configuration says of a robot, written into a MuJoCo model (MJCF) of it.

The model is the user's own: only what the configuration knows is changed. A series spring is a position actuator, as in
`sim/describe.py`: its force is k (ctrl - q) - d q', so that ctrl = motor + (d / k) motor' makes it the spring between
motor and link.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from .core.base.types import Array
from .core.config.schema import LEGS, Config
from .core.effects.base import EffectConfig
from .core.effects.catalogue import CATALOGUE
from .core.robot.configuration import LegConfig
from .errors import ConfigError

_IMPEDANCE = 0.9  # of contacts that are written, at any depth: so the stiffness is one figure
_POINTS = {mujoco.mjtGeom.mjGEOM_BOX: 4, mujoco.mjtGeom.mjGEOM_MESH: 4, mujoco.mjtGeom.mjGEOM_CAPSULE: 2}  # of contact
_WRITTEN: tuple[str, ...] = ("joint_stiffness", "joint_damping", "motor_compliance", "joint_friction")
_WRITTEN += ("payload", "com_offset", "body_mass", "motor_lag", "ground_compliance")
# Why an effect is left out of the file.
_LEFT_OUT = {
    "hysteresis": "a position actuator has no lost motion",
    "stiffness_drift": "the file has one stiffness; export another one for the warm robot by joint_stiffness",
    "spring_nonlinearity": "a position actuator is a linear spring",
    "backlash": "MuJoCo has no play in a joint; a second joint in series would be another model",
    "ground_slope": "it is of the floor, not of the robot: tilt option.gravity or the floor",
    "external_force": "apply it at run time (xfrc_applied)",
    "touchdown_impact": "the contact of the simulation has an impact of its own",
    "foot_slip": "the contact of the simulation slips by its own friction",
}
_OF_SENSORS = "it is of sensors or their clocks, not of the robot"


@dataclass
class Exported:
    """A changed model and what was done.

    Attributes:
        xml: the model.
        written: what is in it now, a line each.
        left_out: what is not, and why.
    """

    xml: str
    written: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def export_mjcf(config: Config, mjcf: str | Path, folder: str | Path | None = None) -> Exported:
    """Write the effects that MuJoCo can express into a model.

    Args:
        config: joints of the legs named; frames and joints are bodies and joints of the model.
        mjcf: file of the model; nothing is written to it.
        folder: for the changed model, from which it finds meshes and textures; default: that of the model.

    Raises:
        ConfigError: the file is no MJCF, or lacks a joint or the trunk of the configuration.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(mjcf))
        model = spec.compile()
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise ConfigError(f"{mjcf}: is not a model that MuJoCo can read: {error}") from None
    there = "." if folder is None else os.path.relpath(Path(mjcf).parent, folder)
    return _Export(config, spec, model, str(mjcf)).done(there)


class _Export:
    """One export, in the order of its methods."""

    def __init__(self, config: Config, spec: mujoco.MjSpec, model: mujoco.MjModel, source: str) -> None:
        self._config, self._spec, self._model, self._source = config, spec, model, source
        self._out = Exported("")
        self._legs: dict[str, LegConfig] = {side: getattr(config.robot, side) for side in LEGS}

    def done(self, there: str) -> Exported:
        """The changed model, for a folder from which `there` is that of its meshes and textures."""
        for leg in self._legs.values():
            if not leg.joints:
                raise ConfigError(f"{self._source}: robot.*.joints: not named: --urdf FILE shows the chains")
            for joint in leg.joints:
                if self._spec.joint(joint) is None:
                    known = ", ".join(each.name for each in self._spec.joints if each.name)
                    raise ConfigError(f"{self._source}: no joint {joint!r} (robot.*.joints); there are: {known[:300]}")
        self._springs()
        self._friction()
        self._masses()
        self._lag()
        self._contacts()
        for name in self._config.active:
            if name not in _WRITTEN:
                self._out.left_out.append(f"{name}: {_LEFT_OUT.get(name, _OF_SENSORS)}")
        self._out.left_out.append("armature: the model has no inertia of motors; keep that of your file")
        self._spec.compile()
        self._out.xml = self._spec.to_xml()
        files = {
            "meshdir": (*self._spec.meshes, *self._spec.hfields, *self._spec.skins),
            "texturedir": self._spec.textures,
        }
        if there != "." and any(each.file for some in files.values() for each in some):
            root = ElementTree.fromstring(self._out.xml)  # to_xml looks for them where the model was read
            compiler = root.find("compiler")
            assert compiler is not None
            for key in files:
                compiler.set(key, Path(there, compiler.get(key, "")).as_posix())
            self._out.xml = ElementTree.tostring(root, encoding="unicode")
        return self._out

    def _effects(self, *names: str) -> Iterator[EffectConfig]:
        """In the order in which they act, which is that of the catalogue."""
        found = (effect for effect in self._config.effects if effect.name in names)
        return iter(sorted(found, key=lambda effect: list(CATALOGUE).index(effect.name)))

    def _acts_on(self, effect: EffectConfig, side: str, joint: str) -> bool:
        return effect.where in ("", side, joint)

    def _springs(self) -> None:
        for side, leg in self._legs.items():
            for joint, stiffness, damping in zip(leg.joints, leg.stiffness, leg.damping, strict=True):
                k, d = stiffness, damping
                for effect in self._effects("joint_stiffness", "joint_damping", "motor_compliance"):
                    if effect.name == "motor_compliance":  # in series with the spring
                        share = 1.0 / (1.0 + effect.values["compliance"] * k)
                        k, d = k * share, d * share * share
                    elif self._acts_on(effect, side, joint):
                        scale = effect.values["scale"]
                        k, d = (k * scale, d) if effect.name == "joint_stiffness" else (k, d * scale)
                if (actuator := self._spring_of(joint)) is not None:
                    actuator.gainprm[0] = k
                    actuator.biasprm[:3] = [0.0, -k, -d]
                    self._out.written.append(f"{joint}: stiffness {k:.4g} Nm/rad, damping {d:.4g} Nms/rad (actuator)")

    def _spring_of(self, joint: str) -> mujoco.MjsActuator | None:
        """The position actuator of a joint, made if it has none; None where another one moves it."""
        found = [each for each in self._spec.actuators if each.target == joint]
        if not found:
            taken = any(each.name == joint for each in self._spec.actuators)
            name = f"{joint}_spring" if taken else joint
            made = self._spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            made.gaintype, made.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
            self._out.written.append(f"{joint}: a position actuator, for it had none")
            return made
        if len(found) == 1 and _is_position(found[0]):
            found[0].gear[:] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
            return found[0]
        self._out.left_out.append(f"{joint}: stiffness and damping: its actuator is no position actuator")
        return None

    def _friction(self) -> None:
        for side, leg in self._legs.items():
            for joint in leg.joints:
                mine = [e for e in self._effects("joint_friction") if self._acts_on(e, side, joint)]
                if mine:
                    coulomb = sum(effect.values["coulomb"] for effect in mine)
                    target = self._spec.joint(joint)
                    target.frictionloss = float(np.ravel(target.frictionloss)[0]) + coulomb
                    self._out.written.append(f"{joint}: dry friction {coulomb:.4g} Nm (frictionloss)")

    def _masses(self) -> None:
        """Mass and COM of each body that an effect changes."""
        changes: dict[int, tuple[mujoco.MjsBody, list[EffectConfig]]] = {}
        for effect in self._effects("payload", "com_offset", "body_mass"):
            body = self._body(effect.where if effect.name == "body_mass" else "")
            changes.setdefault(body.id, (body, []))[1].append(effect)
            if effect.name == "com_offset":  # with all that is fixed to it
                shift = np.array([effect.values[axis] for axis in "xyz"])
                for child, R in self._welded(body, np.eye(3)):
                    values = dict(zip("xyz", (R.T @ shift).tolist(), strict=True))
                    changes.setdefault(child.id, (child, []))[1].append(replace(effect, values=values))
        for body, effects in changes.values():
            massless = not self._model.body_mass[body.id] and all(each.name == "com_offset" for each in effects)
            if not massless:
                self._loaded(body, effects)
            welded = [child.name or "a body without name" for child in body.bodies if not child.joints]
            if welded and any(effect.name == "body_mass" for effect in effects):
                self._out.left_out.append(f"body_mass: {', '.join(welded)}: fixed to {body.name!r}, keeps its mass")

    def _body(self, joint: str) -> mujoco.MjsBody:
        """That moves with a joint; "": the trunk. It may have no name."""
        if joint:
            if (found := self._spec.joint(joint)) is None:
                raise ConfigError(f"{self._source}: no joint {joint!r} (effects.body_mass.where)")
            return found.parent
        if (body := self._spec.body(self._config.robot.base_frame)) is None:
            raise ConfigError(f"{self._source}: no body {self._config.robot.base_frame!r} (robot.base_frame)")
        return body

    def _welded(self, body: mujoco.MjsBody, R: Array) -> Iterator[tuple[mujoco.MjsBody, Array]]:
        """Bodies with a mass that are fixed to a body, and their axes (3, 3) in its; R (3, 3): axes of the body."""
        for child in body.bodies:
            if not child.joints:
                turn = np.empty(9)
                mujoco.mju_quat2Mat(turn, self._model.body_quat[child.id])
                if self._model.body_mass[child.id] > 0.0:
                    yield child, R @ turn.reshape(3, 3)
                yield from self._welded(child, R @ turn.reshape(3, 3))

    def _loaded(self, body: mujoco.MjsBody, effects: Sequence[EffectConfig]) -> None:
        i = body.id
        mass, com = float(self._model.body_mass[i]), self._model.body_ipos[i].copy()
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, self._model.body_iquat[i])
        R = turn.reshape(3, 3)
        inertia = R @ np.diag(self._model.body_inertia[i]) @ R.T  # about the COM
        for effect in effects:
            if effect.name == "body_mass":
                mass, inertia = mass * effect.values["scale"], inertia * effect.values["scale"]
                continue
            at = np.array([effect.values[axis] for axis in "xyz"])
            if effect.name == "com_offset":
                com += at
                continue
            extra = effect.values["mass"]
            whole = mass + extra
            if not whole > 0.0:
                raise ConfigError(f"effects.payload.mass: leaves {body.name!r} a mass of {whole:g} kg")
            new = (mass * com + extra * at) / whole
            inertia += mass * _parallel(com - new) + extra * _parallel(at - new)
            mass, com = whole, new
        body.explicitinertial, body.mass, body.ipos = True, mass, com
        xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
        body.fullinertia = [xx, yy, zz, xy, xz, yz]
        body.iquat = [1.0, 0.0, 0.0, 0.0]
        body.inertia = [0.0, 0.0, 0.0]
        where = ", ".join(f"{value:.4g}" for value in com)
        self._out.written.append(f"{body.name}: mass {mass:.4g} kg, COM at {where} m")

    def _lag(self) -> None:
        lag = sum(effect.values["time_constant"] for effect in self._effects("motor_lag"))
        if not lag > 0.0:
            return
        for joint in (joint for leg in self._legs.values() for joint in leg.joints):
            for actuator in self._spec.actuators:
                if actuator.target == joint and actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE:
                    actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
                    actuator.dynprm[0] = lag
        self._out.written.append(f"motors: lag of {1e3 * lag:.3g} ms (actuator filter: set data.act at the start)")

    def _contacts(self) -> None:
        friction = self._config.model.friction
        for side, leg in self._legs.items():
            feet = [e for e in self._effects("ground_compliance") if e.where in ("", side)]
            softer = sum(effect.values["vertical"] for effect in feet)
            if any(effect.values["rotational"] for effect in feet):
                self._out.left_out.append(
                    f"ground_compliance: rotational, {side}: follows from the vertical one and the size of the sole"
                )
            changes = friction != type(self._config.model).friction
            if softer > 0.0 or changes:
                self._touching(leg.joints[-1], softer, friction if changes else None)

    def _touching(self, ankle: str, softer: float, friction: float | None) -> None:
        """Friction of the sole below a joint, and how much it gives way [m/N] under the robot's weight."""
        below = {body.id for body in _below(self._spec.joint(ankle).parent)}
        geoms = [g for g in self._spec.geoms if g.parent.id in below and (g.contype or g.conaffinity)]
        points = sum(_POINTS.get(geom.type, 1) for geom in geoms)
        mass = float(self._model.body_subtreemass[0])
        for geom in geoms:
            geom.priority = 1  # over the floor's, with which MuJoCo would mix it
            if friction is not None:
                geom.friction[0] = friction
            if (
                softer > 0.0
            ):  # a point of contact is a spring of -solref[0] / ((1 - d) invweight) [N/m], flat on the floor
                weight = float(self._model.body_invweight0[geom.parent.id, 0])
                rate = (1.0 - _IMPEDANCE) * weight / (points * softer)
                geom.solimp[:3] = [_IMPEDANCE, _IMPEDANCE, 0.001]
                geom.solref[:] = [-rate, -rate * 2.0 * np.sqrt(mass * softer)]  # critical, with the robot on it
        if not geoms:
            self._out.left_out.append(f"contact below {ankle}: no geom that touches")
        elif softer > 0.0:
            self._out.written.append(f"contact below {ankle}: gives way by {1e6 * softer:.3g} mm/kN (solref, solimp)")
        if geoms and friction is not None:
            self._out.written.append(f"contact below {ankle}: friction {friction:g}")


def _below(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    yield body
    for child in body.bodies:
        yield from _below(child)


def _is_position(actuator: mujoco.MjsActuator) -> bool:
    """Whether it pulls towards a position; a servo of velocity has an affine bias, too."""
    affine = actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and actuator.gainprm[0] == -actuator.biasprm[1] != 0.0)


def _parallel(r: Array) -> Array:
    """Inertia (3, 3) of a unit mass at r (3,)."""
    return float(r @ r) * np.eye(3) - np.outer(r, r)
