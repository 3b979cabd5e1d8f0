# SPDX-License-Identifier: BSD-3-Clause
"""Messages that are published, from core types: by the classes of rclpy and of bags, and as bytes."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

from coman_reduced_model import messages as m
from coman_reduced_model.bag.encode import (
    encode_deflection,
    encode_external_wrench,
    encode_odometry,
    encode_point,
    encode_prediction,
    encode_support,
    encode_transforms,
)
from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.session import Session
from coman_reduced_model.bag.types import bag_types, typestore
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.base.types import (
    DeflectionPrediction,
    Estimate,
    Flags,
    Foot,
    HorizonPrediction,
    Phase,
    Prediction,
    SupportState,
    TrunkRotation,
)
from coman_reduced_model.report.verdict import sentence

ROS, BAG = m.ros_types(), bag_types()
KINDS = pytest.mark.parametrize("types", [ROS, BAG], ids=["rclpy", "rosbags"])
STAMP = 1_700_000_000_123_456_789


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
            rng.normal(size=(3, 3)), 2.5, rng.normal(size=3), rng.normal(size=(6, 3)),
            TrunkRotation(
                Rotation.random(random_state=seed + 1).as_matrix(), rng.normal(size=3), rng.normal(size=(6, 6)), True
            ),
            rng.normal(size=3), rng.normal(size=(3, 3)),
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
    trunk, o = sent.estimate.trunk, message.estimated_orientation
    assert Rotation.from_quat([o.x, o.y, o.z, o.w]).as_matrix() == pytest.approx(trunk.R, abs=1e-12)
    assert xyz(message.estimated_angular_velocity) == trunk.angular_velocity.tolist()
    assert message.estimated_rotation_covariance.tolist() == trunk.covariance.ravel().tolist()
    assert message.estimated_by_imu is True
    assert xyz(message.estimated_ground_velocity) == sent.estimate.ground_vel.tolist()
    assert message.estimated_ground_velocity_covariance.tolist() == sent.estimate.ground_vel_covariance.ravel().tolist()
    assert m.prediction_from(message).estimate.ground_vel.tolist() == sent.estimate.ground_vel.tolist()
    read = m.prediction_from(message).estimate.trunk
    assert pytest.approx(trunk.R, abs=1e-12) == read.R and read.by_imu
    assert read.covariance.tolist() == trunk.covariance.tolist()


def test_predictions_of_the_version_before_are_read_and_reported(tmp_path):
    """The output of `coman predict` 0.2.0 of one second: its bag has the definitions of then, without covariances."""
    folder = Path(shutil.copytree(ROOT / "test/data/predicted_0.2.0", tmp_path / "predicted"))
    with Bag(folder / "predictions") as bag:
        (topic,) = [topic for topic, kind in bag.topics.items() if kind == m.COM_PREDICTION]
        read = [m.prediction_from(message) for _, _, message in bag.messages([topic])]
    summary = json.loads((folder / "summary.json").read_text())
    assert len(read) == summary["samples"] == 50
    last = read[-1]
    assert last.flags == Flags.OK and np.isfinite(last.residual).all()
    assert [each.h for each in last.horizons] == [0.1, 0.2, 0.4]
    assert all(np.isfinite(each.com).all() for each in last.horizons)
    for unknown in (last.predicted_covariance, last.horizons[0].covariance, last.horizons[0].model_share):
        assert np.isnan(unknown).all()
    assert np.isnan(last.estimate.com).all() and np.isnan(last.estimate.covariance).all()
    assert np.isnan(last.estimate.trunk.R).all() and np.isnan(last.estimate.trunk.covariance).all()
    assert run(["report", str(folder)]) == 0
    assert sentence(summary) in (folder / "report.html").read_text(encoding="utf-8")


def test_a_recording_of_the_version_before_is_predicted():
    """The first seconds of test 1 as 0.2.0 recorded it: its plan previews no feet."""
    with Session(ROOT / "test/data/recorded_0.2.0.mcap") as session:
        predictions = list(session.predictions())
        rejected = session.pipeline.status().rejected
    assert len(predictions) == 500 and not rejected
    assert all(np.isfinite(p.reference_com).all() for p in predictions)
    residuals = np.array([p.residual for p in predictions])
    assert np.sqrt(np.nanmean(residuals**2, axis=0)).max() < 5e-4
    assert all(np.isfinite(each.com).all() for each in predictions[-1].horizons)


def test_an_external_wrench_has_force_before_moment():
    sent = a_prediction()
    message, estimate = m.external_wrench_to(BAG, sent), sent.estimate
    assert xyz(message.wrench.force) == estimate.force.tolist()
    assert xyz(message.wrench.torque) == estimate.moment.tolist()
    covariance = np.reshape(message.covariance, (6, 6))
    np.testing.assert_array_equal(covariance[:3, :3], estimate.force_covariance)
    np.testing.assert_array_equal(covariance[:, 3:], estimate.moment_covariance)
    np.testing.assert_array_equal(covariance[3:, :3], estimate.moment_covariance[:3].T)


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
