# SPDX-License-Identifier: BSD-3-Clause
"""Robots without foot force sensors, on the command line: what is refused, and what the results say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import JOINTS, LEFT, MOTORS, RIGHT, walk, write_bag

from coman_reduced_model import Config, bag_path
from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.stream_names import CONTACTS
from coman_reduced_model.diagnose.baseline import baseline
from coman_reduced_model.diagnose.data.masks import masks
from coman_reduced_model.diagnose.data.reading import Reading
from coman_reduced_model.diagnose.data.recording import load
from coman_reduced_model.diagnose.data.world import World
from coman_reduced_model.diagnose.inference.check import check_recordings
from coman_reduced_model.diagnose.physics.balance import evaluate
from coman_reduced_model.diagnose.physics.hypotheses import candidates, unknowns
from coman_reduced_model.errors import BagError, ConfigError
from coman_reduced_model.offline import predict_bag
from coman_reduced_model.sim.record import record
from coman_reduced_model.sim.sensors import SensorOptions


def by(source: str) -> Config:
    return Config().replaced({"streams.wrench_source": source})


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "no_wrenches", walk(1.0), skip=(LEFT, RIGHT))


def test_a_bag_without_wrenches_says_what_does_without(bag):
    with pytest.raises(
        BagError, match="no topics? /left_foot/wrench.*wrench_source: sensors; `torques` and `contacts`"
    ):
        Session(bag)


def test_a_bag_with_neither_contacts_nor_torques(bag, tmp_path):
    with pytest.raises(BagError, match=f"/{CONTACTS}.*wrench_source: contacts; `torques` and `sensors`"):
        Session(bag, by("contacts"))
    strip = lambda stream, message: replace(message, effort=None) if stream == JOINTS else message  # noqa: E731
    bare = write_bag(tmp_path / "bare", walk(1.0), strip, skip=(LEFT, RIGHT))
    with pytest.raises(BagError, match="gives no torques .effort., which streams.wrench_source: torques needs"):
        Session(bare, by("torques"))


@pytest.mark.slow
def test_results_say_the_source(tmp_path):
    with Session(bag_path("test1"), by("torques").replaced({"prediction.horizons": []})) as session:
        summary = predict_bag(session, tmp_path / "out")
        assert not session.warnings
    assert summary["wrench_source"] == "torques"
    assert summary["flags"]["COMPUTED_WRENCH"] == summary["samples"]
    assert summary["mismatches"] == []


def test_with_torques_and_the_measured_zmp_the_joint_states_are_enough(tmp_path):
    """And ground that neither IMU nor plan knows is said to be taken as level."""
    bag = write_bag(tmp_path / "bag", walk(4.0), skip=(LEFT, RIGHT, MOTORS))
    with Session(bag, by("torques").replaced({"prediction.reference": "none"})) as session:
        summary = predict_bag(session, tmp_path / "out")
    assert summary["judged_samples"] > 0 and summary["ground"]["source"] == "none"
    (said,) = [each for each in summary["warnings"] if "the ground is not known" in each]
    assert "taken as level (model.slope: level says that it is)" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "shown", "hidden"),
    [
        ("torques", ("joint_stiffness", "encoder_bias", "ground_slope"), ("payload", "wrench_bias", "joint_friction")),
        ("contacts", ("encoder_bias", "ground_slope"), ("joint_stiffness", "payload", "ground_compliance")),
    ],
)
def test_a_diagnosis_by_computed_wrenches_offers_what_they_do_not_hide(source, shown, hidden, tmp_path):
    if source == "torques":
        bag = bag_path("test1")
    else:
        record(
            "stand", bag := tmp_path / "bag", sensors=SensorOptions(effort=False, contact_switches=True), duration_s=4.0
        )
    recording, robot = load(bag, by(source))
    world = World.nominal(robot, by(source).with_joints_of(robot))
    offered = {each.effect for each in candidates(unknowns(recording, world))}
    assert offered >= set(shown) and not offered & set(hidden)
    residuals = evaluate(recording, world, masks(recording, world)).residuals
    said = {name.partition("/")[0] for name, values in residuals.items() if np.isfinite(values).any()}
    assert said >= {"feet", "tilt"} and ("spring" in said) == (source == "torques")
    assert not said & {"force", "moment", "torque", "landing", "unloaded"}
    assert f"foot wrenches are computed from {source}: they hold the balance" in recording.warnings[-1]
    with pytest.raises(ConfigError, match=f"--assume {hidden[0]}: cannot be fitted to these bags"):
        check_recordings([Reading(bag, recording, robot)], 1, by(source), [(hidden[0], "")])


def test_a_baseline_needs_measured_wrenches():
    with pytest.raises(ConfigError, match="wrench_source: torques: a baseline needs measured foot wrenches"):
        baseline([bag_path("test1"), bag_path("test2")], by("torques"))
