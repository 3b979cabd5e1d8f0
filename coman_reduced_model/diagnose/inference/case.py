# SPDX-License-Identifier: BSD-3-Clause
"""A recording under examination: the nominal state of its robot, and the derivatives of its residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.base.nominal import Nominal, load_nominal
from ...core.base.types import Array
from ...core.config.schema import Config
from ...core.effects.base import EffectConfig
from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import Unknown, applied
from ...core.robot.robot import Robot
from ...errors import BagError
from ..data.masks import TICKS, Masks, masks, not_on_edges, on_flat_soles, with_taken_up
from ..data.recording import Recording, of_world
from ..data.signals import without_noise
from ..data.world import World
from ..physics.balance import State, evaluate
from ..physics.hypotheses import SIDES, unknowns
from ..physics.soles import softness
from .evidence import Evidence, Fit, Problem, assemble, parts_of, pooled, summed, weigh
from .floor import floor, law_of, unit_of
from .noise import Noise, repeated
from .prior import prior_variance
from .reference import Reference, reference
from .usual import Usual

STEADY_S = 1.0  # [s] of standing steadily, on one or two feet, that a recording must have
Prepared = tuple[Recording, World, Masks]


def prepare(recording: Recording, robot: Robot, config: Config, nominal: Nominal | None = None) -> Prepared:
    """A recording with the nominal state of its robot and the masks of its residuals.

    Raises:
        BagError: the robot hardly ever stands steadily.
    """
    recording, world = _with_known(recording, World.nominal(robot, config, nominal), config)
    where = masks(recording, world)
    state = evaluate(recording, world, where)
    for axis in ("roll", "pitch"):
        tilt = state.residuals.get(f"tilt/{axis}")
        if tilt is None or not np.isfinite(tilt).any():
            continue
        if (off := abs(np.nanmedian(tilt))) > world.limits["imu_off"]:
            warning = (
                f"the IMU's {axis} is {np.degrees(off):.0f} degrees off by the legs: another frame? It is not used"
            )
            recording = recording.changed(up=None, warnings=(*recording.warnings, warning))
            state = evaluate(recording, world, where)
    where, quiet = not_on_edges(where, recording, world), without_noise(recording, world)
    if recording.up is not None:  # soles that are soft turn without being on their edge
        soft = world.changed(softness=softness(quiet, world, where, state))
        where = on_flat_soles(where, evaluate(recording, soft, where, state).residuals, world)
    world = world.changed(softness=softness(quiet, world, where, state))
    if where.staggers:
        warning = "nearly always on the edge of a foot by the IMU: the balance of forces shows little of it"
        recording = recording.changed(warnings=(*recording.warnings, warning))
    if (steady := int(where.steady.sum())) < STEADY_S * TICKS:
        raise BagError(
            f"{recording.name}: steady on its feet for {steady / TICKS:.2f} s of {recording.t[-1]:.1f} s by its "
            f"wrenches, and {STEADY_S:g} s are needed: has it fallen, or do wrenches and support.* not fit together?"
        )
    return recording, world, where


def _with_known(recording: Recording, world: World, config: Config) -> tuple[Recording, World]:
    """Apply the effects of the configuration, which belong to the nominal robot.

    Those of sensors, drives and loads were applied while the recording was read.
    """
    for effect in config.effects:
        if not of_world(CATALOGUE[effect.name]):
            continue
        known = unknowns(recording, world)
        mine = [each for each in known if each.effect == effect.name]
        places = _places(effect, world.robot, mine)
        mine = [each for each in mine if each.where in places]
        for unknown in mine:
            more = unknown.deviation(effect.values[unknown.key]) - unknown.usual  # which every robot has anyway
            recording, world = unknown.apply(recording, world, more)
        if not mine:
            at = f" at {effect.where}" if effect.where else ""
            warning = f"{effect.name}{at} of the configuration is left out: this recording cannot show it"
            recording = recording.changed(warnings=(*recording.warnings, warning))
    return recording, world


def _places(effect: EffectConfig, robot: Robot, known: list[Unknown]) -> list[str]:
    """The place of a configured effect; where a diagnosis has not all of it, the single feet or joints that it names.

    Args:
        known: the parameters of this effect, at all places.
    """
    kind, there = CATALOGUE[effect.name], [each.key for each in known if each.where == effect.where]
    lacks = {each.key for each in known if effect.values[each.key] != each.nominal} - set(there)
    if (there and not lacks) or kind.place not in ("joint", "foot"):
        return [effect.where]
    named = kind(effect.where, effect.values)
    named.bind(robot)
    if kind.place == "foot":
        return [side for side, foot in SIDES.items() if foot in named.feet]
    return [robot.joint_names[i] for i in named.joints]


@dataclass
class Case:
    """One recording under examination, linear around some values of the parameters."""

    recording: Recording
    where: Masks
    state: State
    problem: Problem
    evidence: Evidence
    noise: dict[str, Noise]
    reference: Reference
    known_floor: dict[str, float] | None = None

    @property
    def floor(self) -> dict[str, float]:
        """The noise floor by group, computed when first needed: most trials are refused before."""
        if self.known_floor is None:
            usual = self.problem.usual
            self.known_floor = floor(self.state, self.where, usual.floor, usual.sensors)
        return self.known_floor

    def own(self, fit: Fit, released: Sequence[int]) -> Array:
        """Deviations (P,) of the parameters from nominal: the best nominal variability of this recording.

        Those of `released` stay within the uncertainty of the `fit`.
        """
        mean, variance = np.zeros(len(fit.x)), prior_variance(self.evidence.unknowns, precise=fit.precise)
        covariance = fit.covariance
        for i in released:
            mean[i], variance[i] = fit.x[i], covariance[i, i] + 1e-18
        return self.evidence.posterior(mean, variance).x

    def said_by(self, laws: tuple[str, ...], trust: Mapping[str, float] | None = None) -> Evidence:
        """What some laws alone say, by the beginnings of their names.

        Args:
            trust: of each law; by default as in `evidence`.
        """
        parts = (part for part in parts_of(self.problem, self.noise) if part.law.startswith(laws))
        trust = self.problem.usual.trust if trust is None else trust
        return summed(self.problem.unknowns, self.evidence.at, parts, trust)

    def left(self, x: Array) -> dict[str, Array]:
        """By group, the residuals that remain with the parameters at deviations x (P,) from nominal: r - J (x - at)."""
        step = x - self.evidence.at
        return {key: row - self.problem.columns[key] @ step for key, row in self.problem.rows.items()}


def evidence_of(cases: Sequence[Case]) -> Evidence:
    """Sum over recordings, with each recording's own parameters integrated out."""
    return pooled(case.evidence for case in cases)


def with_known(case: Case, known: list[Unknown]) -> Case:
    """The same case with other spreads of its parameters; its noise is what it was."""
    return replace(case, problem=replace(case.problem, unknowns=known), evidence=replace(case.evidence, unknowns=known))


def examine(
    prepared: Prepared,
    known: list[Unknown],
    at: Array,
    like: Case | None = None,
    fresh: Sequence[int] | None = None,
    nominal: Nominal | None = None,
) -> Case:
    """Evidence of a recording, linear around deviations `at` (P,) of the parameters from nominal.

    With a case `like` it and some parameters that are `fresh`, only the derivatives by these are computed again, and
    its noise is where that of this case begins. What repeats at least, and how far laws are trusted, is that of `like`,
    or of `nominal` robots, by default of the shipped population.
    """
    recording, world, where = prepared
    near = like if fresh is not None else None
    base = reference(recording, world, where, known, at, like.reference if like else None)
    usual = like.problem.usual if like else Usual.of(nominal or load_nominal(), world)
    problem = assemble(base, where, known, at, near.problem if near else None, fresh or (), usual)
    evidence, noise = weigh(problem, at, near.noise if near else None)
    if near:
        return Case(near.recording, where, near.state, problem, evidence, noise, base, near.floor)
    moved, world = applied(known, at, recording, world)
    masked = with_taken_up(where, recording, moved, world)
    state = evaluate(moved, world, masked) if at.any() else base.measured
    return Case(recording, masked, state, problem, evidence, noise, base, like.floor if like else None)


def repeats_of(cases: Sequence[Case]) -> dict[str, float]:
    """By law, what recordings of a robot leave that repeats with each stride, in units as `Nominal.repeats` has them.

    As all noise, it is that of each law with full trust.
    """
    squares: dict[str, list[float]] = {}
    cases = [_with_full_trust(case) for case in cases]
    fit = evidence_of(cases).fit()
    for case in cases:
        world = case.state.world
        weight = world.robot.mass * world.gravity
        for key, left in case.left(case.own(fit, [])).items():
            law = law_of(key)
            stride = case.problem.stride.get(key)
            if stride is None or not np.isfinite(stride).all():
                continue  # it hardly walks: nothing shows what repeats
            value = repeated(left, stride) / unit_of(law, weight, world.gravity)
            squares.setdefault(law, []).append(value**2)
    return {law: float(np.sqrt(np.mean(values))) for law, values in squares.items()}


def _with_full_trust(case: Case) -> Case:
    return replace(case, evidence=case.said_by(("",), {}))
