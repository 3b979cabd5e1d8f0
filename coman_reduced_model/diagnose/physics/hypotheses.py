# SPDX-License-Identifier: BSD-3-Clause
"""What each effect of the catalogue would do to the measurement or to the world behind it, one figure at a time.

A figure (`Figure`) has two widths: `spread`, how much it varies from one healthy robot to the next (springs and masses
scatter by some percent, sensors have small biases), and `reach`, how large it may be if the effect is there. A figure
without spread is absent from healthy robots. The evidence for an effect is what its figures gain by being let
out of their spread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...core.base.types import Array, Foot
from ...core.effects.joint_friction import CREEP
from ..data.recording import FEET, RATE, WRENCH, Recording
from ..data.signals import lagged
from ..data.world import World

Apply = Callable[[Recording, World, float], tuple[Recording, World]]
PLAN, LINKS = "plan", "all"  # a second way for the same effect to show itself, not a place
SIDES = {"left": Foot.LEFT, "right": Foot.RIGHT}

# Widths are set by what is common on real robots and in data sheets; those of clocks, soles, slides and landings also
# by what healthy virtual robots do; none comes from the cases that are reported.
STIFFNESS_SPREAD, DAMPING_SPREAD, MASS_SPREAD, COM_SPREAD = 0.045, 0.10, 0.03, 0.0025
HEIGHT_SPREAD = 0.012  # [m] of the trunk: cables, covers, and walking hardly shows it
ENCODER_SPREAD = 0.001  # [rad] zero of a link encoder
TORQUE_SPREAD = 0.15  # [Nm] zero of a joint torque sensor
WRENCH_SPREAD = (1.0, 1.0, 2.2, 0.045, 0.045, 0.035)  # [N, Nm] zero of a foot sensor
GAIN_SPREAD = 0.01  # of a foot sensor
CLOCK_SPREAD = 0.0015  # [s] between streams
DRIVER_SPREAD = 0.0012  # [s] between what one driver reads
CUBIC_SPREAD = 0.025  # of the torque, at the stretch under a typical load
BENDS = 2.0  # counts of an encoder that a spring must stretch by: the errors of an encoder come again with every step
YIELD_SPREAD = 3e-5  # [rad/Nm] of a position loop
SETTLING_SPREAD = 0.01  # [s] with which a position loop yields, and ...
ROTOR_SPREAD = 0.15  # [kg m^2] reflected, that it carries (by its data, COMAN's is 0.139): of no effect by themselves
LAG_SLACK = 0.003  # [s] of a good position loop
IMU_SPREAD = 0.004  # [rad] zero of the tilt
FLOOR_SPREAD = 0.002  # [rad] no floor is quite level
PULL_SPREAD = 0.5  # [N] cables
PLAY_SLACK = 0.001  # [rad] of any gear
FRICTION_SPREAD = 0.10  # [Nm]
CREEP_SPREAD, SLOWEST = 0.02, 0.005  # [rad/s] below which joints creep instead of sticking; at least
LEAD_SPREAD = 0.004  # [m] of references planned ahead of the springs' sag
SAG_SPREAD = 0.5  # of the springs' sag under the planned torques, by which motors are commanded ahead
SLIP_SPREAD = 0.0007  # [m] that soles creep while the load passes
LANDING_SPREAD, BLOW_REACH = 0.005, 0.05  # [m/s] by which landings differ in how they stop the robot; a hard one
# [rad], [m] of sole and floor under a foot that bears the weight at its edge: usual, about that, and of a soft floor.
USUAL_TILTING, TILTING_SPREAD, TILTING_REACH = 0.0027, 0.0012, 0.012
USUAL_SINKING, SINKING_SPREAD, SINKING_REACH = 1.6e-4, 1.2e-4, 2e-3


@dataclass(frozen=True)
class Figure:
    """One figure of one effect at one place.

    Attributes:
        effect, where, key: as in the configuration; effect "" for what only healthy scatter has.
        nominal: value when there is no such effect.
        spread, reach: standard deviations of value - nominal without and with the effect.
        slack: standard deviation that is no effect worth a name, where healthy robots have (nearly) none at all.
        low: least physical deviation from nominal.
        own: each recording has its own value: sensors' zeros change from one day to the next.
        step: for the difference quotient.
        unit: of the value.
        offered: as a candidate; else it is too fine for this recording to tell.
        shape: it does nothing without the other figures of its effect.
        usual: what healthy robots have of it, beyond nominal: deviations count from there.
        apply: recording and world under the hypothesis that the figure differs from nominal by so much.
    """

    effect: str
    where: str
    key: str
    nominal: float
    spread: float
    reach: float
    step: float
    unit: str
    apply: Apply
    slack: float = 0.0
    low: float = -np.inf
    own: bool = False
    offered: bool = True
    usual: float = 0.0
    shape: bool = False

    @property
    def name(self) -> str:
        return f"{self.effect}@{self.where}.{self.key}" if self.effect else f"{self.key}@{self.where}"


@dataclass(frozen=True)
class Candidate:
    """An effect at a place: the figures that are let go together."""

    effect: str
    where: str
    figures: tuple[int, ...]  # indices into the list of figures

    @property
    def place(self) -> str:
        """`where` as in the configuration."""
        return "" if self.where in (PLAN, LINKS) else self.where

    @property
    def name(self) -> str:
        return f"{self.effect}@{self.where}" if self.where else self.effect


def figures(recording: Recording, world: World) -> list[Figure]:
    """All figures that this recording could tell something about."""
    robot = world.robot
    legs = {"left": robot.legs[Foot.LEFT], "right": robot.legs[Foot.RIGHT]}
    joints = {robot.joint_names[j]: np.array([j]) for leg in legs.values() for j in leg}
    groups = {**legs, "": np.concatenate(list(legs.values()))}
    out: list[Figure] = []

    def add(
        effect: str, where: str, key: str, spread: float, reach: float, unit: str, apply: Apply, **more: float
    ) -> None:
        nominal, step = more.get("nominal", 0.0), more.get("step", 0.1 * reach)
        slack, low = more.get("slack", 0.0), more.get("low", -np.inf)
        own = not effect and not key.startswith(("mass", "com_", "settling", "rotor"))
        offered = bool(more.get("offered", True))
        usual, shape = more.get("usual", 0.0), bool(more.get("shape", False))
        out.append(
            Figure(
                effect, where, key, nominal, spread, reach, step, unit, apply, slack, low, own, offered, usual, shape
            )
        )

    motors, efforts = recording.motor_q is not None, recording.tau is not None
    for where, which in {**joints, **groups}.items():
        single = where in joints
        if motors:
            add(
                "joint_stiffness",
                where,
                "scale",
                STIFFNESS_SPREAD * single,
                0.3,
                "1",
                _stiffness(which),
                nominal=1.0,
                slack=0.0 if single else 0.02,
                low=-0.9,
            )
            add(
                "joint_damping",
                where,
                "scale",
                DAMPING_SPREAD * single,
                1.0,
                "1",
                _damping(which),
                nominal=1.0,
                slack=0.0 if single else 0.15,
                low=-1.0,
            )
        add("encoder_bias", where, "bias", ENCODER_SPREAD * single, 0.02, "rad", _encoder(which)) if single else None
    for where, which in joints.items():
        if motors:
            scale = _stretch(recording, world, int(which[0]))
            bend, reach = CUBIC_SPREAD / scale**2, 0.4 / scale**2
            offered = scale > BENDS * recording.count[which[0]]
            add("spring_nonlinearity", where, "cubic", bend, reach, "1/rad^2", _cubic(which), offered=offered)
            add("backlash", where, "width", 0.0, 0.01, "rad", _backlash(which), slack=PLAY_SLACK, low=0.0)
        if efforts or motors:
            add("joint_friction", where, "coulomb", FRICTION_SPREAD, 2.0, "Nm", _friction(which), low=0.0)
            creep = {"nominal": CREEP, "low": SLOWEST - CREEP, "shape": True}
            add("joint_friction", where, "creep", CREEP_SPREAD, 0.1, "rad/s", _creep(which), **creep)
        if efforts:
            add("", where, "torque_zero", TORQUE_SPREAD, TORQUE_SPREAD, "Nm", _torque_zero(which))
    if motors:
        add("transport_delay", "", "delay", DRIVER_SPREAD, 0.03, "s", _motor_delay, step=0.008, low=0.0, slack=0.002)
        add("motor_lag", "", "time_constant", 0.0, 0.03, "s", _motor_lag, step=0.008, low=0.0, slack=LAG_SLACK)
        if recording.plan is not None:
            # Motor states that tell what the motors do show it against the plan, those that echo the command do not.
            add("transport_delay", PLAN, "delay", 0.0, 0.03, "s", _plan_delay, step=0.008, low=0.0, slack=0.003)
            add("motor_lag", PLAN, "time_constant", 0.0, 0.03, "s", _plan_lag, step=0.008, low=0.0, slack=0.003)
            for stance, foot in SIDES.items():
                for k, axis in enumerate("xy"):
                    add("", stance, f"lead_{axis}", LEAD_SPREAD, LEAD_SPREAD, "m", _lead(foot, k))
        add("motor_compliance", "", "compliance", YIELD_SPREAD, 3e-4, "rad/Nm", _world("yielding"), low=0.0)
        if recording.plan is not None:
            more = {"low": 0.0, "slack": YIELD_SPREAD}
            add("", "motors", "lead", SAG_SPREAD, SAG_SPREAD, "1", _world("lead"))
            add("motor_compliance", PLAN, "compliance", 0.0, 3e-4, "rad/Nm", _world("yielded"), **more)
        add("", "motors", "settling", SETTLING_SPREAD, SETTLING_SPREAD, "s", _world("settling"))
        add("", "motors", "rotor", ROTOR_SPREAD, ROTOR_SPREAD, "kg m^2", _world("rotor"))
    trunk_frame = robot.model.frames[robot.base_id]
    trunk_joint, trunk_axes = trunk_frame.parentJoint, trunk_frame.placement.rotation.copy()
    for k, key in enumerate(("mass", "x", "y", "z")):
        reach = (0.06 * robot.mass, 0.06, 0.04, 0.03)[k]  # first moments [kg m] until the mass is known
        trunk = robot.model.inertias[trunk_joint].mass
        lightest = -0.8 * trunk if k == 0 else -np.inf
        add("payload", "", key, 0.0, reach, "kg" if k == 0 else "kg m", _payload(k), step=0.1, low=lightest)
    for k, key in enumerate("xyz"):
        # Walking hardly shows the height of a COM.
        add(
            "com_offset",
            "",
            key,
            0.0,
            HEIGHT_SPREAD if key == "z" else 0.03,
            "m",
            _com_offset(trunk_joint, trunk_axes[:, k]),
            step=0.005,
        )
    for body in range(1, robot.model.njoints):
        if robot.model.inertias[body].mass > 1e-3:
            add("", robot.model.names[body], "mass", MASS_SPREAD, MASS_SPREAD, "1", _mass(body), step=0.05)
            axes = trunk_axes if body == trunk_joint else np.eye(3)
            for k, key in enumerate("xyz"):
                spread, shift = COM_SPREAD if body > 1 or key != "z" else HEIGHT_SPREAD, _com_offset(body, axes[:, k])
                add("", robot.model.names[body], f"com_{key}", spread, spread, "m", shift, step=0.005)
    for where, feet in (("left", FEET[:1]), ("right", FEET[1:]), ("", FEET)):
        single = len(feet) == 1
        add(
            "wrench_scale", where, "scale", GAIN_SPREAD * single, 0.15, "1", _gain(feet), nominal=1.0, slack=GAIN_SPREAD
        )
        add(
            "wrench_delay",
            where,
            "delay",
            CLOCK_SPREAD * single,
            0.03,
            "s",
            _wrench_delay(feet),
            step=0.008,
            slack=CLOCK_SPREAD,
        )
        if single:
            for k, key in enumerate(WRENCH):
                reach, unit = (15.0, "N") if k < 3 else (1.0, "Nm")
                add("wrench_bias", where, key, 0.0, reach, unit, _wrench_bias(feet[0], k))
                add("", where, f"zero_{key}", WRENCH_SPREAD[k], WRENCH_SPREAD[k], unit, _wrench_bias(feet[0], k))
    add("encoder_delay", "", "delay", DRIVER_SPREAD, 0.03, "s", _link_delay(efforts=False), step=0.008, low=0.0)
    if efforts:
        add("encoder_delay", LINKS, "delay", DRIVER_SPREAD, 0.03, "s", _link_delay(efforts=True), step=0.008, low=0.0)
    for k, key in enumerate(("roll", "pitch")):
        add("ground_slope", "", key, FLOOR_SPREAD, 0.05, "rad", _slope(k))
        if recording.up is not None:
            add("", "imu", key, IMU_SPREAD, IMU_SPREAD, "rad", _imu_zero(k))
    for k, key in enumerate("xy"):
        add("external_force", "", key, PULL_SPREAD, 10.0, "N", _pull(k))
    for where, foot in SIDES.items():
        add("foot_slip", where, "distance", SLIP_SPREAD, 0.02, "m", _slip(foot))
    blow, landing = BLOW_REACH * robot.mass, LANDING_SPREAD * robot.mass
    add("touchdown_impact", "", "impulse", 0.0, blow, "Ns", _world("impulse"), low=0.0)
    add("", "landings", "impulse", landing, landing, "Ns", _world("impulse"))
    weight = robot.mass * world.gravity
    edge = weight * 0.5 * robot.config.foot_length
    for key, unit, load, usual, spread, reach, name in (
        ("rotational", "rad/Nm", edge, USUAL_TILTING, TILTING_SPREAD, TILTING_REACH, "tilting"),
        ("vertical", "m/N", weight, USUAL_SINKING, SINKING_SPREAD, SINKING_REACH, "sinking"),
    ):
        more = {"low": 0.0, "usual": usual / load}
        add("ground_compliance", "", key, spread / load, reach / load, unit, _world(name), **more)
    return out


def _stretch(recording: Recording, world: World, j: int) -> float:
    """A large stretch of a joint's spring in this recording [rad]."""
    if recording.tau is not None and np.isfinite(recording.tau[:, j]).all():
        torque = np.percentile(np.abs(recording.tau[:, j]), 95.0)
    else:
        torque = 0.03 * world.robot.mass * world.gravity  # [Nm] at an arm of 3 cm
    return max(float(torque) / float(world.stiffness[j]), 1e-3)


def candidates(known: list[Figure]) -> list[Candidate]:
    """Figures of the same effect at the same place, released together."""
    places: dict[tuple[str, str], list[int]] = {}
    for i, figure in enumerate(known):
        if figure.effect and figure.offered:
            places.setdefault((figure.effect, figure.where), []).append(i)
    out = []
    for (effect, where), indices in places.items():
        out.append(Candidate(effect, where, tuple(indices)))
        if len(indices) > 1:  # a pull along x needs no figure for y: what is not needed counts against an effect
            alone = [i for i in indices if not known[i].shape and (effect != "payload" or known[i].key == "mass")]
            out += [Candidate(effect, where, (i,)) for i in alone]
        if effect == "payload":
            out.append(Candidate(effect, where, tuple(indices[:2])))
    return out


def _columns(values: Array, which: Array, change: Callable[[Array], Array]) -> Array:
    values = values.copy()
    values[:, which] = change(values[:, which])
    return values


def _vector(base: Array, which: Array, change: Callable[[Array], Array]) -> Array:
    base = base.copy()
    base[which] = change(base[which])
    return base


def _stiffness(which: Array) -> Apply:
    return lambda r, w, x: (r, w.changed(stiffness=_vector(w.stiffness, which, lambda k: k * (1.0 + x))))


def _damping(which: Array) -> Apply:
    return lambda r, w, x: (r, w.changed(damping=_vector(w.damping, which, lambda d: d * (1.0 + x))))


def _encoder(which: Array) -> Apply:
    return lambda r, w, x: (r.changed(q=_columns(r.q, which, lambda q: q - x)), w)


def _cubic(which: Array) -> Apply:
    return lambda r, w, x: (r, w.changed(cubic=_vector(w.cubic, which, lambda c: c + x)))


def _backlash(which: Array) -> Apply:
    return lambda r, w, x: (r, w.changed(play=_vector(w.play, which, lambda p: p + x)))


def _friction(which: Array) -> Apply:
    return lambda r, w, x: (r, w.changed(friction=_vector(w.friction, which, lambda f: f + x)))


def _creep(which: Array) -> Apply:
    return lambda r, w, x: (r, w.changed(creep=_vector(w.creep, which, lambda c: np.maximum(c + x, SLOWEST))))


def _torque_zero(which: Array) -> Apply:
    return lambda r, w, x: (r.changed(tau=_columns(r.tau, which, lambda tau: tau - x)), w)  # type: ignore[arg-type]


def shifted(values: Array, by: float) -> Array:
    """Values `by` seconds later (n, k): what a stream that is late by so much should have said.

    By cubics through four values: lines through two would take part of the noise away, which then speaks for a delay
    of half a sample that is not there.
    """
    n = len(values)
    position = np.clip(np.arange(n) + by * RATE, 0.0, n - 1.0)
    low = np.minimum(np.floor(position).astype(int), n - 2)
    t = position - low
    weights = (
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    )
    out = np.zeros_like(values)
    for k, weight in enumerate(weights):
        used = weight != 0.0  # a whole shift takes what is there, gaps in the neighbours or not
        out[used] += weight[used, None] * values[np.clip(low[used] + k - 1, 0, n - 1)]
    return out


def _motor_delay(r: Recording, w: World, x: float) -> tuple[Recording, World]:
    return r.changed(motor_q=shifted(r.motor_q, -x)), w  # type: ignore[arg-type]


def _motor_lag(r: Recording, w: World, x: float) -> tuple[Recording, World]:
    return r.changed(motor_q=lagged(r.motor_q, x)), w  # type: ignore[arg-type]


def _plan_delay(r: Recording, w: World, x: float) -> tuple[Recording, World]:
    return r.changed(plan=shifted(r.plan, -x)), w  # type: ignore[arg-type]


def _plan_lag(r: Recording, w: World, x: float) -> tuple[Recording, World]:
    return r.changed(plan=lagged(r.plan, x)), w  # type: ignore[arg-type]


def _lead(foot: Foot, k: int) -> Apply:
    """References are planned ahead of the springs' sag, by more on one leg than on the other."""

    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        stance = (r.left_share >= 0.5) == (foot == Foot.LEFT)
        return r.changed(plan=r.plan + x * stance[:, None] * np.eye(2)[k]), w

    return apply


def _slip(foot: Foot) -> Apply:
    return lambda r, w, x: (r, w.changed(slip=w.slip + x * (np.arange(2) == FEET.index(foot))))


def _payload(k: int) -> Apply:
    """Mass, or first moment: two masses that cancel, half a metre apart each way."""

    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        if k == 0:
            return r, w.add_mass(x, np.zeros(3), w.robot.base_id)
        at = np.zeros(3)
        at[k - 1] = 0.1
        return r, w.add_mass(x / 0.2, at, w.robot.base_id).add_mass(-x / 0.2, -at, w.robot.base_id)

    return apply


def _com_offset(body: int, axis: Array) -> Apply:
    """Along an axis (3,) in the frame of the body's joint."""

    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        model = w.model.copy()
        old = model.inertias[body]
        new = pin.Inertia(old)
        new.lever = old.lever + x * axis
        model.inertias[body] = new
        return r, w.changed(model=model)

    return apply


def _mass(body: int) -> Apply:
    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        model = w.model.copy()
        old = model.inertias[body]
        new = pin.Inertia(old)
        new.mass, new.inertia = (1.0 + x) * old.mass, (1.0 + x) * old.inertia
        model.inertias[body] = new
        return r, w.changed(model=model)

    return apply


def _wrenches(r: Recording, feet: tuple[Foot, ...], change: Callable[[Array], Array]) -> Recording:
    return r.changed(wrench={foot: change(value) if foot in feet else value for foot, value in r.wrench.items()})


def _gain(feet: tuple[Foot, ...]) -> Apply:
    return lambda r, w, x: (_wrenches(r, feet, lambda value: value / (1.0 + x)), w)


def _wrench_delay(feet: tuple[Foot, ...]) -> Apply:
    return lambda r, w, x: (_wrenches(r, feet, lambda value: shifted(value, x)), w)


def _wrench_bias(foot: Foot, k: int) -> Apply:
    unit = np.eye(6)[k]
    return lambda r, w, x: (_wrenches(r, (foot,), lambda value: value - x * unit), w)


def _link_delay(efforts: bool) -> Apply:
    def apply(r: Recording, w: World, x: float) -> tuple[Recording, World]:
        late = r.changed(q=shifted(r.q, x))
        return (late.changed(tau=shifted(r.tau, x)) if efforts else late), w  # type: ignore[arg-type]

    return apply


def _slope(k: int) -> Apply:
    return lambda r, w, x: (r, w.changed(slope=w.slope + x * np.eye(2)[k]))


def _imu_zero(k: int) -> Apply:
    axis = np.eye(3)[k]
    return lambda r, w, x: (r.changed(up=r.up - x * np.cross(axis, r.up)), w)  # type: ignore[operator, arg-type]


def _pull(k: int) -> Apply:
    return lambda r, w, x: (r, w.changed(pull=w.pull + x * np.eye(2)[k]))


def _world(name: str) -> Apply:
    return lambda r, w, x: (r, w.changed(**{name: getattr(w, name) + x}))
