# SPDX-License-Identifier: BSD-3-Clause
"""An effect's file says all about it: what the model, the diagnosis, sentences and the page need."""

from __future__ import annotations

import re
from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from diagnose_tools import standing, t

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.effects.ambiguity import Ambiguity
from coman_reduced_model.core.effects.base import PLACES, Effect
from coman_reduced_model.core.effects.catalogue import CATALOGUE
from coman_reduced_model.core.effects.unknown import LINKS, PLAN, About, Unknown
from coman_reduced_model.diagnose.data.recording import Recording
from coman_reduced_model.diagnose.data.world import World
from coman_reduced_model.diagnose.inference.variability import MEMBERS, widths_of
from coman_reduced_model.diagnose.physics.hypotheses import unknowns


@cache
def moving() -> tuple[Recording, World]:
    """A recording with all streams in which everything moves, so that a delay of any stream shows."""
    recording, world = standing()
    wave = np.sin(2.0 * np.pi * t)[:, None]
    plan = np.repeat(0.01 * wave, 2, axis=1)
    wrench = {foot: values + wave for foot, values in recording.wrench.items()}
    return recording.changed(q=recording.q + 0.1 * wave, plan=plan, moved=plan, wrench=wrench), world


@cache
def about() -> About:
    recording, world = moving()
    joints = len(world.robot.joint_names)
    return About(world.robot, world.gravity, True, True, True, np.full(joints, 0.05), recording.count, load_nominal())


def differs(before, after) -> bool:
    """Whether two recordings, or two worlds, do not say the same."""

    def plain(value):
        if hasattr(value, "inertias"):
            return [each.toDynamicParameters() for each in value.inertias]
        return list(value.values()) if isinstance(value, dict) else value

    names = [field.name for field in fields(before) if field.name not in ("robot", "name", "warnings")]
    return any(not np.array_equal(plain(getattr(before, n)), plain(getattr(after, n))) for n in names)


def missing(effect: type[Effect]) -> set[str]:
    """Parts of an entry that are not there, or that do not fit together."""
    out = {part for part in ("name", "parameters", "sentence", "experiment", "exact") if part not in vars(effect)}
    out |= {part for part in ("sentence", "experiment") if not getattr(effect, part, "").strip()}
    if not effect.__doc__:
        out.add("description")
    if effect.place not in ("joint", "link") and effect.place not in PLACES:
        out.add("place")
    if not isinstance(getattr(effect, "exact", None), bool):
        out.add("exact")
    keys = {parameter.name for parameter in effect.parameters}
    for parameter in effect.parameters:
        if not parameter.unit or not parameter.description or not np.isfinite([parameter.low, parameter.high]).all():
            out.add(f"bounds, unit or description of {parameter.name}")
    for text in (getattr(effect, "sentence", ""), effect.opposite, effect.further):
        named = {word.removesuffix("_size") for word in re.findall(r"{(\w+)}", text)}
        if not named <= keys | {"at", "listed", "rest"}:
            out.add("sentence")
    if effect.ambiguity is not None and effect.ambiguity.experiment != getattr(effect, "experiment", ""):
        out.add("experiment")
    return out | missing_of_unknowns(effect)


def missing_of_unknowns(effect: type[Effect]) -> set[str]:
    out = set()
    found = effect.unknowns(about())
    for parameter in effect.parameters:
        mine = [each for each in found if each.key == parameter.name]
        if not mine:
            out.add(f"unknown {parameter.name}")
        for each in mine:
            if np.isfinite(each.low) and each.value(each.low) < parameter.low - 1e-9:
                out.add(f"bounds of {each.key}")
    known = {"joint": set(about().joints_and_legs), "link": set(about().robot.joint_names)}
    places = known.get(effect.place) or {*PLACES.get(effect.place, ())}
    for each in found:
        if each.where not in places | {PLAN, LINKS}:
            out.add(f"place of {each.key}")
        if "reach" not in each.widths or not set(each.widths.values()) <= set(load_nominal().widths):
            out.add(f"widths of {each.key}")
        recording, world = moving()
        after = each.apply(recording, world, each.step)
        if not (differs(recording, after[0]) or differs(world, after[1])):
            out.add(f"what {each.key} does")
    return out


@pytest.mark.parametrize("name", CATALOGUE)
def test_no_part_of_an_entry_is_missing(name):
    assert not missing(CATALOGUE[name])


@pytest.mark.parametrize("name", CATALOGUE)
def test_what_a_diagnosis_could_find_is_wider_than_nominal_scatter(name):
    for each in CATALOGUE[name].unknowns(about()):
        assert each.reach > each.spread >= 0.0 and each.step > 0.0, each.name


def test_missing_parts_are_noticed():
    whole = CATALOGUE["backlash"]

    def without(**parts) -> set[str]:
        return missing(type("Spoilt", (whole,), {**vars(whole), **parts}))

    assert not without()
    assert without(__doc__="") == {"description"}
    assert without(sentence=" ") == {"sentence"}
    assert without(sentence="{at} has {gap} of backlash") == {"sentence"}
    assert without(experiment="") == {"experiment"}
    assert without(ambiguity=Ambiguity("play", "another experiment")) == {"experiment"}
    assert without(exact=None) == {"exact"}
    assert without(place="knee") >= {"place"}
    assert without(unknowns=classmethod(lambda cls, about: [])) == {"unknown width"}

    def still(cls, about) -> list[Unknown]:
        return [Unknown(cls.name, "left", "width", "rad", lambda r, w, x: (r, w), 0.01)]

    assert without(unknowns=classmethod(still)) == {"what width does", "widths of width"}


def test_all_widths_are_used():
    assert {name for each in unknowns(*moving()) for name in each.widths.values()} == set(load_nominal().widths)


def test_what_robots_are_given_room_for_has_a_bound():
    """Else a robot that has the effect at several places would be taken for one that varies by so much."""
    known, nominal = unknowns(*moving()), load_nominal()
    widths = {name: members for name, members in widths_of(known).items() if len(members) >= MEMBERS}
    effects = {n for n, members in widths.items() if known[members[0]].effect and not known[members[0]].shape}
    assert effects <= set(nominal.most), effects - set(nominal.most)
