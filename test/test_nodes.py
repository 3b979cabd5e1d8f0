# SPDX-License-Identifier: BSD-3-Clause
"""The nodes as users meet them: real processes, real DDS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coman_reduced_model_msgs.msg import ComReference, SupportState
from conftest import PATIENCE, Process, child_environment
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_testing import Peer, Standing, compile_once, numbers, paced, record_walk, robot_urdf, stamp_of, vector
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from synthetic import T0, write_bag
from synthetic import walk as synthetic_walk
from visualization_msgs.msg import Marker, MarkerArray

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.core.config import Config, load_config
from coman_reduced_model.core.pipeline import Pipeline
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.messages import prediction_to, ros_types
from coman_reduced_model.offline import find_robot, input_streams, predictions
from coman_reduced_model.ros import qos
from coman_reduced_model.ros.replay import Replay
from coman_reduced_model.topics import TopicNames

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module", autouse=True)
def compiled():
    compile_once()


@pytest.fixture
def peer(ros_domain):
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    return record_walk(tmp_path_factory.mktemp("bags"))


def watched(path, config):
    """A pipeline that has seen a bag, and its predictions."""
    with Bag(path) as bag:
        pipeline = Pipeline(find_robot(config, bag, TopicNames()), config)
        return pipeline, list(predictions(bag, pipeline, input_streams(bag, config, TopicNames())))


def offline(path, config):
    types = ros_types()
    return [prediction_to(types, p) for p in watched(path, config)[1]]


def replayed(peer, node, path, rate, count):
    """What the node predicts while the bag is played to it; it is stopped at the end."""
    replay = Replay(peer.node, path)
    topics = ("joint_states", "motor_states", "left_foot/wrench", "right_foot/wrench", "com/reference")
    replay.wait_for_subscribers(topics, PATIENCE)
    replay.play(rate, keep_going=paced(peer, replay.bag))

    def all_received() -> bool:
        _, _, values = peer.statuses["predictor: input"]
        return all(values.get(f"{topic}: received") == str(replay.bag.counts[f"/{topic}"]) for topic in topics)

    peer.wait(all_received, "every message of the bag")
    replay.close()
    assert node.stop() == 0  # now it answers the last ones, which still wait for other streams
    peer.wait(lambda: len(peer.predictions) >= count, f"{count} predictions (only {len(peer.predictions)})")


@pytest.mark.parametrize("reference", ["motor", "topic"])
def test_live_equals_offline(start, peer, walk, reference):
    """The same messages give the same predictions, all of them, through DDS and from the file."""
    config = Config().replaced({"prediction.reference": reference})
    expected = offline(walk, config)
    node = start.node("predictor", prediction__reference=reference)
    replayed(peer, node, walk, 2.0, len(expected))
    assert [stamp_of(message) for message in peer.predictions] == [stamp_of(message) for message in expected]
    assert [len(message.horizons) for message in peer.predictions] == [len(message.horizons) for message in expected]
    # In `motor`, the preview of com/reference only helps; which point of it is the newest depends on arrival.
    for got, wanted in zip(peer.predictions, expected, strict=True):
        if reference == "motor":
            got.horizons, wanted.horizons = [], []
        np.testing.assert_allclose(numbers(got), numbers(wanted), rtol=0.0, atol=1e-9)
    phases = {message.support.phase for message in peer.predictions}
    assert phases == {SupportState.LEFT, SupportState.RIGHT, SupportState.DOUBLE}
    residuals = np.array([vector(message.residual) for message in peer.predictions])
    assert np.isfinite(residuals).all(axis=1).mean() > 0.95


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


SIGNALS = {"twice": [signal.SIGINT] * 2, "terminated": [signal.SIGTERM]}


@pytest.mark.parametrize("signals", SIGNALS.values(), ids=SIGNALS.keys())
def test_stops_cleanly(start, ros_domain, signals):
    """Also a predictor that still waits for the URDF, one that predicts, and one that has hardly begun to start."""
    robot, trajectory = start.node("virtual_robot"), start.node("trajectory")
    waiting, predicting = start.node("predictor", "-r", "__ns:=/other"), start.node("predictor")
    waiting.wait_for("waiting for the URDF on /other/robot_description")
    predicting.wait_for("ready: coman")
    robot.wait_for("ready")
    starting = start.node("predictor")
    starting.wait_until_it_takes(signal.SIGTERM)
    nodes = (robot, trajectory, waiting, predicting, starting)
    for number in signals:
        for node in nodes:
            node.send(number)
    for node in nodes:
        assert node.wait() == 0, node.output
        assert "Traceback" not in node.output


HANGS = """
import ctypes, sys
from coman_reduced_model.ros.spin import run

def find():
    from rclpy.node import Node

    class Hangs(Node):
        def __init__(self):
            super().__init__("hangs")
            self.create_timer(0.1, lambda: print("spins", flush=True))

        def finish(self):
            pass

        def destroy_node(self):
            ctypes.PyDLL(None).sleep(600)  # with the interpreter's lock, as where the middleware hangs

    return Hangs

sys.exit(run("hangs", find))
"""


def test_ends_even_if_the_middleware_hangs_while_it_is_taken_down(start, ros_domain):
    node = start(sys.executable, "-c", HANGS)
    node.wait_for("spins")
    node.send(signal.SIGTERM)
    assert node.wait(60.0) == 0
    assert "Traceback" not in node.output


BAD_CONFIGURATIONS = {
    "unknown key": "support.contact_no: 0.2",
    "wrong type": "support.contact_on: high",
    "out of range": "support.contact_on: 3.0",
    "wrong choice": "model.stiffness: fulll",
    "inconsistent": "support.contact_off: 0.8",
    "unknown effect": "effects.active: [magic]",
}


@pytest.mark.parametrize("line", BAD_CONFIGURATIONS.values(), ids=BAD_CONFIGURATIONS.keys())
def test_bad_configuration_is_refused_as_on_the_command_line(start, ros_domain, tmp_path, line):
    path = tmp_path / "bad.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    {line}\n")
    with pytest.raises(ConfigError) as told:
        load_config(path)
    node = start.node("predictor", "--params-file", path)
    assert node.wait() == 2
    assert node.output.strip() == f"predictor: {told.value}"


@pytest.mark.parametrize(
    ("executable", "parameter", "wanted"),
    [
        ("trajectory", "gait.stepps:=3", "did you mean 'gait.steps'"),
        ("trajectory", "gait.name:=moonwalk", "moonwalk"),
        ("predictor", "robot.urdf:=/nowhere/robot.urdf", "/nowhere/robot.urdf"),
        ("trajectory", "virtual_robot.rate:=7.0", "virtual_robot.rate"),
    ],
)
def test_bad_parameter_is_refused_in_one_line(start, ros_domain, executable, parameter, wanted):
    node = start(executable, "--ros-args", "-p", parameter)
    assert node.wait() == 2
    assert wanted in node.output and len(node.output.strip().splitlines()) == 1


def test_file_that_ros_cannot_read_is_refused_in_one_line(start, ros_domain, tmp_path):
    path = tmp_path / "mixed.yaml"
    path.write_text("/**:\n  ros__parameters:\n    prediction.horizons: [1, 0.2]\n")  # ROS wants one type in a list
    node = start.node("predictor", "--params-file", path)
    assert node.wait() == 2
    assert "mixed.yaml" in node.output and "Traceback" not in node.output


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


def value_of(peer, name, node="/predictor"):
    (value,) = peer.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name])).values
    return value


def set_parameter(peer, name, value, node="/predictor"):
    request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
    (result,) = peer.call(SetParameters, f"{node}/set_parameters", request).results
    return result.successful, result.reason


def test_parameters_at_run_time(start, peer):
    node = start.node("predictor", output__points_rate=200.0)
    standing = Standing(peer)
    standing.describe()
    standing.wait_until_heard()

    def phase(**shares):
        standing.samples(60, **shares)
        peer.wait(lambda: stamp_of(peer.predictions[-1]) == standing.stamp, "the last prediction")
        return peer.predictions[-1].support.phase

    def number(value):
        return ParameterValue(type=3, double_value=value)

    standing.samples(10)
    peer.wait(lambda: peer.predictions, "predictions")
    # A light touch of the right foot counts as contact, until the threshold says otherwise.
    assert phase(left=1.0, right=0.0) == SupportState.LEFT
    assert phase(left=0.7, right=0.3) == SupportState.DOUBLE
    assert set_parameter(peer, "support.contact_on", number(0.6)) == (True, "")
    assert phase(left=1.0, right=0.0) == SupportState.LEFT
    assert phase(left=0.7, right=0.3) == SupportState.LEFT
    successful, reason = set_parameter(peer, "support.contact_on", number(5.0))
    assert not successful and reason
    successful, reason = set_parameter(peer, "support.contact_off", number(0.7))
    assert not successful and "must be below support.contact_on = 0.6" in reason
    successful, reason = set_parameter(peer, "robot.gravity", number(1.6))
    assert not successful and "read-only" in reason.lower().replace("read only", "read-only")
    assert value_of(peer, "support.contact_on").double_value == 0.6
    described = peer.call(
        DescribeParameters,
        "/predictor/describe_parameters",
        DescribeParameters.Request(names=["streams.max_wait", "support.contact_on"]),
    ).descriptors
    assert described[0].read_only and "[s]" in described[0].description
    assert not described[1].read_only and described[1].floating_point_range[0].to_value == 0.9
    assert node.stop() == 0


def test_every_topic_of_the_predictor_in_a_namespace(start, ros_domain):
    peer = Peer("robot1")
    try:
        got = {topic: [] for topic in ("support", "measured", "predicted", "reference_point", "markers")}
        kinds = (SupportState, PointStamped, PointStamped, PointStamped, MarkerArray)
        for (topic, received), kind in zip(got.items(), kinds, strict=True):
            peer.node.create_subscription(kind, f"/robot1/com/{topic}", received.append, 10)
        node = start.node("predictor", "-r", "__ns:=/robot1")
        standing = Standing(peer)
        standing.describe()
        standing.wait_until_heard()
        peer.wait(lambda: peer.node.count_publishers("/robot1/com/markers"), "the outputs")
        peer.spin(0.5)
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
        support = got["support"][-1]
        assert support.phase == SupportState.DOUBLE and support.left_share == pytest.approx(0.5)
        assert support.header.frame_id == by_stamp[stamp_of(support)].header.frame_id
        assert node.stop() == 0
    finally:
        peer.close()


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


def test_replay_keeps_time_and_order_and_latches_the_description(peer, walk):
    clocks, stamps, texts = [], [], []
    peer.node.create_subscription(Clock, "/clock", lambda m: clocks.append(m.clock.sec + m.clock.nanosec * 1e-9), 1000)
    peer.node.create_subscription(JointState, "joint_states", lambda m: stamps.append(stamp_of(m)), 1000)
    replay = Replay(peer.node, walk, exclude=("com/reference",))
    replay.wait_for_subscribers(["joint_states"], PATIENCE)
    began = time.monotonic()
    expected = 2 * replay.bag.duration_s / 4.0

    def keep_going(progress):
        peer.executor.spin_once(timeout_sec=0.0)
        return progress.loops < 3

    progress = replay.play(4.0, True, keep_going)
    took = time.monotonic() - began
    assert expected - 0.3 < took < expected + 0.3 + 2 * progress.max_lag_s, "two passes at four times the speed"
    peer.node.create_subscription(peer.types.String, "robot_description", lambda m: texts.append(m.data), qos.latched())
    peer.wait(lambda: texts, "robot_description for a late subscriber")
    assert texts == [robot_urdf()]
    with Bag(walk) as bag:
        recorded = [stamp_of(message) for _, _, message in bag.messages(["/joint_states"])]
    assert stamps == recorded * 2
    steps = np.diff(clocks)
    assert np.median(steps) == pytest.approx(0.005, abs=1e-6) and (steps < 0.0).sum() == 1
    assert progress.messages == 2 * progress.total and not peer.node.count_subscribers("com/reference")
    replay.close()


def test_bag_loop_restarts_the_prediction(start, peer, walk):
    node = start.node("predictor", output__diagnostics_rate=10.0)
    replay = Replay(peer.node, walk)
    replay.wait_for_subscribers(["joint_states", "right_foot/wrench"], PATIENCE)
    in_step = paced(peer, replay.bag)
    replay.play(4.0, True, lambda progress: in_step(progress) and progress.loops < 3)

    def both_passes() -> bool:
        back = np.flatnonzero(np.diff([stamp_of(message) for message in peer.predictions]) < 0)
        return len(back) > 0 and len(peer.predictions) > 1.95 * back[0]

    peer.wait(both_passes, "predictions of both passes")  # a busy machine is behind when the replay ends
    peer.spin(0.5)
    _, _, values = peer.statuses["predictor: prediction"]
    assert values["restarts"] == "1"
    stamps = np.array([stamp_of(message) for message in peer.predictions])
    (back,) = np.flatnonzero(np.diff(stamps) < 0)
    first, second = peer.predictions[: back + 1], peer.predictions[back + 1 :]
    # Odometry and phases begin anew: the second pass is the first one again.
    same = {stamp_of(message): message for message in first}
    compared = [message for message in second if stamp_of(message) in same][20:]
    assert len(compared) > 0.9 * len(first)
    for message in compared:
        np.testing.assert_allclose(
            vector(message.sole_pose.position), vector(same[stamp_of(message)].sole_pose.position), atol=1e-9
        )
    replay.close()
    assert node.stop() == 0


class References:
    def __init__(self, peer):
        self.messages, self.paths = [], []
        peer.node.create_subscription(ComReference, "com/reference", self.messages.append, qos.sensor_input())
        peer.node.create_subscription(PathMessage, "com/reference_path", self.paths.append, qos.latched())

    def arrays(self):
        t = np.array([stamp_of(m) for m in self.messages]) * 1e-9
        return (
            t,
            np.array([vector(m.position) for m in self.messages]),
            np.array([vector(m.velocity) for m in self.messages]),
        )


def test_trajectory_starts_stops_and_resets(start, peer):
    references = References(peer)
    node = start.node("trajectory", gait__autostart=False, gait__single_support=0.3, gait__double_support=0.1)
    peer.wait(lambda: references.messages and references.paths, "com/reference and its path")

    def call(name):
        answer = peer.call(Trigger, f"/trajectory/{name}", Trigger.Request())
        return answer.success, answer.message

    peer.spin(0.3)
    assert np.abs(references.arrays()[2]).max() < 1e-9, "stands until it is told to start"
    assert call("stop") == (False, "stands already")
    assert call("start")[0]
    success, message = call("start")
    assert not success and "walking already" in message
    peer.wait(lambda: references.messages[-1].step >= 1, "the second step")
    steps_before = references.messages[-1].step
    assert call("stop")[0]
    peer.wait(lambda: call("stop") == (False, "stands already"), "stands")
    last = references.messages[-1]
    assert steps_before < last.step <= steps_before + 5
    assert last.left_sole.position.x == pytest.approx(last.right_sole.position.x), "feet together"
    t, com, velocity = references.arrays()
    np.testing.assert_allclose(np.diff(t), 0.005, atol=1e-6)  # a grid, none left out
    moved = np.diff(com, axis=0) - 0.0025 * (velocity[1:] + velocity[:-1])
    assert np.abs(moved).max() < 3e-4, "the stop does not make the COM jump"
    assert call("start")[0], "from where it stands"
    peer.spin(0.1)
    assert references.messages[-1].left_sole.position.x == last.left_sole.position.x > 0.01
    assert call("reset")[0]
    peer.spin(0.1)
    assert references.messages[-1].left_sole.position.x == 0.0 and references.messages[-1].step == -1
    assert len(references.paths) >= 4
    assert node.stop() == 0


def test_trajectory_in_the_time_of_a_bag(start, peer):
    """With use_sim_time and a start time, the plan is where the bag's clock says, also when it jumps back."""
    references = References(peer)
    clock = peer.publisher(Clock, "/clock", qos.clock_output())
    node = start.node("trajectory", use_sim_time=True, gait__start_time=1000.0)
    peer.wait(lambda: clock.get_subscription_count(), "the node listens to /clock")
    peer.spin(0.3)
    assert not references.messages, "no time, no reference"

    def play(first, last):
        references.messages.clear()
        for t in np.arange(first, last, 0.005):
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(round(t * 1e9), 1_000_000_000)
            clock.publish(message)
            peer.spin(0.002)
        peer.spin(0.2)
        return references.arrays()

    t, com, _ = play(999.5, 1003.5)
    assert t[0] >= 999.5 and t[-1] > 1003.4
    np.testing.assert_allclose(np.diff(t), 0.005, atol=1e-6)
    again, com_again, _ = play(1001.0, 1003.0)
    common = {round(a, 4): c for a, c in zip(t, com, strict=True)}
    for a, c in zip(again, com_again, strict=True):
        np.testing.assert_allclose(c, common[round(a, 4)], atol=1e-9)
    assert node.stop() == 0


@pytest.mark.slow
def test_virtual_robot_walks_live(start, peer):
    """Robot, trajectory and predictor together: the robot walks its plan, the prediction follows it."""
    robot = start.node("virtual_robot", output__diagnostics_rate=5.0)
    predictor = start.node("predictor")
    robot.wait_for("ready: coman")
    predictor.wait_for("ready: coman")
    peer.wait(lambda: peer.predictions, "predictions")
    # On a busy machine the robot may hear of the walk too late to join it: then it joins the next one.
    trajectory = start.node("trajectory", gait__steps=4, gait__zmp_offset_x=0.02, gait__repeat=True)

    def hopeless():
        return robot.output.count("too slow for real time") > 4

    peer.wait(lambda: peer.predictions[-1].sole_pose.position.x > 0.05 or hopeless(), "some steps")
    if hopeless():
        pytest.skip("this machine is too busy now for a robot in real time")
    level, message, _ = peer.statuses["virtual_robot: simulation"]
    assert message == "follows com/reference" or "cannot keep real time" in message  # the latter on a busy machine
    phases = [m.support.phase for m in peer.predictions]
    assert set(phases) >= {SupportState.LEFT, SupportState.RIGHT, SupportState.DOUBLE}
    assert phases.count(SupportState.FLIGHT) < 0.02 * len(phases)  # a stumble, on a busy machine
    residual = np.array([vector(m.residual) for m in peer.predictions])
    rigid = np.array([vector(m.measured_position) - vector(m.reference_position) for m in peer.predictions])
    assert np.nanmean(residual[:, 2] ** 2) < np.nanmean(rigid[:, 2] ** 2)
    for node in (robot, predictor, trajectory):
        assert node.stop() == 0


def test_demo_shows_and_fails_loudly(tmp_path, walk):
    """The demonstration answers every joint state; with a bag that the nodes cannot answer, it says so and exits 1."""
    coman = Path(sys.executable).with_name("coman")

    def demo(*arguments):
        return subprocess.run(
            [coman, "demo", *map(str, arguments)],
            capture_output=True,
            text=True,
            env=child_environment(),
            timeout=4 * PATIENCE,
        )

    done = demo("--bag", walk, "--rate", "2", "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["live"]["predictions"] == summary["live"]["joint_states"] > 500
    assert summary["rmse_m"]["z"] < summary["rmse_rigid_m"]["z"]
    assert "<html" in (tmp_path / "out/report.html").read_text()
    # The wrong robot: the predictor ends, and so does the demonstration.
    config = tmp_path / "other.yaml"
    config.write_text("/**:\n  ros__parameters:\n    robot.left.sole_frame: nowhere\n")
    done = demo("--bag", walk, "--out", tmp_path / "bad", "--config", config)
    assert done.returncode == 1
    assert "predictor has ended with exit code 2" in done.stderr and "nowhere" in done.stderr
    assert not (tmp_path / "bad").exists() and "Traceback" not in done.stderr


@pytest.mark.slow
def test_live_view_on_a_dumb_terminal(ros_domain):
    coman = Path(sys.executable).with_name("coman")
    process = Process([str(coman), "live"], TERM="dumb")
    try:
        process.wait_for("support")
        process.wait_for("RMS 5 s: model")
        process.interrupt(2)
        assert process.wait() == 0, process.output
        assert "Traceback" not in process.output and "predictions; RMS error" in process.output
    finally:
        process.kill()


def test_diagnostics_name_what_breaks_in_mid_walk(start, peer, tmp_path):
    """An encoder slips at 6 s: /diagnostics are silent before, and warn with its joint's spring.

    That the same walk is told of within five seconds is read off the samples' own time, by the same code offline: a
    machine that is busy elsewhere may hold the replay up and then hurry it.
    """

    def change(stream, message):
        late = stream == "joint_states" and (message.stamp_ns - T0) * 1e-9 >= 6.0
        slip = 0.012 * (np.array(message.names) == "LKneeSag") if late else 0.0
        return replace(message, position=message.position + slip) if late else message

    node = start.node("predictor")
    path = write_bag(tmp_path / "walk", synthetic_walk(11.5), change)
    replay = Replay(peer.node, path)
    replay.wait_for_subscribers(("joint_states", "motor_states", "left_foot/wrench", "right_foot/wrench"), PATIENCE)
    keep_going, told = paced(peer, replay.bag), []

    def warned() -> bool:
        level, message, _ = peer.statuses.get("predictor: mismatch", (0, "", {}))
        if level and not told:
            told.append(((stamp_of(peer.predictions[-1]) - T0) * 1e-9, level, message))
        return bool(told)

    def watching(progress):
        warned()
        return keep_going(progress)

    replay.play(1.0, keep_going=watching)
    replay.close()
    peer.wait(warned, "a warning of what broke")
    seconds, level, message = told[0]
    assert seconds > 6.0 and level == 1 and message.startswith("spring/LKneeSag changed by -1")
    assert node.stop() == 0
    first = watched(path, Config())[0].monitor.first
    assert min(first, key=lambda channel: first[channel].told_ns) == "spring/LKneeSag"
    assert 6.0 < (first["spring/LKneeSag"].told_ns - T0) * 1e-9 <= 11.0
