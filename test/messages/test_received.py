# SPDX-License-Identifier: BSD-3-Clause
"""Messages that are received, to core types and back: by the classes of rclpy and of bags, and from bytes."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation

from coman_reduced_model import messages as m
from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.bag.types import bag_types, typestore
from coman_reduced_model.core.base.pose import quaternion
from coman_reduced_model.core.base.types import (
    ImuMessage,
    JointMessage,
    Phase,
    PlannedSteps,
    Reference,
    WrenchMessage,
)
from coman_reduced_model.core.streams.stream import Refused

ROS, BAG = m.ros_types(), bag_types()
KINDS = pytest.mark.parametrize("types", [ROS, BAG], ids=["rclpy", "rosbags"])
STAMP = 1_700_000_000_123_456_789

numbers = st.floats(allow_nan=True, allow_infinity=True)
stamps = st.integers(0, 2**31 * 10**9 - 1)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
vectors = st.lists(numbers, min_size=3, max_size=3).map(np.array)
frames = st.sampled_from(["", "l_sole", "a_frame_of_another_length"])


def doubles(size):
    return st.one_of(st.none(), st.lists(numbers, min_size=size, max_size=size).map(np.array)) if size else st.none()


@st.composite
def joint_messages(draw):
    names = tuple(draw(st.lists(texts, max_size=9)))
    n = len(names)
    position = np.array(draw(st.lists(numbers, min_size=n, max_size=n)))
    return JointMessage(draw(stamps), names, position, draw(doubles(n)), draw(doubles(n)))


wrenches = st.builds(WrenchMessage, stamps, frames, vectors, vectors)


def same(a, b):
    """Equal, NaN included."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return a is not None and b is not None and np.array_equal(a, b, equal_nan=True)
    if hasattr(a, "__slots__") and not isinstance(a, (str, int, float)):
        return all(same(getattr(a, name), getattr(b, name)) for name in a.__slots__)
    return a == b or (a != a and b != b)


def cdr(message, kind):
    """Bytes as rosbags and as rclpy make them."""
    return bytes(typestore().serialize_cdr(message, kind))


@given(joint_messages())
def test_joint_states_survive_every_way(message):
    bag, ros = m.joint_to(BAG, message), m.joint_to(ROS, message)
    raw = cdr(bag, m.JOINT_STATE)
    decode = decoder("joint_states")
    ways = [m.joint_from(bag), m.joint_from(ros), decode(raw), decode(bytes(serialize_message(ros))), decode(raw)]
    assert all(same(way, message) for way in ways)


@given(st.lists(wrenches, min_size=1, max_size=4))
def test_wrenches_survive_every_way_also_when_the_frame_changes(messages):
    decode = decoder("left_foot/wrench")
    for message in messages:
        bag, ros = m.wrench_to(BAG, message), m.wrench_to(ROS, message)
        ways = [
            m.wrench_from(bag),
            m.wrench_from(ros),
            decode(cdr(bag, m.WRENCH_STAMPED)),
            decode(bytes(serialize_message(ros))),
        ]
        assert all(same(way, message) for way in ways)


@given(st.lists(joint_messages(), min_size=2, max_size=5))
def test_a_decoder_is_not_confused_by_names_that_change(messages):
    decode = decoder("joint_states")
    for message in messages:
        assert same(decode(cdr(m.joint_to(BAG, message), m.JOINT_STATE)), message)


@given(st.binary(max_size=200), st.sampled_from(list(m.INPUT_TYPES)))
def test_bytes_that_are_no_message_are_refused(raw, stream):
    decode = decoder(stream)
    for candidate in (raw, b"\0\1\0\0" + raw, b"\0\0\0\0" + raw):
        try:
            decode(candidate)
        except Refused as refused:
            assert refused.reason in ("malformed", "length", "phase", "frame", "preview")


@given(joint_messages(), st.data())
def test_a_message_that_was_cut_is_refused_or_shorter(message, data):
    raw = cdr(m.joint_to(BAG, message), m.JOINT_STATE)
    decode = decoder("joint_states")
    decode(raw)
    try:
        decode(raw[: data.draw(st.integers(0, len(raw) - 1))])
    except Refused as refused:
        assert refused.reason == "malformed"


def test_messages_of_the_other_byte_order_are_read():
    message = JointMessage(STAMP, ("a", "bc"), np.array([1.0, 2.0]), None, None)
    raw = typestore().serialize_cdr(m.joint_to(BAG, message), m.JOINT_STATE, little_endian=False)
    assert same(decoder("joint_states")(bytes(raw)), message)


@KINDS
def test_imu(types):
    known = ImuMessage(STAMP, "base_link", np.array([0.0, 0.0, 0.6, 0.8]), np.arange(3.0), np.arange(3.0) + 9.0)
    decode = decoder("imu")
    for sent in (known, replace(known, orientation=None), replace(known, frame_id="another_imu")):
        message = m.imu_to(types, sent)
        raw = cdr(message, m.IMU_TYPE) if types is BAG else bytes(serialize_message(message))
        assert same(m.imu_from(message), sent) and same(decode(raw), sent)


def a_reference(n=4):
    rng = np.random.default_rng(3)
    poses = [np.eye(4), np.eye(4)]
    poses[0][:3, :3] = Rotation.from_euler("z", 0.3).as_matrix()
    poses[1][:3, 3] = [0.1, -0.2, 0.3]
    vectors_ = rng.normal(size=(4, 3))
    preview = rng.normal(size=(2, n, 3))
    steps = PlannedSteps(STAMP, 0.02, preview[0], rng.normal(size=(n, 14)), rng.integers(0, 4, n)) if n else None
    return Reference(STAMP, *vectors_, *poses, Phase.LEFT, -1, 0.02, *preview, steps)


@KINDS
def test_reference(types):
    for n in (0, 1, 25):
        sent = a_reference(n)
        got = m.reference_from(m.reference_to(types, sent))
        for name in set(sent.__slots__) - {"steps"}:
            assert np.asarray(getattr(got, name)) == pytest.approx(np.asarray(getattr(sent, name)), abs=1e-12)
        assert same(got.steps, sent.steps)


@given(st.lists(st.tuples(frames, st.integers(0, 9), st.integers(0, 3)), min_size=1, max_size=4))
def test_plans_decoded_at_once_are_those_decoded_in_general(changes):
    decode = decoder("com/reference")
    for frame, n, seed in changes:
        sent = replace(a_reference(n), com=np.random.default_rng(seed).normal(size=3))
        if seed % 2:  # one foot has moved, the other has not
            sent.T_odom_left[:3, 3] += seed
        for message, raw in (
            (bag := m.reference_to(BAG, sent), cdr(bag, m.COM_REFERENCE)),
            (ros := m.reference_to(ROS, sent), bytes(serialize_message(ros))),
        ):
            assert same(decode(raw), m.reference_from(message))
            message.header.frame_id = frame
            raw = cdr(message, m.COM_REFERENCE) if message is bag else bytes(serialize_message(message))
            with pytest.raises(Refused, match="frame"):
                decode(raw)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"phase": 7}, "phase"),
        ({"preview_position": np.zeros(4)}, "length"),
        ({"preview_velocity": np.zeros(3)}, "length"),
        ({"preview_soles": np.zeros(14)}, "length"),
        ({"preview_phase": np.zeros(3, dtype=np.uint8)}, "length"),
        ({"preview_soles": np.zeros(0)}, "length"),
        ({"preview_phase": np.full(4, 4, dtype=np.uint8)}, "phase"),
        ({"preview_dt": 0.0}, "preview"),
        ({"preview_dt": math.nan}, "preview"),
        ({"header": SimpleNamespace(frame_id="map", stamp=SimpleNamespace(sec=1, nanosec=0))}, "frame"),
    ],
)
def test_a_reference_that_contradicts_itself_is_refused(change, reason):
    message = m.reference_to(BAG, a_reference())
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(Refused) as caught:
        m.reference_from(message)
    assert caught.value.reason == reason
    if reason != "frame":  # tried with real headers above
        with pytest.raises(Refused) as caught:
            decoder("com/reference")(cdr(message, m.COM_REFERENCE))
        assert caught.value.reason == reason


@given(st.integers(0, 2**32 - 1), st.sampled_from([None, (math.pi, 0, 0), (0, math.pi, 0), (0, 0, math.pi), (0, 0, 0)]))
def test_quaternions_are_unit_and_turn_back_into_the_rotation(seed, special):
    rotation = Rotation.random(random_state=seed) if special is None else Rotation.from_euler("xyz", special)
    R = rotation.as_matrix()
    x, y, z, w = quaternion(R)
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0, abs=1e-12) and w >= 0.0
    assert Rotation.from_quat([x, y, z, w]).as_matrix() == pytest.approx(R, abs=1e-9)
    pose = m.pose_to(BAG, np.block([[R, np.arange(3.0)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    assert m.matrix_from(pose)[:3, :3] == pytest.approx(R, abs=1e-9)


def test_a_pose_without_orientation_has_no_rotation():
    pose = BAG.Pose(position=BAG.Point(x=0.0, y=0.0, z=0.0), orientation=BAG.Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))
    assert np.isnan(m.matrix_from(pose)[:3, :3]).any()


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.5), (np.nan, 0.0, 0.0, 1.0)])
def test_an_orientation_that_is_no_rotation_is_not_known(quaternion):
    """Drivers that estimate none leave the field at zero, and its covariance too."""
    types = m.ros_types()
    message = types.Imu()
    message.orientation = types.Quaternion(**dict(zip("xyzw", quaternion, strict=True)))
    assert m.imu_from(message).orientation is None
