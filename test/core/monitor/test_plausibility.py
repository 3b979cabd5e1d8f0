# SPDX-License-Identifier: BSD-3-Clause
"""Wiring faults and sensor bias that no single message shows, on a synthetic walk."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from conftest import recording
from synthetic import LEFT, RIGHT, T0, robot, walk

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.base.input_warning import WarningKind
from coman_reduced_model.core.base.stream_names import IMU, JOINTS, MOTORS
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.monitor.plausibility import Plausibility
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.resources import bag_path, config_path
from coman_reduced_model.sim.contact import Floor
from coman_reduced_model.sim.worlds import record_world
from coman_reduced_model.sim.worlds.draw import world_of

PLAIN = Config().replaced({"prediction.horizons": []})


def warnings_of(change):
    pipeline = Pipeline(robot(), PLAIN)
    for stream, message in walk(6.0):
        stream, message = change(stream, message)
        pipeline.feed(stream, message, lambda message: message)
    pipeline.flush()
    return pipeline.status().warnings


def test_wrong_sign_is_reported():
    def flipped(stream, message):
        return (stream, replace(message, force=-message.force)) if stream == LEFT else (stream, message)

    assert warnings_of(lambda *item: item) == ()
    (warning,) = warnings_of(flipped)
    assert (warning.kind, warning.stream) == (WarningKind.SIGN, LEFT) and not warning.prevents_prediction
    assert str(warning).startswith(LEFT) and "sign" in warning.text


def test_swapped_feet_are_reported():
    def swapped(stream, message):
        if stream in (LEFT, RIGHT):
            stream, frame = (RIGHT, "r_sole") if stream == LEFT else (LEFT, "l_sole")
            message = replace(message, frame_id=frame)
        return stream, message

    (warning,) = warnings_of(swapped)
    assert warning.kind is WarningKind.SWAPPED and "swapped" in warning.text


def test_velocities_that_are_never_filled_in():
    def silent(stream, message):
        return stream, replace(message, velocity=np.zeros(12)) if stream == JOINTS else message

    (warning,) = warnings_of(silent)
    assert (warning.kind, warning.stream) == (WarningKind.HELD, JOINTS) and "velocities are 0" in warning.text


def held(first, last, every=1.0):
    """Sensors with noise; the driver of the left one hangs from `first` to `last` of each period [s]."""
    kept, rng = {}, np.random.default_rng(0)

    def change(stream, message):
        if stream in (LEFT, RIGHT):
            message = replace(message, force=message.force + rng.normal(0.0, 0.5, 3))
        if stream == LEFT:
            hangs = first <= (message.stamp_ns - T0) * 1e-9 % every < last
            message = replace(message, **kept) if hangs and kept else message
            kept.update(force=message.force, torque=message.torque)
        return stream, message

    return change


@pytest.mark.slow
def test_a_foot_sensor_that_hangs_is_reported():
    (warning,) = warnings_of(held(0.3, 0.45))
    assert (warning.kind, warning.stream) == (WarningKind.HELD, LEFT) and not warning.prevents_diagnosis
    assert re.search(r"same value for up to 0.1\d s .* [3-6] times: does its driver hang", warning.text)
    (dead,) = warnings_of(held(2.2, 60.0, 60.0))  # for good, while it bears load
    assert dead.kind is WarningKind.HELD
    assert warnings_of(held(0.3, 0.34)) == ()  # as a slow sensor does


@pytest.mark.slow
@pytest.mark.parametrize("zeros", [(-1.26, -1.78), (0.6, -0.9), (2.0, 1.5)])
def test_large_zeros_do_not_look_like_swapped_feet(zeros):
    """In weights; with the first ones a foot in the air reads a larger magnitude than one that stands."""

    def shifted(stream, message):
        if stream in (LEFT, RIGHT):
            zero = zeros[stream == RIGHT] * robot().mass * 9.81
            message = replace(message, force=message.force + np.array([0.0, 0.0, zero]))
        return stream, message

    assert {each.kind for each in warnings_of(shifted)} == {WarningKind.ZERO}


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.03, 0.06, 0.2])
def test_bias_of_a_foot_in_the_air_is_reported(share):
    """Above contact_off, 4 % of the weight, its lift-offs are missed and the robot appears to be in double support."""

    def biased(stream, message):
        if stream == RIGHT:
            message = replace(message, force=message.force + np.array([0.0, 0.0, share * robot().mass * 9.81]))
        return stream, message

    warnings = warnings_of(biased)
    kind = WarningKind.ZERO if share > 0.1 else WarningKind.BIAS  # the weight shows it: taken off
    assert [(each.kind, each.stream) for each in warnings] == [(kind, RIGHT)] * (share > 0.04)
    assert all("lift-offs are missed" in each.text or "taken off" in each.text for each in warnings)


@pytest.mark.parametrize(
    ("streams", "field", "factor", "words"),
    [
        ((JOINTS, MOTORS), "position", 180.0 / np.pi, "in degrees"),
        ((MOTORS,), "position", 100.0, "before the gear"),
        ((LEFT, RIGHT), "force", 1.0 / 9.81, "in kilograms"),
    ],
)
def test_other_units_are_reported(streams, field, factor, words):
    def scaled(stream, message):
        return stream, (replace(message, **{field: factor * getattr(message, field)}) if stream in streams else message)

    found = [each for each in warnings_of(scaled) if each.kind is WarningKind.UNIT]
    assert len(found) == 1 and words in found[0].text and found[0].prevents_diagnosis


def warnings_of_walk(change):
    """Of the shipped walk, whose torques and IMU belong to its forces."""
    with Session(bag_path("test1"), Config()) as session:
        decoders, pipeline = session.decoders, Pipeline(session.robot, PLAIN)
        for stream, _, raw in islice(session.messages(), 4000):
            pipeline.feed(stream, change(stream, decoders[stream](raw)), lambda message: message)
    return pipeline.status().warnings


def knee_reversed(stream, *fields):
    def change(name, message):
        if name != stream:
            return message
        sign = np.where(np.array(message.names) == "LKneeSag", -1.0, 1.0)
        return replace(message, **{field: sign * getattr(message, field) for field in fields})

    return change


def scaled(stream, field, factor):
    def change(name, message):
        return replace(message, **{field: factor * getattr(message, field)}) if name == stream else message

    return change


def other_order(stream, message):
    return replace(message, orientation=message.orientation[[3, 0, 1, 2]]) if stream == IMU else message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (scaled(JOINTS, "effort", -1.0), WarningKind.SIGN, "torques are -0."),
        (scaled(JOINTS, "effort", 1000.0), WarningKind.UNIT, "wanted are Nm"),
        (scaled(JOINTS, "effort", 1.0 / 9.81), WarningKind.UNIT, "wanted are Nm"),
        (knee_reversed(JOINTS, "effort"), WarningKind.SIGN, "torques of LKneeSag are against"),
        (
            knee_reversed(MOTORS, "position", "velocity"),
            WarningKind.SIGN,
            "motor and joint of LKneeSag turn in opposite directions",
        ),
        (scaled(IMU, "linear_acceleration", 1.0 / 9.81), WarningKind.UNIT, "in units of gravity"),
        (scaled(IMU, "linear_acceleration", -1.0), WarningKind.SIGN, "wanted is up"),
        (other_order, WarningKind.UNIT, "w x y z"),
        (lambda _, message: message, None, ""),
    ],
)
def test_torques_motors_and_imu_must_agree_with_the_rest(change, kind, words):
    found = warnings_of_walk(change)
    assert [each.kind for each in found] == ([] if kind is None else [kind])
    assert all(words in each.text and each.prevents_diagnosis for each in found)


def warnings_with_turned_wrenches(bag, left, right, config=None, zero=0.0):
    """By quarters of a turn about the vertical, of each foot, then with a zero (6,) of the left foot."""
    quarter = np.kron(np.eye(2), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    turns = [np.linalg.matrix_power(quarter, k) for k in (left, right)]
    with Session(bag, config or Config()) as session:
        plausibility = Plausibility(session.robot, session.config)
        for sample in session.samples():
            if sample.left_wrench is not None and sample.right_wrench is not None:
                sample.left_wrench, sample.right_wrench = turns[0] @ sample.left_wrench, turns[1] @ sample.right_wrench
                sample.left_wrench = sample.left_wrench + zero
            plausibility.update(sample)
    return plausibility.warnings()


@pytest.mark.parametrize("bag", ["test1", "stand"])
@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        (1, 1, "wrenches: turned about the vertical, by 90 degrees counterclockwise"),
        (3, 3, "wrenches: turned about the vertical, by 90 degrees clockwise"),
        (0, 3, f"{RIGHT}: turned about the vertical, by 90 degrees clockwise"),
        (0, 0, ""),
    ],
)
def test_wrenches_turned_about_the_vertical_are_reported(bag, left, right, words):
    found = warnings_with_turned_wrenches(bag_path(bag), left, right)
    assert [each.kind for each in found] == [WarningKind.TURNED] * bool(words)
    assert all(each.text.startswith(words) and each.prevents_diagnosis for each in found)


@pytest.mark.slow
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.1), (0.1, 0.1)])
def test_on_a_slope_wrenches_are_not_taken_for_turned(tmp_path, roll, pitch):
    world = replace(
        world_of("slope"), gait="stand", gait_changes={}, floor=Floor(roll=roll, pitch=pitch), duration_s=4.0
    )
    record_world(world, tmp_path / "bag")
    assert not warnings_with_turned_wrenches(tmp_path / "bag", 0, 0)


@pytest.mark.parametrize("force", [-150.0, 100.0, 300.0])
def test_a_sensor_without_its_zero_is_not_taken_for_turned(force):
    zero = np.array([80.0, -60.0, force, 10.0, -12.0, 5.0])
    found = warnings_with_turned_wrenches(bag_path("test1"), 0, 0, zero=zero)
    assert WarningKind.TURNED not in [each.kind for each in found]


@pytest.mark.parametrize(
    ("name", "config"),
    [("other_robot/walk_003", None), ("real/icub_walk", "icub"), ("real/icub_yoga/zeroed", "icub02")],
)
def test_wrenches_of_other_robots_are_not_taken_for_turned(name, config):
    """Those of icub_yoga have axes that are wrong by ten degrees."""
    bag = recording(name)
    file = None if config is None else bag.parent / "icub02.yaml" if config == "icub02" else config_path(config)
    found = warnings_with_turned_wrenches(bag, 0, 0, load_config(file))
    assert WarningKind.TURNED not in [each.kind for each in found]


def test_a_threshold_that_changes_counts_from_then_on():
    """A foot that reads 3 % of the weight in the air lifts at the usual threshold of 4 %, not at one of 2 %."""
    pipeline = Pipeline(robot(), Config())
    for stream, message in walk(6.0):
        if stream == RIGHT:
            message = replace(message, force=message.force + np.array([0.0, 0.0, 0.03 * robot().mass * 9.81]))
        pipeline.feed(stream, message, lambda message: message)
    assert pipeline.status().warnings == ()
    lower = Config().replaced({"support.contact_off": 0.02})
    pipeline.reconfigure(lower)
    assert pipeline.config is pipeline.predictor.config is lower and pipeline.predictor.support.config is lower.support
    (warning,) = pipeline.status().warnings
    assert (warning.kind, warning.stream) == (WarningKind.BIAS, RIGHT)


def test_what_is_missing_prevents_predictions():
    pipeline = Pipeline(robot(), Config())
    (nothing,) = pipeline.status().warnings
    assert nothing.kind is WarningKind.MISSING and nothing.prevents_prediction
    for stream, message in walk(0.5):
        if stream != LEFT:
            pipeline.feed(stream, message, lambda message: message)
    (missing,) = pipeline.status().warnings
    assert (missing.kind, missing.stream) == (WarningKind.MISSING, LEFT) and missing.prevents_prediction


@pytest.mark.parametrize(
    ("stream", "change", "words"),
    [
        (JOINTS, {"names": ("a",) * 12}, "joint_states: no usable message yet: no joint of the legs"),
        (LEFT, {"frame_id": "r_sole"}, "left_foot/wrench: no usable message yet.*: the wrench .* is in frame"),
    ],
)
def test_why_no_message_is_usable_is_said_with_it(stream, change, words):
    pipeline = Pipeline(robot(), Config())
    for name, message in walk(0.5):
        pipeline.feed(name, replace(message, **change) if name == stream else message, lambda message: message)
    (missing,) = pipeline.status().warnings
    assert missing.kind is WarningKind.MISSING and re.match(words, missing.text), missing.text
