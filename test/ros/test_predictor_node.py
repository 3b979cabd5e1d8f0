# SPDX-License-Identifier: BSD-3-Clause
"""The predictor as users meet it: its description, parameters and topics."""

from __future__ import annotations

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComDeflection, ExternalWrench, SupportState
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_testing import NAMES, Peer, Standing, robot_urdf, stamp_of, vector
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from coman_reduced_model.core.base.types import Foot
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.ros.interface import qos

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("nodes_compiled")]


@pytest.mark.parametrize("order", ["node first", "sensors first", "description last"])
def test_any_order_of_start(start, peer, order):
    if order == "node first":
        node = start.node("predictor")
        node.wait_for("waiting for the URDF on /robot_description")
    standing = Standing(peer)
    if order != "description last":
        standing.describe()
    if order != "node first":
        standing.samples(20)
        node = start.node("predictor")
    if order == "description last":
        node.wait_for("waiting for the URDF on /robot_description")
        standing.describe()
    standing.wait_until_heard()
    standing.samples(50)
    peer.wait(lambda: len(peer.predictions) >= 50, "predictions")
    assert peer.predictions[-1].support.phase == SupportState.DOUBLE
    assert node.stop() == 0


@pytest.mark.parametrize("source", ["file", "parameter"])
def test_description_from(start, peer, tmp_path, source):
    urdf = tmp_path / "legs.urdf"
    urdf.write_text(robot_urdf())
    if source == "file":  # relative to the file that names it
        config = tmp_path / "robot.yaml"
        config.write_text("/**:\n  ros__parameters:\n    robot.urdf: legs.urdf\n    robot.gravity: 10\n")
        node = start.node("predictor", "--params-file", config)
    else:
        config = tmp_path / "description.yaml"
        text = "\n".join(f"      {line}" for line in robot_urdf().splitlines())
        config.write_text(f"/**:\n  ros__parameters:\n    robot_description: |\n{text}\n")
        node = start.node("predictor", "--params-file", config)
    node.wait_for("ready: coman, 17.30 kg")
    assert node.stop() == 0


BAD_URDFS = {  # the other ways are tested where URDFs are read
    "no frame": (lambda text: text.replace("l_sole", "left_sole"), "no frame 'l_sole'"),
    "no mass": (lambda text: '<robot name="x"><link name="base_link"/></robot>', "mass"),
}


@pytest.mark.parametrize("case", BAD_URDFS)
def test_urdf_that_cannot_be_used_ends_the_node_with_one_line(start, peer, case):
    change, wanted = BAD_URDFS[case]
    node = start.node("predictor")
    node.wait_for("waiting for the URDF")
    Standing(peer).describe(change(robot_urdf()))
    assert node.wait() == 2
    last = node.output.strip().splitlines()[-1]
    assert last.startswith("predictor: /robot_description: ") and wanted in last
    assert "Traceback" not in node.output


def test_every_topic_of_the_predictor_in_a_namespace(start, ros_domain):
    peer = Peer("robot1")
    try:
        got = {topic: [] for topic in ("support", "measured", "predicted", "reference_point", "markers")}
        kinds = (SupportState, PointStamped, PointStamped, PointStamped, MarkerArray)
        for (topic, received), kind in zip(got.items(), kinds, strict=True):
            peer.node.create_subscription(kind, f"/robot1/com/{topic}", received.append, 10)
        got["odometry"] = []
        peer.node.create_subscription(Odometry, "/robot1/foot_odometry", got["odometry"].append, 10)
        got["external"] = []
        peer.node.create_subscription(ExternalWrench, "/robot1/com/external_wrench", got["external"].append, 10)
        node = start.node("predictor", "-r", "__ns:=/robot1")
        standing = Standing(peer)
        standing.wait_until_published("/robot1/com/markers")
        standing.samples(100)
        peer.wait(lambda: len(peer.predictions) == 100, "a prediction for each joint state")
        peer.wait(lambda: all(got.values()), f"all topics, not only {[topic for topic in got if got[topic]]}")
        peer.wait(lambda: "robot1/predictor: prediction" in peer.statuses, "diagnostics under the node's full name")
        by_stamp = {stamp_of(message): message for message in peer.predictions}
        for topic in ("measured", "predicted", "reference_point"):
            assert {point.header.frame_id for point in got[topic]} == {"odom"}
            for point in got[topic]:  # odom is the first support sole, which has not moved
                wanted = getattr(by_stamp[stamp_of(point)], f"{topic.removesuffix('_point')}_position")
                np.testing.assert_allclose(vector(point.point), vector(wanted), atol=1e-9)
        markers = {marker.ns: marker for marker in got["markers"][-1].markers}
        assert set(markers) == {"measured", "predicted", "support_foot", "horizon"}
        assert {marker.header.frame_id for marker in markers.values()} == {"odom"}
        assert {marker.action for marker in markers.values()} == {Marker.ADD}
        com = by_stamp[stamp_of(markers["measured"])].measured_position
        np.testing.assert_allclose(vector(markers["measured"].pose.position), vector(com), atol=1e-9)
        foot, sole = (
            markers["support_foot"],
            Robot(robot_urdf(), Config().robot).soles[Foot.LEFT],
        )  # like the right one, but for the signs of y
        assert foot.scale.x == pytest.approx(sole[1] - sole[0]) and foot.scale.y == pytest.approx(sole[3] - sole[2])
        assert foot.pose.position.x == pytest.approx(0.5 * (sole[0] + sole[1]), abs=1e-9)
        root = got["odometry"][-1]
        assert (root.header.frame_id, root.child_frame_id) == ("odom", "base_link")
        assert 0.4 < root.pose.pose.position.z < 0.5 and root.twist.twist.linear.x == pytest.approx(0.0)
        external = got["external"][-1]
        assert external.header.frame_id == by_stamp[stamp_of(external)].header.frame_id
        assert np.isfinite(
            [*vector(external.wrench.force), *vector(external.wrench.torque), *external.covariance]
        ).all()
        support = got["support"][-1]
        assert support.phase == SupportState.DOUBLE and support.left_share == pytest.approx(0.5)
        assert support.header.frame_id == by_stamp[stamp_of(support)].header.frame_id
        assert node.stop() == 0
    finally:
        peer.close()


def test_deflections(start, peer):
    """One per joint state, with its stamp: of COM and joints, in m and rad, what is not known NaN or absent."""
    got = []
    peer.node.create_subscription(ComDeflection, "com/deflection", got.append, qos.prediction_output())
    node = start.node("predictor")
    standing = Standing(peer)
    standing.wait_until_published("com/deflection")
    standing.samples(200)
    peer.wait(lambda: len(got) == 200, "deflections for each joint state")
    assert [stamp_of(message) for message in got] == [stamp_of(each) for each in peer.predictions]
    last = got[-1]
    assert last.header.frame_id == peer.predictions[-1].header.frame_id
    assert list(last.joints) == list(NAMES) and not last.repeating
    assert [each.h for each in last.predictions] == [0.0, 0.1, 0.2, 0.4]
    now, *ahead = last.predictions
    moved = vector(peer.predictions[-1].measured_position) - vector(peer.predictions[-1].reference_position)
    np.testing.assert_allclose(vector(now.com), moved, atol=3e-3)  # [m], by the model's filter
    assert -0.02 < np.median(now.joints) < 0.0 and len(now.joints) == len(now.joint_sigma) == 12  # [rad]
    assert all(np.isfinite(each.joints).all() for each in ahead)
    assert all(np.isfinite(each.joint_sigma).all() for each in ahead)  # in one second some were judged
    first = got[0].predictions
    assert first and np.isnan(vector(first[1].com_sigma)).all() and np.isnan(first[1].joint_sigma).all()
    standing.samples(40, motor_stream=False)  # from a tenth of a second on without motors: no deflection is known
    peer.wait(lambda: len(got) > 220 and not got[-1].predictions, "a message without deflections")
    assert node.stop() == 0


def test_quality_of_service(start, peer):
    """Best-effort publishers are heard; and every profile can be overridden."""
    override = ("-p", "qos_overrides./joint_states.subscription.reliability:=reliable")
    careful = start.node("predictor", "-r", "__ns:=/careful", "-r", "joint_states:=/joint_states", *override)
    plain = start.node("predictor")
    standing = Standing(peer)
    standing.describe()
    named = peer.publisher(peer.types.String, "/careful/robot_description", qos.latched())
    named.publish(peer.types.String(data=robot_urdf()))
    for node in (careful, plain):
        node.wait_for("ready: coman")
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = peer.publisher(JointState, "joint_states", best_effort)
    peer.wait(lambda: publisher.get_subscription_count() == 1, "only the plain one hears best effort")
    peer.wait(lambda: standing.joints.get_subscription_count() == 2, "both hear reliable")
    for node in (careful, plain):
        assert node.stop() == 0


@pytest.mark.parametrize("switched", [True, False])
def test_where_the_root_link_is_goes_to_tf(start, peer, switched):
    messages = pytest.importorskip("tf2_msgs.msg", reason="no wheel of Jazzy has tf2_msgs")
    got = []
    peer.node.create_subscription(messages.TFMessage, "/tf", got.append, 100)
    node = start.node("predictor", output__publish_tf=switched)
    standing = Standing(peer)
    standing.describe()
    standing.wait_until_heard()
    standing.samples(100)
    peer.wait(lambda: len(peer.predictions) == 100, "a prediction for each joint state")
    assert bool(peer.node.count_publishers("/tf")) == switched
    if switched:
        peer.wait(lambda: got, "a transform")
        (transform,) = got[-1].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert node.stop() == 0
