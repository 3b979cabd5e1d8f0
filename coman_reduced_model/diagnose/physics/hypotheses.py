# SPDX-License-Identifier: BSD-3-Clause
"""What could differ from the nominal robot in a recording: the unknowns of all effects, and of nominal scatter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...core.base.nominal import Nominal, load_nominal
from ...core.base.types import Foot, Integers
from ...core.effects.body_mass import LIGHTEST, scaled
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.com_offset import lever_plus
from ...core.effects.unknown import LINKS, PLAN, About, Change, Unknown, columns_minus, world_plus
from ...core.effects.wrench_bias import wrench_minus
from ..data.computed import not_shown
from ..data.recording import WRENCH, Recording
from ..data.world import World

SIDES = {"left": Foot.LEFT, "right": Foot.RIGHT}
# Only the order of the unknowns, that results are the same to the last digit. Those of one line alternate from place to
# place; an effect that is not named comes last.
_ORDER = (
    ("joint_stiffness", "joint_damping", "encoder_bias"),
    ("spring_nonlinearity", "backlash", "joint_friction", "hysteresis", "stiffness_drift"),
    ("transport_delay", "motor_lag"),
    ("motor_compliance",),
    ("payload",),
    ("com_offset",),
    ("body_mass",),
    ("wrench_scale", "wrench_delay", "wrench_bias"),
    ("sensor_rotation",),
    ("encoder_delay",),
    ("ground_slope",),
    ("external_force",),
    ("foot_slip",),
    ("touchdown_impact",),
    ("ground_compliance",),
)
_LINE = {effect: (line, k) for line, effects in enumerate(_ORDER) for k, effect in enumerate(effects)}


@dataclass(frozen=True)
class Candidate:
    """An effect at a place: the unknowns that are let go together."""

    effect: str
    where: str
    unknowns: tuple[int, ...]  # indices into the list of unknowns

    @property
    def place(self) -> str:
        """`where` as in the configuration."""
        return "" if self.where in (PLAN, LINKS) else self.where

    @property
    def name(self) -> str:
        return f"{self.effect}@{self.where}" if self.where else self.effect


def unknowns(recording: Recording, world: World, nominal: Nominal | None = None) -> list[Unknown]:
    """All unknowns that this recording could say something about, with the widths of `nominal` (default: shipped)."""
    nominal = nominal or load_nominal()
    joints = len(world.robot.joint_names)
    about = About(
        world.robot,
        world.gravity,
        motors=recording.motor_q is not None,
        efforts=recording.tau is not None,
        plan=recording.plan is not None,
        stretch=np.array([_stretch(recording, world, j) for j in range(joints)]),
        count=recording.count,
        nominal=nominal,
    )
    places = {where: i for i, where in enumerate((*about.joints_and_legs, PLAN, LINKS))}
    last = len(_ORDER), 0

    def order(unknown: Unknown) -> tuple[int, int, int]:
        line, k = _LINE.get(unknown.effect, last)
        return line, places.get(unknown.where, len(places)), k

    hidden = not_shown(about.efforts) if recording.computed else ()
    shown = [effect for name, effect in CATALOGUE.items() if name not in hidden]
    found = sorted((each for effect in shown for each in effect.unknowns(about)), key=order)
    scatter: dict[str, list[Unknown]] = {}
    for beside, each in _scatter(recording, about):
        scatter.setdefault(beside, []).append(each)
    for beside, several in scatter.items():
        last_one = max((i for i, other in enumerate(found) if other.name.startswith(beside)), default=len(found) - 1)
        found[last_one + 1 : last_one + 1] = several
    return [_of_this_robot(each, nominal) for each in found]


def _of_this_robot(unknown: Unknown, nominal: Nominal) -> Unknown:
    """What is usual, and varies, on a robot of which recordings are known in which nothing is wrong."""
    if unknown.name not in nominal.parameters:
        return unknown
    usual, spread = nominal.parameters[unknown.name]
    return replace(unknown, usual=usual, spread=spread, precise=None)


def candidates(known: list[Unknown]) -> list[Candidate]:
    """Unknowns of the same effect at the same place, released together."""
    places: dict[tuple[str, str], list[int]] = {}
    for i, unknown in enumerate(known):
        if unknown.effect and unknown.offered:
            places.setdefault((unknown.effect, unknown.where), []).append(i)
    out = []
    for (effect, where), indices in places.items():
        together = CATALOGUE[effect].together if effect in CATALOGUE else ()
        if together:
            groups = [tuple(i for i in indices if known[i].key in keys) for keys in together]
        else:  # a pull along x needs no unknown for y: what is not needed counts against an effect
            alone = [(i,) for i in indices if not known[i].shape]
            groups = [tuple(indices), *(alone if len(indices) > 1 else ())]
        out += [Candidate(effect, where, group) for group in groups]
    return out


def _scatter(recording: Recording, about: About) -> Iterator[tuple[str, Unknown]]:
    """What differs among nominal robots without being an effect, each beside an unknown whose name begins so."""
    if about.efforts:
        for joint, j in about.joints.items():
            yield (
                f"joint_friction@{joint}.",
                _zero(about, joint, "torque_zero", "Nm", columns_minus("tau", j), "torque_zero", times=about.edge),
            )
            gain = _of_robot(about, joint, "torque_gain", "1", _gain(j), "torque_gain")
            yield f"joint_friction@{joint}.", replace(gain, step=0.02)
    if about.motors:
        if about.plan:
            for stance, foot in SIDES.items():
                for k, axis in enumerate("xy"):
                    yield "motor_lag@plan.", _zero(about, stance, f"lead_{axis}", "m", _lead(foot, k), "lead")
            yield "motor_compliance@.", _zero(about, "motors", "lead", "1", world_plus("lead"), "sag")
        yield "motor_compliance@", _of_robot(about, "motors", "settling", "s", world_plus("settling"), "settling")
        yield "motor_compliance@", _of_robot(about, "motors", "rotor", "kg m^2", world_plus("rotor"), "rotor")
    for each in _masses(about):
        yield "com_offset@", each
    for foot_name in SIDES:
        for k, key in enumerate(WRENCH):
            unit, zero = "N" if k < 3 else "Nm", wrench_minus(foot_name, k)
            yield f"wrench_bias@{foot_name}.{key}", _zero(about, foot_name, f"zero_{key}", unit, zero, f"zero_{key}")
    if recording.up is not None:
        for k, key in enumerate(("roll", "pitch")):
            yield f"ground_slope@.{key}", _zero(about, "imu", key, "rad", _imu_zero(k), "imu")
    landing = about.widths("landings", "usual", "spread", reach="landings.spread", times=about.robot.mass)
    yield "touchdown_impact@", Unknown("", "landings", "impulse", "Ns", world_plus("impulse"), own=True, **landing)

    soles = about.widths("soles", "spread", reach="soles.spread", per=about.edge)
    # own: it counts from what was found of each recording (soles.py)
    yield "ground_compliance@", Unknown("", "soles", "softness", "rad/Nm", world_plus("softness"), own=True, **soles)


def _masses(about: About) -> Iterator[Unknown]:
    """Mass and COM of each body."""
    robot = about.robot
    trunk = robot.model.frames[robot.base_id]
    for body in range(1, robot.model.njoints):
        if robot.model.inertias[body].mass > LIGHTEST:
            name = robot.model.names[body]
            yield replace(_of_robot(about, name, "mass", "1", _mass(body), "mass"), step=0.05)
            axes = trunk.placement.rotation.copy() if body == trunk.parentJoint else np.eye(3)
            for k, key in enumerate("xyz"):
                width = "com_z" if body == trunk.parentJoint and key == "z" else "com"
                yield replace(
                    _of_robot(about, name, f"com_{key}", "m", lever_plus(body, axes[:, k]), width), step=0.005
                )


def _of_robot(about: About, where: str, key: str, unit: str, change: Change, width: str, times: float = 1.0) -> Unknown:
    """Something that differs from robot to robot, with one width, named in `Nominal.widths`."""
    return Unknown("", where, key, unit, change, **about.widths(width, "spread", reach=f"{width}.spread", times=times))


def _zero(about: About, where: str, key: str, unit: str, change: Change, width: str, times: float = 1.0) -> Unknown:
    """The same, that differs from recording to recording."""
    return replace(_of_robot(about, where, key, unit, change, width, times), own=True)


def _stretch(recording: Recording, world: World, j: int) -> float:
    """A large stretch of a joint's spring in this recording [rad]."""
    if recording.tau is not None and np.isfinite(recording.tau[:, j]).all():
        torque = np.percentile(np.abs(recording.tau[:, j]), 95.0)
    else:
        torque = 0.03 * world.robot.mass * world.gravity  # [Nm] at an arm of 3 cm
    return max(float(torque) / float(world.stiffness[j]), 1e-3)


def _lead(foot: Foot, k: int) -> Change:
    """References are planned ahead of the springs' sag, by more on one leg than on the other."""

    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        stance = (r.left_share >= 0.5) == (foot == Foot.LEFT)
        return r.changed(plan=r.plan + x * stance[:, None] * np.eye(2)[k]), w

    return apply


def _mass(body: int) -> Change:
    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        model = w.model.copy()
        model.inertias[body] = scaled(model.inertias[body], 1.0 + x)
        return r, w.changed(model=model)

    return apply


def _gain(j: Integers) -> Change:
    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        assert r.tau is not None
        tau = r.tau.copy()
        tau[:, j] /= 1.0 + x
        return r.changed(tau=tau), w

    return apply


def _imu_zero(k: int) -> Change:
    axis = np.eye(3)[k]
    return lambda r, w, x: (r.changed(up=r.up - x * np.cross(axis, r.up)), w)
