# SPDX-License-Identifier: BSD-3-Clause
"""Messages to core types and back, alike for the classes of rclpy and of bags, and for bytes."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from coman_reduced_model import messages as m
from coman_reduced_model.bag.decode import decoder
from coman_reduced_model.bag.encode import (
    encode_deflection,
    encode_external_wrench,
    encode_odometry,
    encode_point,
    encode_prediction,
    encode_support,
    encode_transforms,
)
from coman_reduced_model.bag.types import bag_types, typestore
from coman_reduced_model.core.base.pose import quaternion
from coman_reduced_model.core.base.types import (
    DeflectionPrediction,
    Estimate,
    Flags,
    Foot,
    HorizonPrediction,
    ImuMessage,
    JointMessage,
    Phase,
    Prediction,
    Reference,
    SupportState,
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
    return Reference(STAMP, *vectors_, *poses, Phase.LEFT, -1, 0.02, *preview)


@KINDS
def test_reference(types):
    for n in (0, 1, 25):
        sent = a_reference(n)
        got = m.reference_from(m.reference_to(types, sent))
        for name in sent.__slots__:
            assert np.asarray(getattr(got, name)) == pytest.approx(np.asarray(getattr(sent, name)), abs=1e-12)


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


def a_prediction(seed=0, horizons=3):
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    ahead = [
        HorizonPrediction(0.1 * (k + 1), *rng.normal(size=(1, 3)), rng.normal(size=(3, 3)), rng.normal(size=3))
        for k in range(horizons)
    ]
    support = SupportState(Phase.RIGHT, Foot.RIGHT, 0.25, 0.125, 300.0)
    return Prediction(
        STAMP + seed, "r_sole", support, *rng.normal(size=(6, 3)), T, ahead, Flags.RESET | Flags.NEAR_SINGULAR,
        predicted_covariance=rng.normal(size=(3, 3)),
        estimate=Estimate(
            *rng.normal(size=(2, 3)), rng.normal(size=(6, 6)), rng.normal(size=(3, 3)), rng.normal(size=3),
            rng.normal(size=(3, 3)), 2.5,
        ),
    )  # fmt: skip


def xyz(value):
    return [value.x, value.y, value.z]


@KINDS
def test_every_figure_of_a_prediction_is_in_its_message(types):
    sent = a_prediction()
    message = m.prediction_to(types, sent)
    assert m.stamp_of(message.header) == m.stamp_of(message.support.header) == sent.stamp_ns
    assert message.header.frame_id == message.support.header.frame_id == "r_sole"
    assert (message.support.phase, message.support.support_foot) == (2, 2)
    assert [message.support.left_share, message.support.phase_time, message.support.total_force] == [0.25, 0.125, 300.0]
    for name, value in (
        ("measured_position", sent.measured_com),
        ("measured_velocity", sent.measured_com_vel),
        ("reference_position", sent.reference_com),
        ("reference_velocity", sent.reference_com_vel),
        ("predicted_position", sent.predicted_com),
        ("predicted_velocity", sent.predicted_com_vel),
        ("residual", sent.measured_com - sent.predicted_com),
    ):
        assert xyz(getattr(message, name)) == value.tolist()
    assert m.matrix_from(message.sole_pose) == pytest.approx(sent.T_odom_sole, abs=1e-12)
    assert [each.h for each in message.horizons] == [each.h for each in sent.horizons]
    assert [xyz(each.position) for each in message.horizons] == [each.com.tolist() for each in sent.horizons]
    assert [each.covariance.tolist() for each in message.horizons] == [
        each.covariance.ravel().tolist() for each in sent.horizons
    ]
    assert [xyz(each.model_share) for each in message.horizons] == [each.model_share.tolist() for each in sent.horizons]
    assert message.predicted_covariance.tolist() == sent.predicted_covariance.ravel().tolist()
    assert message.flags == 48


def test_predictions_of_the_version_before_are_read():
    """Bags keep their definitions: those of version 1 have no covariances."""
    store, definitions = get_typestore(Stores.ROS2_JAZZY), {}
    names = """covariance model_share predicted_covariance estimated_position estimated_velocity estimated_covariance
        measured_covariance nis"""
    new_fields = [[name] for name in names.split()]
    for path in sorted((ROOT / "msg_defs" / "msg").glob("*.msg")):
        lines = [line.partition("#")[0].split() for line in path.read_text(encoding="utf-8").splitlines()]
        text = "\n".join(" ".join(words) for words in lines if words[1:2] not in new_fields)
        definitions.update(get_types_from_msg(text, f"{m.OWN}/msg/{path.stem}"))
    store.register(definitions)
    old, sent = m.MessageTypes(lambda name: store.types[name], lambda values: values), a_prediction()
    horizons = [
        old.HorizonPrediction(h=each.h, position=old.Point(**dict(zip("xyz", map(float, each.com), strict=True))))
        for each in sent.horizons
    ]
    new = m.prediction_to(BAG, sent)
    fields = {name: getattr(new, name) for name in old.ComPrediction.__dataclass_fields__ if name != "__msgtype__"}
    message = old.ComPrediction(**{**fields, "horizons": horizons})
    read = m.prediction_from(message)
    assert [each.com.tolist() for each in read.horizons] == [each.com.tolist() for each in sent.horizons]
    assert np.isnan(read.predicted_covariance).all() and np.isnan(read.horizons[0].model_share).all()
    assert np.isnan(read.estimate.com).all() and np.isnan(read.estimate.covariance).all()
    assert read.flags == sent.flags


@pytest.mark.parametrize("frame", ["", "l_sole", "r_sole_", "a", "left/sole"])
@pytest.mark.parametrize("horizons", [0, 1, 3, 8])
@pytest.mark.parametrize("seed", [0, 1])
def test_predictions_packed_at_once_are_the_messages_that_rosbags_serialises(frame, horizons, seed):
    sent = replace(a_prediction(seed, horizons), frame_id=frame)
    if seed:
        sent = replace(sent, predicted_com=np.full(3, math.nan), T_odom_sole=np.full((4, 4), math.nan))
    store = typestore()
    for raw, message, kind in (
        (encode_prediction(sent), m.prediction_to(BAG, sent), m.COM_PREDICTION),
        (encode_support(sent), m.support_to(BAG, sent), m.SUPPORT_STATE),
        (encode_external_wrench(sent), m.external_wrench_to(BAG, sent), m.EXTERNAL_WRENCH),
        (
            encode_point(sent.stamp_ns, sent.measured_com),
            m.point_to(BAG, sent.stamp_ns, sent.measured_com),
            m.POINT_STAMPED,
        ),
    ):
        assert raw == bytes(store.serialize_cdr(message, kind))
        assert repr(store.deserialize_cdr(raw, kind)) == repr(message)


@pytest.mark.parametrize("frame", ["", "l_sole", "r_sole_"])
@pytest.mark.parametrize("names", [["LHipSag"], ["a", "knee", "ankle_pitch"]])
@pytest.mark.parametrize("moments", [0, 1, 4])
def test_deflections_packed_at_once_are_the_messages_that_rosbags_serialises(frame, names, moments):
    rng = np.random.default_rng(moments)
    deflections = [
        DeflectionPrediction(0.1 * k, *rng.standard_normal((2, 3)), *rng.standard_normal((2, len(names))))
        for k in range(moments)
    ]
    sent = replace(a_prediction(), frame_id=frame, deflections=deflections, repeating=moments > 1)
    raw = encode_deflection(sent, tuple(name.encode() + b"\0" for name in names))
    message, store = m.deflection_to(BAG, sent, names), typestore()
    assert raw == bytes(store.serialize_cdr(message, m.COM_DEFLECTION))
    assert repr(store.deserialize_cdr(raw, m.COM_DEFLECTION)) == repr(message)


@pytest.mark.parametrize("root", ["base_link", "trunk"])
def test_odometry_and_transforms_packed_at_once_are_the_messages_that_rosbags_serialises(root):
    sent = replace(
        a_prediction(), base_in_sole=np.vstack([Rotation.random(rng=3).as_matrix(), np.arange(9.0).reshape(3, 3)])
    )
    store, odometry = typestore(), m.odometry_to(BAG, sent, root)
    assert encode_odometry(sent, root) == bytes(store.serialize_cdr(odometry, m.ODOMETRY))
    assert repr(m.odometry_to(ROS, sent, root).pose.pose) == repr(m.pose_to(ROS, sent.T_odom_base))
    first = m.transform_to(BAG, sent, root)
    place, turn = first.transform.translation, first.transform.rotation
    pose = np.array((place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
    second = replace(first, header=replace(first.header, frame_id=root), child_frame_id="l_sole")
    both = store.types[m.TRANSFORMS](transforms=[first, second])
    raw = encode_transforms(sent.stamp_ns, [("odom", root), (root, "l_sole")], np.array([pose, pose]))
    assert raw == bytes(store.serialize_cdr(both, m.TRANSFORMS))


def test_the_constants_of_the_messages_are_those_of_the_core():
    kinds = {"FLAG_": Flags, "FOOT_": Foot}
    for kind in (ROS.ComPrediction, ROS.SupportState, ROS.ComReference):
        for name in [name for name in dir(kind) if name.isupper() and name != "SLOT_TYPES"]:
            prefix = next((prefix for prefix in kinds if name.startswith(prefix)), "")
            assert getattr(kind, name) == kinds.get(prefix, Phase)[name.removeprefix(prefix)].value
    assert all(getattr(ROS.ComPrediction, f"FLAG_{flag.name}") == flag.value for flag in Flags)


def test_unknown_is_nan_in_messages_never_zero():
    nan = np.full(3, math.nan)
    sent = replace(a_prediction(horizons=0), predicted_com=nan, T_odom_sole=np.full((4, 4), math.nan))
    message = m.prediction_to(BAG, sent)
    assert all(
        map(math.isnan, xyz(message.predicted_position) + xyz(message.residual) + xyz(message.sole_pose.position))
    )
    assert math.isnan(message.sole_pose.orientation.w)


def test_both_serialise_to_what_the_other_reads():
    sent = a_prediction()
    raw = bytes(typestore().serialize_cdr(m.prediction_to(BAG, sent), m.COM_PREDICTION))
    assert repr(deserialize_message(raw, ROS.ComPrediction)) == repr(m.prediction_to(ROS, sent))
    raw = bytes(serialize_message(m.prediction_to(ROS, sent)))
    assert repr(typestore().deserialize_cdr(raw, m.COM_PREDICTION)) == repr(m.prediction_to(BAG, sent))


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
