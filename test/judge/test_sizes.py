# SPDX-License-Identifier: BSD-3-Clause
"""Sizes and forms of hidden effects against what clean robots vary by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from diagnose_tools import standing

from coman_reduced_model.diagnose.physics.hypotheses import unknowns
from coman_reduced_model.errors import BagError
from coman_reduced_model.judge import families, sizes
from coman_reduced_model.judge.cases import data_sheet
from coman_reduced_model.judge.families import FAMILIES, MULTIPLES, draw_effect
from coman_reduced_model.judge.rank import evidence_with, ranking, with_deviation
from coman_reduced_model.judge.sizes import times_to_show
from coman_reduced_model.judge.variability import true_deviations
from coman_reduced_model.sim.contact import Floor
from coman_reduced_model.sim.disturbances import Imperfections, Scatter, make
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.worlds import World, draw_world, record_world


@pytest.mark.parametrize("family", FAMILIES)
def test_a_size_is_a_multiple_of_what_clean_robots_vary_by(monkeypatch, family):
    """On COMAN; where that is more than a walking robot can have, the level is lower, and that is returned."""
    entry = yaml.safe_load(families.SIZES.read_text())[family]
    deviation, sizes = float(entry["clean"]), []
    one = FAMILIES[family]

    def draw(rng, size, table):
        sizes.append(size)
        return one.draw(rng, size, table)

    monkeypatch.setitem(FAMILIES, family, replace(one, draw=draw))
    rng = np.random.default_rng(1)
    for wanted in range(3):
        values, reached = draw_effect(family, rng, wanted, World())
        low, high = MULTIPLES[reached]
        assert reached <= wanted and min(low * deviation, one.most) * 0.999 <= sizes[-1] <= high * deviation * 1.001
        if reached < wanted:
            assert MULTIPLES[reached + 1][1] * deviation > one.most
        make(one.effect, values)  # within its bounds


def test_the_true_variability_is_that_of_the_draws():
    """Springs scatter by Scatter, all else by Imperfections: measured over draws, as the oracle is given it."""
    world = World(imperfections=1.0)
    deviations = true_deviations(world)
    zeros = [Imperfections(seed=seed).drawn(world.table)["encoder_zero"] for seed in range(200)]
    assert deviations["encoder_bias.bias.spread"] == pytest.approx(np.std(zeros), rel=0.5)
    assert deviations["joint_stiffness.scale.spread"] == pytest.approx(Scatter().spring, rel=0.2)
    calmer = true_deviations(World(imperfections=0.5))
    assert calmer["encoder_bias.bias.spread"] < deviations["encoder_bias.bias.spread"]


def test_a_size_is_no_less_than_what_the_robots_of_its_own_world_vary_by():
    """Medium is five deviations, of the world if those are more; a level that no robot walks with is lowered."""

    def sizes(family, world, key):
        draws = [draw_effect(family, np.random.default_rng(seed), 1, world) for seed in range(40)]
        return [abs(values[key]) for values, _ in draws if key in values], {level for _, level in draws}

    loose = World(imperfections=1.4)
    found, levels = sizes("backlash", loose, "width")
    assert min(found) >= 5.0 * true_deviations(loose)["backlash.width.spread"] and levels == {1}
    assert min(sizes("backlash", World(), "width")[0]) < min(found)
    uneven = replace(World(), floor=Floor(tile_height=0.0025))
    assert min(sizes("ground_slope", World(), "pitch")[0]) < min(sizes("ground_slope", uneven, "pitch")[0])
    found, levels = sizes("wrench_bias", World(sensors=SensorOptions(wrench_zero=300.0)), "fz")
    assert levels == {0} and max(found) == FAMILIES["wrench_bias"].most  # zeros are that large anyway
    soft = draw_world(0, {"contact": "soft_soles", "engine": "mujoco"})
    found, levels = sizes("ground_compliance", replace(soft, robot="coman"), "vertical")
    assert levels == {0} and max(found) == FAMILIES["ground_compliance"].most  # soles are that soft anyway
    talks = World(sensors=SensorOptions(cross_talk=0.02))
    found, levels = sizes("wrench_cross_talk", talks, "fx")
    assert min(found) >= 5.0 * 0.02 and levels == {1}
    assert min(sizes("sensor_rotation", talks, "angle")[0]) >= 5.0 * 0.02  # which looks like it


def test_soles_vary_where_they_creep_or_are_soft():
    slide, sink = "foot_slip.distance.spread", "ground_compliance.vertical.spread"
    for kind, engine, known in (
        ("creeping", "mujoco", {slide}),
        ("soft_soles", "mujoco", {sink}),
        ("soft_soles", "drake", {sink}),
        ("firm", "mujoco", set()),
        ("firm", "drake", set()),
    ):
        deviations = true_deviations(draw_world(1, {"contact": kind, "engine": engine}))
        assert known == {slide, sink} & set(deviations)
    softer = unknowns(*standing())
    name = {each.widths.get("spread"): each for each in softer}
    assert {slide, sink, "sensor_rotation.angle.spread"} <= set(name)  # as the oracle takes them


def test_an_effect_grows_until_its_own_recording_would_show_it(monkeypatch, tmp_path):
    """Where the recording without it leaves 0.02 s of a late stream open, medium is five times that."""
    late = {"name": "encoder_delay", "where": "", "parameters": {"delay": 0.01}}
    row = {"name": "encoder_delay", "where": "", "parameters": {"delay": {"value": 0.0, "deviation": 0.02}}}
    monkeypatch.setattr(sizes, "evidence_with", lambda folder, deviations: None)
    monkeypatch.setattr(sizes, "ranking", lambda evidence: [row])

    def drawn(times):
        larger = times[0] if times else 1.0
        return [{**late, "parameters": {"delay": larger * 0.01}}, {**late, "name": "cogging"}], ["medium", "medium"]

    assert times_to_show(tmp_path, World(), drawn) == pytest.approx((10.0, 1.0))
    draws = [draw_effect("com_offset", np.random.default_rng(2), 1, World(), times)[0] for times in (1.0, 2.0)]
    assert draws[1] == pytest.approx({axis: 2.0 * value for axis, value in draws[0].items()})

    def refuse(folder, deviations):
        raise BagError("no step")

    monkeypatch.setattr(sizes, "evidence_with", refuse)
    assert times_to_show(tmp_path, World(), drawn) == (1.0, 1.0)


def test_a_factor_grows_until_its_logarithm_shows(monkeypatch, tmp_path):
    """Dampers four tenths stronger show 1.7 deviations; of three times that change, the logarithm is 3.9 of them."""
    open_of = {"scale": {"value": 0.0, "deviation": 0.2, "logarithmic": True}}
    row = {"name": "joint_damping", "where": "", "parameters": open_of}
    monkeypatch.setattr(sizes, "evidence_with", lambda folder, deviations: None)
    monkeypatch.setattr(sizes, "ranking", lambda evidence: [row])

    def drawn(times):
        scale = 1.0 + 0.4 * (times[0] if times else 1.0)
        return [{"name": "joint_damping", "where": "", "parameters": {"scale": scale}}], ["medium"]

    effects, _ = drawn(times_to_show(tmp_path, World(), drawn))
    assert sizes.shown(effects[0], [row]) == pytest.approx(5.0, rel=0.03)
    gain = {"name": "wrench_scale", "where": "", "parameters": {"scale": 0.75}}
    open_of = {"scale": {"value": 0.0, "deviation": 0.05, "logarithmic": False}}
    assert sizes.shown(gain, [{**gain, "parameters": open_of}]) == pytest.approx(5.0)


@pytest.mark.parametrize("seed", range(40))
def test_what_grows_stays_where_it_is(seed):
    """A mass that is hidden in an arm does not move to a leg, and one that is missing is not one too much."""
    world = draw_world(seed, {"body": "whole_body" if seed % 2 else "legs"})
    first, *others = (
        draw_effect("body_mass", np.random.default_rng(seed), 1, world, times)[0] for times in (1.0, 1.5, 2.5)
    )
    sizes_of = [abs(each["scale"] - 1.0) for each in (first, *others)]
    low, high = (multiple * families.deviations()["body_mass"] for multiple in MULTIPLES[1])
    mass = sizes_of[0] * families.link_mass(world.table, first["where"])
    assert low - 1e-9 <= mass * COMAN.mass / world.table.mass <= max(high, FAMILIES["body_mass"].most) + 1e-9
    assert {each["where"] for each in others} == {first["where"]}
    assert {each["scale"] > 1.0 for each in others} == {first["scale"] > 1.0}
    assert sizes_of == sorted(sizes_of)


def test_a_load_shows_by_its_moment_and_drift_by_its_size():
    """What hidden forms do not share with the diagnosis counts neither."""
    load = {"name": "payload", "where": "", "parameters": {"mass": 0.3, "x": 0.05, "y": 0.0, "z": 0.0}}
    open_of = {key: {"value": 0.0, "deviation": size} for key, size in (("mass", 0.2), ("x", 0.005), ("y", 1.0))}
    assert sizes.shown(load, [{"name": "payload", "where": None, "parameters": open_of}]) == pytest.approx(3.0)
    drift = {"name": "stiffness_drift", "where": "LKneeSag", "parameters": {"change": -0.1, "time": 8.0}}
    open_of = {key: {"value": 0.0, "deviation": size} for key, size in (("change", 0.2), ("time", 0.8))}
    assert sizes.shown(drift, [{**drift, "parameters": open_of}]) == pytest.approx(0.5)


def test_a_precise_robot_has_no_delays_for_the_oracle():
    name, known = "encoder_delay.delay.spread", unknowns(*standing())
    late = next(each for each in known if each.effect == "encoder_delay")
    given = with_deviation(late, true_deviations(World(imperfections=0.0)))
    assert late.widths["spread"] == name and late.precise is not None
    assert given.spread == 0.0 and given.precise is None
    assert with_deviation(late, {}).spread == late.spread and with_deviation(late, {}).precise is None


@pytest.mark.slow
def test_late_wrenches_show_about_nominal(tmp_path):
    """Of a walk on firm, uneven ground, where forces are sudden, by sensors that were not zeroed."""
    world = replace(draw_world(3140), duration_s=8.0)
    record_world(world, tmp_path / "train", [make("wrench_delay", {"delay": 0.007})], 1, store=False)
    (tmp_path / "robot.yaml").write_text(data_sheet(world))
    rows = ranking(evidence_with(tmp_path, true_deviations(world)))
    late = next(row for row in rows if (row["name"], row["where"]) == ("wrench_delay", ""))
    assert late["parameters"]["delay"]["value"] == pytest.approx(0.007, rel=0.3) and late["evidence"] > 8.0


@pytest.mark.parametrize(
    ("family", "forms"),
    [
        ("foot_slip", {"late", "sudden", "creep"}),
        ("touchdown_impact", {"decay", "double"}),
        ("hardening", {"tanh", "steps"}),
        ("softening", {"tanh", "steps"}),
        ("hysteresis", {"several"}),
        ("stiffness_drift", {"ramp"}),
    ],
)
def test_no_hidden_effect_has_the_form_that_the_diagnosis_has(family, forms):
    """That is the form which a disturbance has by default."""
    draws = [draw_effect(family, np.random.default_rng(k), 1, World())[0] for k in range(60)]
    assert {values["form"] for values in draws} == forms
    assert make(FAMILIES[family].effect, {}).form not in forms
    if family == "hardening":  # at a hip too
        assert {values["form"] for values in draws if values["where"][1:] == "HipSag"} == forms
