# SPDX-License-Identifier: BSD-3-Clause
"""Faults of sensors, configured, are undone: what was recorded with them is predicted as if it had none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_tools import PAPER, config, on_one_leg, predicted, same, spoilt
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from synthetic import LEFT, RIGHT, T0, description, names, robot, walk

from coman_reduced_model.core.base.stream_names import JOINTS
from coman_reduced_model.core.base.types import Flags, Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.catalogue import build_effects, stream_delays
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.streams.joiner import Joiner
from coman_reduced_model.errors import ConfigError


@pytest.fixture(scope="module")
def clean():
    return predicted(walk(1.0), PAPER)[0]


@pytest.mark.parametrize("where", ["LKneeSag", "right", ""])
def test_bias_of_link_encoders_is_taken_off(clean, where):
    biased = [name for name in names() if where in ("", name) or (where == "right" and name.startswith("R"))]
    offset = 0.02 * np.isin(names(), biased)

    def change(stream, message):
        return replace(message, position=message.position + offset) if stream == JOINTS else message

    messages = spoilt(change)
    same(predicted(messages, config("encoder_bias", where, bias=0.02))[0], clean, 1e-9)
    blind = predicted(messages, PAPER)[0]
    assert max(np.nanmax(np.abs(p.measured_com - q.measured_com)) for p, q in zip(blind, clean, strict=True)) > 1e-3


@pytest.mark.parametrize("where, feet", [("left", [LEFT]), ("right", [RIGHT]), ("", [LEFT, RIGHT])])
def test_calibration_of_foot_sensors(clean, where, feet):
    bias = {"fx": 3.0, "fy": -4.0, "fz": 25.0, "tx": 1.0, "ty": -2.0, "tz": 0.5}
    both = np.array(list(bias.values()))

    def change(stream, message):
        if stream not in feet:
            return message
        return replace(message, force=1.2 * message.force + both[:3], torque=1.2 * message.torque + both[3:])

    # A sensor says scale * truth + bias, in whatever order the effects are named.
    settings = config("wrench_scale", where, scale=1.2).replaced(
        {
            "effects.active": ["wrench_scale", "wrench_bias"],
            "effects.wrench_bias.where": [where],
            **{f"effects.wrench_bias.{key}": [value] for key, value in bias.items()},
        }
    )
    results, _ = predicted(spoilt(change), settings)
    same(results, clean, 1e-9)
    for p, q in zip(results, clean, strict=True):
        np.testing.assert_allclose(p.support.left_share, q.support.left_share, atol=1e-9)


TURN = Rotation.from_rotvec([0.05, -0.12, 0.08]).as_matrix()
FT = """
    <link name="ft"/><joint name="ft_joint" type="fixed"><parent link="l_foot"/><child link="ft"/>
      <origin xyz="0.01 0.02 -0.03"/></joint>"""
SENSOR = '<sensor name="ft" type="force_torque"><parent joint="ft_joint"/></sensor>'


@pytest.mark.parametrize("known", ["by its frame", "by the URDF", "not"])
def test_axes_of_a_foot_sensor_are_turned_back_about_the_sensor(known):
    """What a sensor with turned axes measures, its moment about itself, is the moment of the truth about it."""
    text = description().replace("</robot>", f"{FT}{SENSOR if known == 'by the URDF' else ''}</robot>")
    machine = Robot(text, Config().robot)
    sole = machine.model.frames[machine.sole_ids[Foot.LEFT]].placement
    place = sole.actInv(machine.model.frames[machine.model.getFrameId("ft")].placement).translation
    at = np.zeros(3) if known == "not" else place
    truth = np.array([3.0, -5.0, 170.0, 1.0, -4.0, 0.3])
    force = TURN.T @ truth[:3]
    moment = TURN.T @ (truth[3:] - np.cross(at, truth[:3]))  # about the sensor, along its axes
    if known == "by its frame":
        read = machine.wrench_to_sole(Foot.LEFT, "ft", force, moment)
    else:
        read = np.concatenate([force, moment + np.cross(at, force)])
    angles = dict(zip(("roll", "pitch", "yaw"), Rotation.from_matrix(TURN).as_rotvec(), strict=True))
    effect = build_effects(config("sensor_rotation", "left", **angles).effects, machine)[0][0]
    sample = on_one_leg(0, np.zeros(12), np.zeros(12), machine)
    sample.left_wrench = read.copy()
    effect.correct(sample)
    np.testing.assert_allclose(sample.left_wrench, truth, atol=1e-9)
    assert np.linalg.norm(machine.sensor_position(Foot.LEFT) - at) < 1e-12


@pytest.mark.slow
@settings(deadline=None, max_examples=12)
@given(delay=st.floats(-0.19, 0.19), effect=st.sampled_from(["encoder_delay", "wrench_delay"]))
def test_late_streams_are_joined_at_their_true_time(delay, effect):
    """Exactly: to the last bit the predictions of the streams without delay, stamps included."""
    late = [JOINTS] if effect == "encoder_delay" else [LEFT, RIGHT]
    by = round(1e9 * delay)

    def change(stream, message):
        return replace(message, stamp_ns=message.stamp_ns + by) if stream in late else message

    results, pipeline = predicted(spoilt(change, 0.8), config(effect, delay=delay))
    expected, _ = predicted(walk(0.8), PAPER)
    # The streams begin and end at other times of arrival: the ends may differ in what is known there.
    middle = [(p, q) for p, q in zip(results, expected, strict=True) if 40 < (p.stamp_ns - T0) * 2e-7 < 120]
    assert len(middle) > 70
    for p, q in middle:
        assert p.stamp_ns == q.stamp_ns and p.flags == q.flags
        assert np.array_equal(p.measured_com, q.measured_com)
        assert p.support == q.support
        np.testing.assert_array_equal(p.predicted_com, q.predicted_com)
    # The clocks still differ, and that is said of delays that nobody could have meant.
    assert not any(np.isnan(list(pipeline.joiner.clock_lead_s.values())))


def test_one_late_foot_and_a_stamp_that_is_not_filled_in():
    settings = config("wrench_delay", "left", delay=-0.03)
    joiner = Joiner(robot(), settings, stream_delays(build_effects(settings.effects, robot())[0]))
    messages = dict(walk(0.01))
    joiner.add_wrench(Foot.LEFT, replace(messages[LEFT], stamp_ns=0))
    assert joiner.rejections.counts == {f"{LEFT}/zero_stamp": 1}
    joiner.add_wrench(Foot.LEFT, messages[LEFT])
    joiner.add_wrench(Foot.RIGHT, messages[RIGHT])
    assert joiner.streams[LEFT].last == messages[LEFT].stamp_ns + 30_000_000
    assert joiner.streams[RIGHT].last == messages[RIGHT].stamp_ns


def test_a_delayed_wrench_is_waited_for_longer_than_max_wait():
    """Without the effect 0.12 s are too late to be joined; with it no sample goes without its wrench."""

    def change(stream, message):
        return replace(message, stamp_ns=message.stamp_ns + 120_000_000) if stream in (LEFT, RIGHT) else message

    results, _ = predicted(spoilt(change), config("wrench_delay", delay=0.12))
    assert not any(p.flags & Flags.STALE_WRENCH for p in results)


@pytest.mark.parametrize(
    "effect, where, said",
    [
        ("encoder_bias", "LElbow", "'LElbow'"),
        ("encoder_bias", "both", "'both'"),
        ("wrench_bias", "LKneeSag", "'LKneeSag'"),
        ("encoder_delay", "left", "'left'"),
    ],
)
def test_places_that_do_not_exist_are_refused(effect, where, said):
    with pytest.raises(ConfigError) as refusal:
        Pipeline(robot(), config(effect, where))
    message = str(refusal.value)
    assert all(part in message for part in (f"effects.{effect}.where", said, "allowed"))
    assert "\n" not in message
