# SPDX-License-Identifier: BSD-3-Clause
"""Values that contradict physics cost their message, are counted with a reason, and change nothing else."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import recording
from synthetic import JOINTS, LEFT, MOTORS, REFERENCE, description, robot, walk

from coman_reduced_model.api import Session, load_config
from coman_reduced_model.core.base.types import Flags
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.core.robot.limits import joint_limits, leg_length, limits_of
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.resources import bag_path, config_path

WEIGHT = robot().mass * 9.81


def run(change, stream, settings=None):
    """A walk whose 100th message of a stream is changed; its pipeline and predictions."""
    pipeline, seen, found = Pipeline(robot(), settings or Config()), 0, []
    for name, message in walk(1.5, reference=True):
        seen += name == stream
        value = change(message) if name == stream and seen == 100 else message
        found += pipeline.feed(name, value, lambda each: each)
    return pipeline, found + pipeline.flush()


@cache
def unchanged():
    return run(lambda message: message, JOINTS)[1]


def put(field, index, value):
    def change(message):
        array = getattr(message, field).copy()
        array[index] = value
        return replace(message, **{field: array})

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stream", "change", "reason", "words"),
    [
        (JOINTS, put("position", 3, 40.0), "limit", "LKneeSag is at 40 rad"),
        (JOINTS, put("position", 3, 1.9), "step", "LKneeSag moves by"),
        (JOINTS, put("velocity", 3, -1e3), "speed", "LKneeSag moves at -1000 rad/s"),
        (MOTORS, put("position", 0, -9.0), "limit", "LHipSag is at -9 rad"),
        (MOTORS, put("velocity", 0, 1e8), "speed", "LHipSag"),
        (LEFT, put("force", 2, 30.0 * WEIGHT), "limit", "force"),
        (LEFT, put("torque", 1, 30.0 * WEIGHT), "limit", "moment"),
        (REFERENCE, put("com", 0, 1e5), "limit", "COM"),
        (REFERENCE, put("zmp", 0, 50.0), "limit", "ZMP"),
        (REFERENCE, put("com_vel", 0, 50.0), "limit", "velocity"),
    ],
)
def test_one_message_is_refused_and_the_rest_is_as_without_it(stream, change, reason, words):
    pipeline, found = run(change, stream)
    status = pipeline.status()
    assert status.rejected == {f"{stream}/{reason}": 1} and words in status.last_rejection[f"{stream}/{reason}"]
    expected = unchanged()
    by_stamp = {each.stamp_ns: each for each in expected}
    assert len(found) == len(expected) - (stream == JOINTS)
    off = [np.abs(each.measured_com - by_stamp[each.stamp_ns].measured_com).max() for each in found]
    assert np.nanmax(off) == 0.0


def test_a_posture_that_really_changed_is_believed_after_a_moment():
    """A glitch that lasts must not lock the true positions out for good."""
    pipeline, shift = Pipeline(robot(), Config().replaced({"prediction.reference": "none"})), 0.0
    for k, (stream, message) in enumerate(walk(2.0)):
        shift = 0.5 * (k > 800)
        moved = replace(message, position=message.position + shift) if stream == JOINTS else message
        pipeline.feed(stream, moved, lambda each: each)
    status = pipeline.status()
    assert 1 <= status.rejected["joint_states/step"] < 10 and status.samples > 380


def test_a_com_faster_than_any_runner_is_withheld():
    """Each joint may be as fast; all of them together are not."""
    pipeline, found = run(lambda message: replace(message, velocity=20.0 * np.tile([1, 0, 0, 1, 1, 0], 2)), JOINTS)
    assert not pipeline.status().rejected
    (lost,) = [each for each in found if Flags.NOT_INITIALISED in each.flags]
    assert Flags.REJECTED_STATE in lost.flags
    assert np.isnan(lost.predicted_com).all() and np.isnan(lost.measured_com_vel).all() and not lost.horizons


def test_limits_scale_with_the_robot_and_where_the_urdf_has_none_there_are_none():
    limits = limits_of(robot(), 9.81, WEIGHT)
    lower, upper = joint_limits(robot())
    assert leg_length(robot()) == pytest.approx(0.2258 + 0.201 + 0.09, abs=0.01)
    assert (limits.lower < lower).all() and (limits.upper > upper).all() and limits.force == pytest.approx(20 * WEIGHT)
    text = description().replace('type="revolute"', 'type="continuous"')
    free = limits_of(Robot(text, Config().robot), 9.81, WEIGHT)
    assert np.isinf([free.lower, free.upper, free.step]).all() and np.isfinite(free.speed).all()


def lost(path, config):
    """What of a recording is refused as impossible, and the samples whose COM is."""
    with Session(path, config.replaced({"prediction.horizons": []})) as session:
        found = list(session.predictions())
        rejected = session.pipeline.status().rejected
    assert found
    return [key for key in rejected if key.endswith(("/limit", "/step", "/speed"))]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stand", "test2"])
def test_shipped_walks_lose_nothing(name):
    assert lost(bag_path(name), load_config()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "config"),
    [("other_robot/walk_006", ""), ("real/icub_walk", "icub"), ("real/icub_yoga/raw", "real/icub_yoga/icub02.yaml")],
)
def test_recordings_of_other_robots_lose_nothing(name, config):
    file = config_path(config or "coman") if "/" not in config else recording(config)
    assert lost(recording(name), load_config(file)) == []
