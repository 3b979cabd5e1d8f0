# SPDX-License-Identifier: BSD-3-Clause
"""Tuning: the cheap free run is the predictor's own, what was hidden is found again, doubt is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.types import Flags
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.predictor import Predictor
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.resources import config_path
from coman_reduced_model.tuning.free_run import COEFFICIENTS, collect
from coman_reduced_model.tuning.parameters import changed, knobs, tune_parameters
from coman_reduced_model.tuning.recording import JoinedBag, read_recording
from coman_reduced_model.tuning.shares import measure_shares, with_shares
from coman_reduced_model.tuning.tune import chosen, describe, judged, steps_in, tune_coefficients

BAGS = Path(__file__).resolve().parents[2] / "bags"
CONFIG = load_config(config_path("coman_paper")).replaced({"prediction.horizons": ()})
WHOLE = {f"model.{option}": "with" for option in ("gravity_stiffness", "trunk_rotation", "swing_momentum")}


@pytest.fixture(scope="module")
def walk():
    """Five seconds from the middle of a walk: seven steps."""
    whole = read_recording(BAGS / "test1", CONFIG)
    cut = JoinedBag(whole.bag, whole.robot, whole.samples[600:1600], [], ())
    return JoinedBag(cut.bag, cut.robot, cut.samples, cut.predict(CONFIG), ())


def imagined(walk, config, noise=0.0, seed=0):
    """The same walk, but with the COM where the model of a configuration has it: what tuning must find."""
    said = walk.predict(config)
    rng = np.random.default_rng(seed)
    for p in said:
        p.measured_com = p.predicted_com + noise * rng.standard_normal(3)
    return said


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"model.double_support": "both_legs"},
        {
            "model.shares": "measured",
            "model.stiffness": "condensed",
            "model.gravity_stiffness": "with",
            "model.lateral_compliance": "with",
            "effects.active": ["external_force"],
            "effects.external_force.x": [3.0],
        },
        {"prediction.reset_every_steps": 3},
    ],
)
def test_the_cheap_free_run_is_the_predictors_own(walk, changes):
    config = CONFIG.replaced(changes)
    free = collect(walk.samples, walk.robot, config)
    rng = np.random.default_rng(3)
    for values in (np.ones(8), rng.uniform(0.4, 1.6, 8), np.array([0.1, 8.0, -3.0, 4.0, 2.0, 5.0, 6.0, -9.0])):
        trial = config.replaced({f"model.{n}": float(v) for n, v in zip(COEFFICIENTS, values, strict=True)})
        own = np.array([np.concatenate((p.predicted_com, p.predicted_com_vel)) for p in walk.predict(trial)])
        cheap = free.run(values)
        assert np.isfinite(own).sum() > 5000
        np.testing.assert_allclose(cheap, own, rtol=0.0, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("limit_m", [Predictor.DIVERGED, 0.03])
def test_the_cheap_free_run_restarts_where_the_predictor_does(walk, monkeypatch, limit_m):
    """Springs that push away, each by the other's deflection; one limit of divergence serves both."""
    monkeypatch.setattr(Predictor, "DIVERGED", limit_m)
    values = np.array([1.0, 1.0, 8.0, 1.0, 1.0, 1.0, 8.0, 1.0])
    changes = {f"model.{n}": float(v) for n, v in zip(COEFFICIENTS, values, strict=True)}
    config = CONFIG.replaced({"prediction.reset_every_steps": 0, **changes})
    said = walk.predict(config)
    own = np.array([np.concatenate((p.predicted_com, p.predicted_com_vel)) for p in said])
    off = np.array([np.linalg.norm(p.residual) for p in said])
    assert sum(Flags.REJECTED_STATE in p.flags for p in said) >= 3
    assert 0.5 * limit_m < np.nanmax(off) < limit_m
    cheap = collect(walk.samples, walk.robot, config).run(values)
    np.testing.assert_allclose(cheap, own, rtol=0.0, atol=1e-9, equal_nan=True)


def test_a_given_coordinate_is_taken_from_the_data(walk):
    free = collect(walk.samples, walk.robot, CONFIG)
    whole = free.run(np.ones(8))
    alone = free.run(np.ones(8), given=2, data=whole)
    known = np.isfinite(whole).all(axis=1)
    # x beside the simulated z is what both give, up to how z goes between two samples; beside another z it is not.
    rigid = free.run(np.ones(8), given=2, data=free.reference)
    off = [np.sqrt(np.mean((other - whole)[known, 0] ** 2)) for other in (alone, rigid)]
    assert off[0] < 5e-5 and off[0] < 0.05 * off[1]
    assert np.array_equal(alone[known, 2], whole[known, 2])


def test_coefficients_are_found_again_and_told_with_intervals(walk, monkeypatch):
    true = np.array([0.6, 1.5, 0.7, 1.3, 1.2, 0.8, 1.1, 0.9])
    hidden = CONFIG.replaced({f"model.{n}": float(v) for n, v in zip(COEFFICIENTS, true, strict=True)})
    made = imagined(walk, hidden, noise=1e-4)
    free = collect(walk.samples, walk.robot, CONFIG)
    # The measured COM of this walk is the hidden model's; where that restarts, so does the tuned one.
    for i, p in enumerate(made):
        if np.isfinite(p.measured_com).all() and free.event[i] != 2:
            free.measured[i] = np.concatenate((p.measured_com, p.predicted_com_vel))
    monkeypatch.setattr("coman_reduced_model.tuning.tune.collect", lambda *_: free)
    tuned = tune_coefficients([walk], CONFIG)
    assert [p.name for p in tuned.parameters] == list(COEFFICIENTS)
    by_name = {p.name: p for p in tuned.parameters}
    for name in ("a1", "a2"):  # stiffness is plain to see; dampers and coupling are told with their doubt
        assert by_name[name].value == pytest.approx(true[COEFFICIENTS.index(name)], rel=0.15)
    wide = [p for p in tuned.parameters if not p.low <= true[COEFFICIENTS.index(p.name)] <= p.high]
    assert len(wide) <= 3
    for axis in "xz":
        assert tuned.after.all[axis] < 0.1 * tuned.before.all[axis]
    assert len(tuned.stages) == 5


def test_parameters_that_do_nothing_or_the_same_are_said():
    rng = np.random.default_rng(1)
    x = rng.standard_normal(400)
    J = np.column_stack([x, np.zeros(400), x + 1e-3 * rng.standard_normal(400)])
    found, condition = describe(
        ["one", "nothing", "twin"], np.ones(3), np.array([1.0, 1.0, 2.0]), J, 0.01 * rng.standard_normal(400),
        np.zeros(400), 5, np.array([[0.0, 0.0, 0.0], [5.0, 5.0, 2.0]]), 20,
    )  # fmt: skip
    assert "not identifiable" in found[1].notes
    assert any("does nearly what twin does" in note for note in found[0].notes)
    assert "at its bound 2" in found[2].notes
    assert condition > 100.0


def test_shares_add_up_and_are_those_of_the_wrenches(walk):
    shares = {(s.axis, s.when): s for s in measure_shares([walk])}
    assert set(shares) == {("x", "before"), ("x", "after"), ("z", "before"), ("z", "after")}
    for axis in "xz":  # in one double support one leg has just landed and the other is about to lift
        assert shares[axis, "before"].whole + shares[axis, "after"].whole == pytest.approx(1.0, abs=1e-9)
    z = shares["z", "before"]
    assert z.interval[0] < z.whole < z.interval[1] and z.interval[1] - z.interval[0] < 0.1
    assert z.leading > 0.5  # the support leg is the one that carries more
    used = with_shares(CONFIG, list(shares.values())).model
    assert used.share_z_before == pytest.approx(z.leading, abs=1e-4)
    assert (
        with_shares(CONFIG.replaced({"model.shares": "measured"}), list(shares.values())).model.share_z_before == 0.42
    )


def test_a_load_of_the_configuration_is_not_added_twice():
    """By predictions that are made again of what was read, as tuning does."""
    config = CONFIG.replaced({"effects.active": ["payload"], "effects.payload.mass": [1.0], "effects.payload.x": [0.1]})
    read = read_recording(BAGS / "stand", config)
    again = JoinedBag(read.bag, read.robot, read.samples[:50], [], ()).predict(config)
    assert len(again) == 50 and np.isfinite([p.measured_com for p in again[-10:]]).all()
    for one, other in zip(read.predictions, again, strict=False):
        assert other.measured_com == pytest.approx(one.measured_com, abs=1e-12, nan_ok=True)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_joint_springs_are_found_again_through_the_whole_model(walk):
    config = CONFIG.replaced(WHOLE)
    chosen_knobs = knobs(config, ["joint_stiffness"])
    assert [k.name for k in chosen_knobs] == [f"joint_stiffness({s}{j})" for s in "LR" for j in ("KneeSag", "AnkSag")]
    true = (1.15, 0.9, 1.05, 1.1)
    hidden = imagined(walk, changed(config, chosen_knobs, true))
    short = JoinedBag(walk.bag, walk.robot, walk.samples, walk.predict(config), ())

    class Imagined(JoinedBag):
        def predict(self, config):
            said = JoinedBag.predict(self, config)
            for p, truth in zip(said, hidden, strict=True):
                p.measured_com = truth.measured_com
            return said

    bag = Imagined(short.bag, short.robot, short.samples, short.predictions, ())
    tuned = tune_parameters([bag], config, ["joint_stiffness"])
    for p, value in zip(tuned.parameters, true, strict=True):
        assert p.value == pytest.approx(value, rel=0.03)
    assert tuned.config.robot.left.stiffness[3] == pytest.approx(1.15 * 180.0, rel=0.03)
    assert tuned.after.all["x"] < 0.05 * tuned.before.all["x"]


@pytest.mark.slow
def test_steps_are_counted_among_the_samples_that_count(walk):
    every = steps_in([walk], judged([walk], False))
    assert every > steps_in([walk], judged([walk], True)) == 3


def test_names_that_mean_nothing_are_refused():
    turning = CONFIG.replaced(WHOLE)
    assert chosen(CONFIG, "") == [] == chosen(CONFIG, "coefficients")
    assert "joint_stiffness" in chosen(turning, "")
    with pytest.raises(ConfigError, match="does not use the paper's coefficients"):
        chosen(turning, "a1")
    with pytest.raises(ConfigError, match="'nothing' is no number"):
        knobs(CONFIG, ["nothing"])
    assert [k.key for k in knobs(turning, ["friction"])] == ["model.friction"]
    undamped = {f"robot.{side}.damping": [0.0] * 6 for side in ("left", "right")}
    with pytest.raises(ConfigError, match="nothing to fit"):
        knobs(CONFIG.replaced(undamped), ["joint_damping"])


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_command_tunes_a_walk_and_writes_what_nodes_load(tmp_path, capsys):
    out = tmp_path / "tuned.yaml"
    assert (
        run(["tune", str(BAGS / "test2"), "--config", str(config_path("coman_paper")), "--out", str(out), "--json"])
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    mse = result["mse_m2"]
    for where in ("steps", "all"):
        assert mse[where]["after"]["x"] < mse[where]["before"]["x"]
    assert set(result["parameters"]) == set(COEFFICIENTS)
    tuned = load_config(out)
    assert tuned.model.a1 == pytest.approx(result["parameters"]["a1"]["value"], rel=1e-5)
    assert tuned.prediction.horizons == (0.1, 0.2, 0.4)
    # What it promises is what the predictor then does.
    said = read_recording(BAGS / "test2", tuned.replaced({"prediction.horizons": ()})).predictions
    errors = np.array([p.residual for p in said])
    errors = errors[np.isfinite(errors).all(axis=1)]
    assert np.mean(errors[:, 0] ** 2) == pytest.approx(mse["all"]["after"]["x"], rel=1e-3)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_by_default_it_tunes_the_springs_of_the_default_model(tmp_path, capsys):
    out = tmp_path / "tuned.yaml"
    assert run(["tune", str(BAGS / "test2"), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    mse = result["mse_m2"]["all"]
    assert result["parameters"] and not set(result["parameters"]) & set(COEFFICIENTS)
    for axis in "xz":
        assert mse["after"][axis] < 0.05 * mse["rigid"][axis] and mse["after"][axis] < 1.1 * mse["before"][axis]
    tuned = load_config(out)
    assert tuned.turning and tuned.model == load_config(config_path()).model


@pytest.mark.slow
def test_bad_input_is_one_line(tmp_path, capsys):
    (tmp_path / "there.yaml").write_text("")
    for arguments, said in (
        (["nowhere", "--out", str(tmp_path / "a.yaml")], "nowhere"),
        ([str(BAGS / "test1"), "--out", str(tmp_path / "there.yaml")], "exists; --force"),
        ([str(BAGS / "test1"), "--out", str(tmp_path)], "is a folder"),
        ([str(BAGS / "test1"), "--out", str(tmp_path / "a.yaml"), "--parameters", "b7"], "'b7' is no number"),
        ([str(BAGS / "stand"), "--out", str(tmp_path / "a.yaml"), "--steps"], "no three steps"),
        ([str(BAGS / "test1"), "--out", str(tmp_path / "a.yaml"), "--stages"], "--stages: of the paper's coefficients"),
    ):
        assert run(["tune", *arguments]) == 2
        error = capsys.readouterr().err
        line = [x for x in error.splitlines() if x.startswith("coman:")]
        assert said in line[0] and "Traceback" not in error
