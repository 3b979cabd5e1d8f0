# SPDX-License-Identifier: BSD-3-Clause
"""What holds for every effect of the catalogue."""

from __future__ import annotations

import dataclasses
import itertools
import math

import pytest
from effect_tools import PAPER, config, same, trunk_config

from coman_reduced_model import open_robot
from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.files import config_to_yaml, load_config
from coman_reduced_model.core.config.schema import OPTIONS, Config
from coman_reduced_model.core.effects.catalogue import CATALOGUE, build_effects
from coman_reduced_model.resources import bag_path

# Names of discrepancy.md: configurations, results and verdicts use them.
VOCABULARY = """spring_nonlinearity backlash joint_friction joint_stiffness joint_damping motor_lag transport_delay
    motor_compliance payload com_offset ground_compliance ground_slope external_force foot_slip
    touchdown_impact encoder_bias encoder_delay wrench_delay wrench_scale wrench_bias sensor_rotation
    hysteresis body_mass stiffness_drift""".split()
PLACES = {"robot": [""], "foot": ["left", "right", ""], "joint": ["LKneeSag", "right", ""],
          "link": ["LKneeSag", ""]}  # fmt: skip


def walked(config: Config, seconds: float = 2.0):
    """Predictions of the first steps of a recorded walk."""
    with Session(bag_path("test1"), config) as session:
        results = []
        for prediction in session.predictions():
            results.append(prediction)
            if prediction.stamp_ns - results[0].stamp_ns > seconds * 1e9:
                break
    return results


@pytest.fixture(scope="module")
def without():
    return walked(trunk_config())


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_with_nominal_figures_an_effect_changes_nothing(without, name):
    where = PLACES[CATALOGUE[name].place][-1]
    same(walked(config(name, where, trunk_config())), without, 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        pytest.param(chosen, id="-".join(chosen) or "none")
        for n in range(len(OPTIONS) + 1)
        for chosen in itertools.combinations(OPTIONS, n)
        if "trunk_rotation" in chosen or "swing_momentum" not in chosen
    ],
)
def test_with_nominal_figures_all_effects_change_nothing_whatever_the_options(options):
    chosen = {f"model.{name}": "with" if name in options else "without" for name in OPTIONS}
    all_change_nothing(Config().replaced(chosen))


@pytest.mark.slow
def test_all_effects_change_nothing_on_both_legs():
    all_change_nothing(PAPER.replaced({"model.double_support": "both_legs"}))


def all_change_nothing(base: Config) -> None:
    """With nominal figures, all effects at once."""
    settings = base
    for name in CATALOGUE:
        settings = config(name, PLACES[CATALOGUE[name].place][-1], settings)
    same(walked(settings), walked(base), 1e-12)


def test_the_catalogue_is_the_vocabulary():
    assert sorted(CATALOGUE) == sorted(VOCABULARY)
    for name, effect in CATALOGUE.items():
        assert effect.name == name
        assert effect.__doc__ and effect.__module__.endswith(f"effects.{name}"), "one file each"


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters_tell_unit_bounds_and_meaning(name):
    for parameter in CATALOGUE[name].parameters:
        assert parameter.kind == "float" and parameter.description
        assert parameter.unit, f"{parameter.name}: '1' for a ratio"
        assert math.isfinite(parameter.low) and math.isfinite(parameter.high)
        assert parameter.low <= parameter.nominal <= parameter.high


@pytest.mark.parametrize("name", CATALOGUE)
def test_each_effect_at_each_place_goes_through_a_file(tmp_path, name):
    effect = CATALOGUE[name]
    places = PLACES[effect.place]
    changes = {f"effects.{name}.where": places}
    for parameter in effect.parameters:
        step = 0.1 * (min(parameter.high, parameter.nominal + 1.0) - parameter.nominal)
        changes[f"effects.{name}.{parameter.name}"] = [parameter.nominal + k * step for k in range(len(places))]
    written = PAPER.replaced({"effects.active": [name], **changes})
    path = tmp_path / "model.yaml"
    path.write_text(config_to_yaml(written), encoding="utf-8")
    assert load_config(path) == dataclasses.replace(written, directory=tmp_path)
    assert [(e.where, dict(e.values)) for e in written.effects if e.name == name] == [
        (where, {p.name: changes[f"effects.{name}.{p.name}"][k] for p in effect.parameters})
        for k, where in enumerate(places)
    ]


@pytest.mark.parametrize("where, joints, feet", [
    ("", 12, (Foot.LEFT, Foot.RIGHT)), ("left", 6, (Foot.LEFT,)), ("RAnkSag", 1, (Foot.RIGHT,))
])  # fmt: skip
def test_a_place_names_a_joint_a_leg_or_all(where, joints, feet):
    robot = open_robot(bag_path("test1"), PAPER)
    (effect,), _ = build_effects(config("encoder_bias", where).effects, robot)
    assert len(effect.joints) == joints and effect.feet == feet
    assert list(effect.joints) == [i for foot in feet for i in robot.legs[foot][effect.leg_joints[foot]]]
    if joints == 1:
        assert [robot.joint_names[i] for i in effect.joints] == [where]
