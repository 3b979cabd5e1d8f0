# SPDX-License-Identifier: BSD-3-Clause
"""Slow adaptation: what it learns of a robot whose springs and encoders are not as configured, and what it leaves."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import coman_reduced_model as coman
from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.base.types import Array
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.model.trunk.adaptation import MOST, Adaptation, Adapted
from coman_reduced_model.sim.disturbances import parse
from coman_reduced_model.sim.worlds import World
from coman_reduced_model.sim.worlds.run import record_world
from coman_reduced_model.tuning.parameters import tune_parameters
from coman_reduced_model.tuning.recording import read_recording

PLAIN = Config().replaced({"prediction.horizons": [], "monitor.enabled": False})
STIFF = [3000.0, 3500.0, 2500.0, 180.0, 200.0, 3000.0]


def assumed(knee: float = 1.0, **effects: Any) -> Config:
    """The robot as a data sheet would have it whose left knee spring is that much stiffer than the real one."""
    stiffness = [k * (knee if i == 3 else 1.0) for i, k in enumerate(STIFF)]
    return PLAIN.replaced({"robot.left.stiffness": stiffness, **effects})


def walk(config: Config, adapt: bool) -> tuple[Array, dict[str, Adapted]]:
    """RMS error (3,) [m] of the free run over the second half of a walk, and what was learnt of the joints."""
    rms, adaptation = followed(coman.bag_path("test1"), config.replaced({"prediction.adapt": adapt}))
    return rms, {} if adaptation is None else adaptation.known()


def followed(bag: Path, config: Config) -> tuple[Array, Adaptation | None]:
    """The same of any walk, and all that was learnt."""
    with coman.Session(bag, config) as session:
        residuals = np.array([prediction.residual for prediction in session.predictions()])
        adaptation = session.pipeline.predictor.adaptation
    return np.sqrt(np.nanmean(residuals[len(residuals) // 2 :] ** 2, axis=0)), adaptation


def shift(config: Config) -> Array:
    """(2,) [m] of the trunk's COM, as learnt in a walk."""
    _, adaptation = followed(coman.bag_path("test1"), config.replaced({"prediction.adapt": True}))
    assert adaptation is not None
    return adaptation.shift


def trunk_of_data_sheet(x: float) -> Config:
    """The robot as a data sheet would have it in which the trunk's COM lies that far ahead of the real one [m]."""
    return assumed(**{"effects.active": ["com_offset"], "effects.com_offset.x": [x]})


@pytest.fixture(scope="module")
def healthy() -> Array:
    return walk(PLAIN, adapt=False)[0]


@pytest.mark.slow
def test_a_softer_spring_is_learnt_as_tuning_would_find_it(healthy):
    """Both from the same walk, without knowing the data sheet that was right."""
    config = assumed(knee=1.15)
    wrong, _ = walk(config, adapt=False)
    adapted, known = walk(config, adapt=True)
    assert wrong[0] > 2.0 * healthy[0]
    assert adapted[0] < 0.5 * wrong[0] and adapted[2] < 0.7 * wrong[2]
    whole = read_recording(coman.bag_path("test1"), config)
    steps = slice(len(whole.samples) // 4, 3 * len(whole.samples) // 4)
    part = replace(whole, samples=whole.samples[steps], predictions=whole.predictions[steps])
    tuned = {each.name: each.value for each in tune_parameters([part], config, ["joint_stiffness"]).parameters}
    for joint in ("LKneeSag", "LAnkSag", "RKneeSag", "RAnkSag"):
        assert known[joint].stiffness == pytest.approx(tuned[f"joint_stiffness({joint})"], abs=0.08)
    assert known["LKneeSag"].stiffness == pytest.approx(1.0 / 1.15, abs=0.06)  # the rest is taken for zero and trunk


@pytest.mark.slow
def test_the_zero_of_an_encoder_is_learnt(healthy):
    """A link encoder that reads 2 mrad too little, made of a right one by an effect."""
    config = assumed(
        **{
            "effects.active": ["encoder_bias"],
            "effects.encoder_bias.where": ["LAnkLat"],
            "effects.encoder_bias.bias": [0.002],
        }
    )
    wrong, _ = walk(config, adapt=False)
    adapted, known = walk(config, adapt=True)
    assert wrong[1] > 2.0 * healthy[1]
    assert adapted[1] < 0.7 * wrong[1]
    assert -0.0025 < known["LAnkLat"].zero < -0.0007
    assert abs(known["RAnkLat"].zero) < 0.0005


@pytest.mark.slow
def test_the_com_of_a_trunk_is_learnt_where_a_robot_walks_with_it(tmp_path):
    """Eight millimetres ahead bend knees and ankles of both legs, which zeros do by chance only."""
    record_world(World(duration_s=14.0, tolerances=False), tmp_path / "walk", [parse("com_offset:x=0.008")])
    wrong, _ = followed(tmp_path / "walk", PLAIN)
    adapted, adaptation = followed(tmp_path / "walk", PLAIN.replaced({"prediction.adapt": True}))
    assert adapted[0] < 0.4 * wrong[0]
    assert 0.003 < adaptation.shift[0] < 0.009 and abs(adaptation.shift[1]) < 0.001
    assert all(abs(zero) < 0.0009 for _, zero in adaptation.known().values())


@pytest.mark.slow
def test_the_com_of_a_trunk_is_learnt_as_tuning_would_find_it():
    """But for what the adaptation, whose prior is nominal, leaves to stiffness and zeros."""
    config = trunk_of_data_sheet(-0.008)
    part = read_recording(coman.bag_path("test1"), config)
    part = replace(part, samples=part.samples[-1200:], predictions=part.predictions[-1200:])
    (tuned,) = tune_parameters([part], config, ["x"]).parameters
    assert tuned.value == pytest.approx(0.0, abs=0.001)
    assert 0.4 * (tuned.value + 0.008) < shift(config)[0] < tuned.value + 0.008


def test_the_zero_of_one_ankle_is_not_the_com_of_the_trunk():
    config = assumed(
        **{
            "effects.active": ["encoder_bias"],
            "effects.encoder_bias.where": ["LAnkSag"],
            "effects.encoder_bias.bias": [0.002],
        }
    )
    assert abs(shift(config)[0]) < 0.002


@pytest.mark.slow
def test_planned_postures_teach_nothing():
    """Predictions ahead take the springs of postures in which the robot is not yet."""
    _, known = walk(PLAIN, adapt=True)
    _, ahead = walk(PLAIN.replaced({"prediction.horizons": [0.2]}), adapt=True)
    assert ahead == known


@pytest.mark.slow
def test_nothing_is_learnt_beyond_nominal_variability():
    _, known = walk(assumed(knee=3.0), adapt=True)
    widths = load_nominal().widths
    spread = np.hypot(widths["joint_stiffness.scale.spread"], widths["joint_stiffness.together.spread"])
    for joint, (ratio, zero) in known.items():
        assert abs(1.0 / ratio - 1.0) <= 1.001 * MOST * spread, joint
        assert abs(zero) <= 1.001 * MOST * np.sqrt(2.0) * widths["encoder_bias.bias.spread"], joint
    assert abs(shift(trunk_of_data_sheet(-0.06))[0]) <= 1.001 * MOST * widths["com.spread"]


@pytest.mark.slow
def test_a_robot_as_its_data_sheet_says_is_predicted_as_well_as_before(healthy):
    adapted, known = walk(PLAIN, adapt=True)
    assert (adapted < 1.1 * healthy).all()
    assert all(abs(ratio - 1.0) < 0.03 and abs(zero) < 0.0006 for ratio, zero in known.values())
    assert np.abs(shift(PLAIN)).max() < 0.001


def test_off_and_for_the_point_mass_there_is_nothing_to_learn():
    for changes in ({"prediction.adapt": False}, {"prediction.adapt": True, "model.trunk_rotation": "without"}):
        with coman.Session(coman.bag_path("stand"), PLAIN.replaced(changes)) as session:
            assert session.pipeline.predictor.adaptation is None


@pytest.mark.slow
def test_standing_on_both_feet_teaches_nothing():
    with coman.Session(coman.bag_path("stand"), PLAIN.replaced({"prediction.adapt": True})) as session:
        on = [prediction.residual for prediction in session.predictions()]
        assert all(each == (1.0, 0.0) for each in session.pipeline.predictor.adaptation.known().values())
    with coman.Session(coman.bag_path("stand"), PLAIN) as session:
        off = [prediction.residual for prediction in session.predictions()]
    assert np.array(on) == pytest.approx(np.array(off), nan_ok=True, abs=1e-12)
