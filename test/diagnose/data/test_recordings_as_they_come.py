# SPDX-License-Identifier: BSD-3-Clause
"""Recordings with flaws that loggers and drivers make: what is read of them, and what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import JOINTS, MOTORS, T0, walk, write_bag

from coman_reduced_model.core.base.stream_names import IMU
from coman_reduced_model.core.base.types import Foot, ImuMessage
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.diagnose.data.reading import refuse_repeated
from coman_reduced_model.diagnose.data.recording import load
from coman_reduced_model.diagnose.inference.case import prepare
from coman_reduced_model.errors import BagError


def test_of_a_bag_whose_time_goes_back_the_longest_run_is_read(tmp_path):
    once = walk(6.0)
    recording, _ = load(write_bag(tmp_path / "bag", [*walk(3.0), *once]), Config())
    assert recording.t[-1] == pytest.approx(6.0, abs=0.05)
    assert any("time goes back" in line for line in recording.warnings)
    alone, _ = load(write_bag(tmp_path / "alone", once), Config())
    assert np.abs(recording.q - alone.q[: len(recording.q)]).max() < 1e-9


def test_a_pause_of_an_hour_is_not_filled(tmp_path):
    """A recorder that was stopped and went on, or a clock that was set: what follows is another run."""
    later = [(stream, replace(each, stamp_ns=each.stamp_ns + 3_600 * 10**9)) for stream, each in walk(6.0)]
    recording, _ = load(write_bag(tmp_path / "bag", [*walk(3.0), *later]), Config())
    assert recording.t[-1] == pytest.approx(6.0, abs=0.05)
    assert any("joint states pause for 10 s and more, 1 times" in line for line in recording.warnings)


def test_orientations_are_those_of_the_run_that_is_read(tmp_path):
    """The IMU of the longer run starts late: there are more messages of it in the shorter one."""

    def with_imu(messages, begins, tilt):
        turned = Rotation.from_euler("x", tilt).as_quat()
        for stream, message in messages:
            yield stream, message
            if stream == JOINTS and (stamp := message.stamp_ns) >= T0 + 1e9 * begins:
                yield IMU, ImuMessage(stamp, "base_link", turned, np.zeros(3), np.array([0.0, 0.0, 9.81]))

    messages = [*with_imu(walk(5.0), 0.0, 0.1), *with_imu(walk(6.0), 2.0, 0.0)]
    recording, _ = load(write_bag(tmp_path / "bag", messages, imu=True), Config())
    assert recording.t[-1] == pytest.approx(6.0, abs=0.05)
    assert recording.up is None or abs(np.median(recording.up[:, 1])) < 0.02


def zeros(stream, message):
    return stream, replace(message, effort=np.zeros_like(message.effort)) if stream == JOINTS else message


def test_efforts_that_a_driver_fills_with_zeros_are_not_measured(tmp_path):
    recording, _ = load(write_bag(tmp_path / "bag", [zeros(*each) for each in walk(6.0)]), Config())
    assert recording.tau is None


def test_efforts_that_a_driver_fills_with_zeros_for_some_joints_are_not_measured_there(tmp_path):
    def change(stream, message):
        return replace(message, effort=message.effort * (np.arange(12) % 6 < 4)) if stream == JOINTS else message

    recording, _ = load(write_bag(tmp_path / "bag", walk(6.0), change), Config())
    assert recording.tau is not None and recording.valid.all()
    assert np.array_equal(np.isfinite(recording.tau).all(axis=0), np.arange(12) % 6 < 4)


def test_joint_states_at_25_hz_are_read(tmp_path):
    recording, _ = load(write_bag(tmp_path / "bag", walk(6.0, rate=25.0)), Config())
    assert recording.valid.mean() > 0.95


@pytest.mark.parametrize(("begins", "used"), [(0.5, True), (2.5, False)])
def test_motor_states_that_begin_late_are_a_gap_or_are_not_used(tmp_path, begins, used):
    messages = walk(6.0)
    first = begins / 6.0 * len(messages)
    late = [each for k, each in enumerate(messages) if each[0] != MOTORS or k > first]
    recording, _ = load(write_bag(tmp_path / "bag", late), Config())
    assert (recording.motor_q is not None) == used
    said = [line for line in recording.warnings if line.startswith("motor states are there")]
    if used:
        before = recording.t < begins - 0.15
        assert not recording.valid[before].any() and recording.valid[recording.t > begins].all() and not said
    else:
        assert recording.valid.all() and len(said) == 1 and "not used" in said[0]


def without_efforts(stream, message):
    return stream, replace(message, effort=None) if stream == JOINTS else message


def test_torques_that_stop_are_a_gap(tmp_path):
    messages = walk(6.0)
    last = round(0.9 * len(messages))
    messages[last:] = [without_efforts(*each) for each in messages[last:]]
    recording, _ = load(write_bag(tmp_path / "bag", messages), Config())
    assert recording.tau is not None and recording.valid[recording.t < 5.35].all()
    assert not recording.valid[recording.t > 5.55].any()


def test_torques_of_a_joint_that_are_seldom_there_are_not_used(tmp_path, joint=3):
    """They are no line from the last to the next value; the other joints have theirs."""

    def change(stream, message, k):
        if stream != JOINTS or k % 10 < 7:
            return stream, message
        effort = message.effort.copy()
        effort[joint] = np.nan
        return stream, replace(message, effort=effort)

    messages = [change(*each, k // 40) for k, each in enumerate(walk(6.0))]
    recording, robot = load(write_bag(tmp_path / "bag", messages), Config())
    assert recording.tau is not None and recording.valid.all()
    assert np.isfinite(recording.tau).all(axis=0).tolist() == [j != joint for j in range(12)]
    assert any(f"torques of {robot.joint_names[joint]} are there less" in line for line in recording.warnings)


def test_soft_ground_of_a_configuration_bends_no_joint(tmp_path):
    """It is part of the world: the springs bear what the encoders say."""
    bag = write_bag(tmp_path / "bag", walk(6.0))
    soft = Config().replaced({"effects.active": ["ground_compliance"], "effects.ground_compliance.rotational": [5e-4]})
    recording, robot = load(bag, soft)
    hard, _ = load(bag, Config())
    np.testing.assert_array_equal(recording.q, hard.q)
    _, world, _ = prepare(recording, robot, soft)
    assert world.tilting == pytest.approx(5e-4)


def test_an_effect_of_both_feet_or_of_a_leg_is_that_of_each_of_its_places(tmp_path):
    """Where a diagnosis looks at single feet and joints alone."""
    known = Config().replaced({
        "effects.active": ["foot_slip", "joint_friction"], "effects.foot_slip.where": [""],
        "effects.foot_slip.distance": [0.004], "effects.joint_friction.where": ["right"],
        "effects.joint_friction.coulomb": [0.5],
    })  # fmt: skip
    recording, robot = load(write_bag(tmp_path / "bag", walk(6.0)), known)
    recording, world, _ = prepare(recording, robot, known)
    np.testing.assert_allclose(world.slip, [0.004, 0.004])
    right = [robot.joint_names[i] for i in robot.legs[Foot.RIGHT]]
    wanted = [0.5 * (name in right) for name in robot.joint_names]
    np.testing.assert_allclose(world.friction, wanted)
    assert not [line for line in recording.warnings if "left out" in line]


@pytest.mark.parametrize(
    ("effect", "values", "field", "wanted"),
    [("joint_friction", {"coulomb": 0.5, "creep": 0.2}, "creep", 0.2),
     ("hysteresis", {"width": 0.004, "friction": 3.0}, "slips_at", 3.0)],
)  # fmt: skip
def test_what_only_single_joints_have_in_a_diagnosis_is_configured_for_all_of_a_leg(
    tmp_path, effect, values, field, wanted
):
    keys = {f"effects.{effect}.{key}": [value] for key, value in values.items()}
    known = Config().replaced({"effects.active": [effect], f"effects.{effect}.where": ["left"], **keys})
    recording, robot = load(write_bag(tmp_path / "bag", walk(6.0)), known)
    _, world, _ = prepare(recording, robot, known)
    np.testing.assert_allclose(getattr(world, field)[robot.legs[Foot.LEFT]], wanted)
    assert not np.isclose(getattr(world, field)[robot.legs[Foot.RIGHT]], wanted).any()


def test_an_effect_of_a_configuration_that_a_recording_cannot_show_is_said(tmp_path):
    one_foot = Config().replaced({
        "effects.active": ["ground_compliance"], "effects.ground_compliance.where": ["left"],
        "effects.ground_compliance.rotational": [5e-4],
    })  # fmt: skip
    recording, robot = load(write_bag(tmp_path / "bag", walk(6.0)), one_foot)
    recording, world, _ = prepare(recording, robot, one_foot)
    assert world.tilting == 0.0
    assert any(
        line.startswith("ground_compliance at left of the configuration is left out") for line in recording.warnings
    )


def test_a_bag_and_its_file_are_one_bag(tmp_path):
    bag = write_bag(tmp_path / "bag", walk(0.1))
    (file,) = bag.glob("*.mcap")
    with pytest.raises(BagError, match="given twice"):
        refuse_repeated([bag, file])
    refuse_repeated([bag, tmp_path / "other"])
